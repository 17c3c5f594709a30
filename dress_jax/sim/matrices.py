"""The Hessian of a step as a sparse matrix, projected to positive definite or exact.

Assembled in pieces that are compiled apart: stencils, entries of blocks, and their sum into the
matrix. In one program XLA on CPU would compute a stencil anew for each of the ninety entries that
are made of it, and an entry inside of the loop that adds it.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.contact.curvature import CurvedBlocks, curved_blocks
from dress_jax.contact.friction import Friction, friction_blocks, friction_energy
from dress_jax.contact.potential import (
    CONTACT_PAIRS,
    Contact,
    PairBlocks,
    Pairs,
    contact_blocks,
    contact_energy,
)
from dress_jax.core import components as c
from dress_jax.core.pytree import pytree, replace
from dress_jax.energy.bending import HINGE_PAIRS, bending_vectors
from dress_jax.energy.cloth import Cloth, Parameters, vertex_masses
from dress_jax.energy.elastic import rest_hinges
from dress_jax.energy.hinge_hessian import HingeBlocks, curvature_blocks, hinge_blocks
from dress_jax.energy.membrane import (
    TRIANGLE_PAIRS,
    MembraneFrame,
    membrane_blocks,
)
from dress_jax.energy.stretching import stretching_frame
from dress_jax.sim.kernels import Frame, make_contact, make_friction, with_body
from dress_jax.solver.block_matrix import (
    BlockRows,
    BlockSlots,
    Values,
    add_rows,
    block_rows,
    empty_values,
    first_and_second,
    outer_rows,
)


@pytree
class ElasticSlots:
    """Where the blocks of the elastic energies go."""

    triangles: BlockSlots
    hinges: BlockSlots
    stitches: BlockSlots
    pins: Int[Array, " k"]
    diagonal: Int[Array, " n"]


class Matrices(NamedTuple):
    """Assembly of the Hessian: of elasticity, of the barrier and of friction.

    Attributes:
        elastic: (positions, parameters, cloth, frame, slots, capacity=) -> values.
        barrier, sliding: (values, positions, parameters, frame, pairs, slots) -> values with the
            family of pairs added; takes the memory of the values that it is given.
        mollified: as `barrier`, for edges that are nearly parallel.
    """

    elastic: Callable[..., Values]
    barrier: Callable[..., Values]
    mollified: Callable[..., Values]
    sliding: Callable[..., Values]


# Elasticity


def _elastic_matrix(rows: Callable[..., tuple[BlockRows, BlockRows]]) -> Callable[..., Values]:
    """The function that assembles the elastic energies.

    Args:
        rows: entries of the blocks of the triangles and of the hinges.
    """

    def matrix(
        positions: Float[Array, "n 3"],
        parameters: Parameters,
        cloth: Cloth,
        frame: Frame,
        slots: ElasticSlots,
        *,
        capacity: int,
    ) -> Values:
        triangles, hinges = rows(positions, parameters, cloth, slots)
        values = _springs(parameters, cloth, frame, slots, capacity=capacity)
        values = add_rows(values, triangles, slots.triangles.slots)
        return add_rows(values, hinges, slots.hinges.slots)

    return matrix


@functools.partial(jax.jit, static_argnames="capacity")
def _springs(
    parameters: Parameters, cloth: Cloth, frame: Frame, slots: ElasticSlots, *, capacity: int
) -> Values:
    """Inertia, pins and stitches, whose Hessians are constant and isotropic."""
    masses = vertex_masses(parameters, cloth) * frame.step.inverse_step**2
    isotropic = jnp.eye(3).reshape(1, 9)

    def add(values: Values, slots: Array, amounts: Array) -> Values:
        return values.at[slots].add(jnp.broadcast_to(amounts, slots.shape)[:, None] * isotropic)

    values = add(empty_values(capacity), slots.diagonal, masses)
    values = add(values, slots.pins, parameters.pin_stiffness)
    for pair, sign in enumerate((1.0, -1.0, 1.0)):  # pairs (0, 0), (0, 1), (1, 1) of a stitch
        values = add(values, slots.stitches.slots[pair], sign * parameters.stitch_stiffness)
    return values


@jax.jit
def _elastic_stencils(
    positions: Float[Array, "n 3"], parameters: Parameters, cloth: Cloth
) -> tuple[MembraneFrame, Float[Array, "4 3 h"], Float[Array, " h"]]:
    """What the projected blocks of triangles and hinges are made of."""
    x = c.split(positions)
    triangles = stretching_frame(x, parameters, cloth)
    vectors, stiffness = bending_vectors(
        x, cloth.hinges, rest_hinges(parameters, cloth), parameters.bending_stiffness
    )
    return triangles, vectors, stiffness


@jax.jit
def _projected_entries(
    triangles: MembraneFrame,
    vectors: Float[Array, "4 3 h"],
    stiffness: Float[Array, " h"],
    slots: ElasticSlots,
) -> tuple[BlockRows, BlockRows]:
    return _triangle_rows(triangles, slots), outer_rows(
        vectors, stiffness, HINGE_PAIRS, slots.hinges
    )


def _triangle_rows(triangles: MembraneFrame, slots: ElasticSlots) -> BlockRows:
    """Entries of the blocks of the triangles."""
    return block_rows(
        membrane_blocks(
            jax.tree.map(_row, triangles),
            first_and_second(triangles.alpha, TRIANGLE_PAIRS, slots.triangles),
            first_and_second(triangles.beta, TRIANGLE_PAIRS, slots.triangles),
        )
    )


def _row(array: Array) -> Array:
    """Values per triangle, ready to be combined with values per pair and triangle."""
    return array[None, :] if array.ndim == 1 else array


def _projected_elastic(
    positions: Float[Array, "n 3"], parameters: Parameters, cloth: Cloth, slots: ElasticSlots
) -> tuple[BlockRows, BlockRows]:
    return _projected_entries(*_elastic_stencils(positions, parameters, cloth), slots)


@jax.jit
def _exact_stencils(
    positions: Float[Array, "n 3"], parameters: Parameters, cloth: Cloth
) -> tuple[MembraneFrame, HingeBlocks]:
    """What the exact blocks of triangles and hinges are made of."""
    x = c.split(positions)
    triangles = stretching_frame(x, parameters, cloth, project=False)
    hinges = hinge_blocks(
        x, cloth.hinges, rest_hinges(parameters, cloth), parameters.bending_stiffness
    )
    return triangles, hinges


@jax.jit
def _exact_entries(
    triangles: MembraneFrame, hinges: HingeBlocks, slots: ElasticSlots
) -> tuple[BlockRows, BlockRows]:
    rank_one = outer_rows(hinges.gradient, hinges.stiffness, HINGE_PAIRS, slots.hinges)
    curved = curvature_blocks(hinges)
    swap = slots.hinges.transposed
    added = block_rows(
        [
            [jnp.where(swap, curved[:, 3 * j + i], curved[:, 3 * i + j]) for j in range(3)]
            for i in range(3)
        ]
    )
    return _triangle_rows(triangles, slots), rank_one + added


def _exact_elastic(
    positions: Float[Array, "n 3"], parameters: Parameters, cloth: Cloth, slots: ElasticSlots
) -> tuple[BlockRows, BlockRows]:
    return _exact_entries(*_exact_stencils(positions, parameters, cloth), slots)


# Pairs in contact


def _pair_matrix(rows: Callable[..., BlockRows]) -> Callable[..., Values]:
    """The function that adds one family of pairs to a matrix.

    Args:
        rows: entries of the blocks of the pairs.
    """

    def matrix(
        values: Values,
        positions: Float[Array, "n 3"],
        parameters: Parameters,
        frame: Frame,
        pairs: Pairs,
        slots: BlockSlots,
    ) -> Values:
        added = rows(positions, parameters, frame, pairs, slots)
        return add_rows(values, added, slots.slots)

    return matrix


def _closed_form_pairs(
    blocks: Callable[[Array, Any], Any],
    carrier: Callable[[Parameters, Frame, Pairs], Any],
    entries: Callable[[Any, BlockSlots], BlockRows],
) -> Callable[..., BlockRows]:
    """Entries of blocks in closed form of one family of pairs."""

    @jax.jit
    def stencils(positions, parameters, frame, pairs):
        return blocks(with_body(positions, parameters), carrier(parameters, frame, pairs))

    entries = jax.jit(entries)

    def rows(positions, parameters, frame, pairs, slots):
        return entries(stencils(positions, parameters, frame, pairs), slots)

    return rows


def _along(blocks: PairBlocks, slots: BlockSlots) -> BlockRows:
    """s w_p w_q n n^T."""
    vectors = blocks.weights[:, None, :] * jnp.stack(blocks.normal)[None]
    return outer_rows(vectors, blocks.stiffness, CONTACT_PAIRS, slots)


def _across(blocks: PairBlocks, slots: BlockSlots) -> BlockRows:
    """s w_p w_q (I - n n^T)."""
    normal = blocks.normal
    first, second = first_and_second(blocks.weights, CONTACT_PAIRS, slots)
    scale = first * second * blocks.stiffness[None, :]
    return block_rows(
        [
            [
                scale * ((1.0 if i == j else 0.0) - (normal[i] * normal[j])[None, :])
                for j in range(3)
            ]
            for i in range(3)
        ]
    )


def _curved(blocks: CurvedBlocks, slots: BlockSlots) -> BlockRows:
    """s0 w_p w_q I + sum_k s_k v_kp v_kq^T."""
    first, second = first_and_second(blocks.weights, CONTACT_PAIRS, slots)
    isotropic = first * second * blocks.isotropic[None, :]
    ends = [first_and_second(vectors, CONTACT_PAIRS, slots) for vectors in blocks.vectors]
    scaled = [s[None, None, :] * p for s, (p, _) in zip(blocks.stiffness, ends, strict=True)]
    return block_rows(
        [
            [
                sum(
                    (p[:, i] * q[:, j] for p, (_, q) in zip(scaled, ends, strict=True)),
                    start=isotropic if i == j else jnp.zeros_like(isotropic),
                )
                for j in range(3)
            ]
            for i in range(3)
        ]
    )


def _exact_pairs(
    energy: Callable[[Array, Any], Array],
    carrier: Callable[[Parameters, Frame, Pairs], Any],
    own_carrier: Callable[[Any, Pairs], Any],
) -> Callable[..., BlockRows]:
    """Entries of the exact Hessians of one family of pairs."""

    @jax.jit
    def rows(positions, parameters, frame, pairs, slots):
        own_pairs = replace(pairs, indices=_own_indices(pairs.indices))
        own = own_carrier(carrier(parameters, frame, pairs), own_pairs)
        vertices = _own_vertices(with_body(positions, parameters), pairs.indices)
        return _exact_rows(lambda x: energy(x, own), vertices, CONTACT_PAIRS, slots)

    return rows


def _own_contact(contact: Contact, pairs: Pairs) -> Contact:
    areas = contact.areas[contact.pairs.indices.ravel()]
    return Contact(pairs, areas, contact.barrier_stiffness, contact.settings)


def _own_friction(friction: Friction, pairs: Pairs) -> Friction:
    return replace(
        friction,
        contact=_own_contact(friction.contact, pairs),
        start=_own_vertices(friction.start, friction.contact.pairs.indices),
    )


# Exact Hessians of elements. Every element gets vertices of its own, so that one second derivative
# along a coordinate of all elements together is one row of each of their Hessians.


def _own_vertices(positions: Float[Array, "n 3"], elements: Int[Array, "k m"]) -> Array:
    """Positions of the elements' vertices, each element's apart, (k m, 3)."""
    return positions[elements.ravel()]


def _own_indices(elements: Int[Array, "k m"]) -> Array:
    """The elements in terms of `_own_vertices`."""
    return jnp.arange(elements.size, dtype=jnp.int32).reshape(elements.shape)


def _exact_rows(
    energy: Callable[[Array], Array],
    own: Float[Array, "km 3"],
    pairs: Sequence[tuple[int, int]],
    target: BlockSlots,
) -> BlockRows:
    """Entries of the Hessians of an energy that is a sum over elements with own vertices.

    Args:
        energy: function of `own`.
        own: positions of the elements' vertices, (k m, 3).
        pairs: pairs of stencil vertices.
        target: where their blocks go.
    """
    count = target.slots.shape[1]
    corners = own.shape[0] // count

    def row(direction: Float[Array, "k 3"]) -> Array:
        spread = jnp.repeat(direction, count, axis=0)
        second = jax.jvp(jax.grad(energy), (own,), (spread,))[1]
        return second.reshape(corners, count, 3)

    basis = jnp.eye(3 * corners).reshape(3 * corners, corners, 3)
    rows = jax.lax.map(row, basis).reshape(corners, 3, corners, count, 3)
    first = np.array([p for p, _ in pairs])
    second = np.array([q for _, q in pairs])
    return block_rows(
        [
            [
                # The block of (q, p) is the transposed one of (p, q).
                jnp.where(
                    target.transposed, rows[first, j, second, :, i], rows[first, i, second, :, j]
                )
                for j in range(3)
            ]
            for i in range(3)
        ]
    )


PROJECTED = Matrices(
    elastic=_elastic_matrix(_projected_elastic),
    barrier=_pair_matrix(_closed_form_pairs(contact_blocks, make_contact, _along)),
    mollified=_pair_matrix(_closed_form_pairs(contact_blocks, make_contact, _along)),
    sliding=_pair_matrix(_closed_form_pairs(friction_blocks, make_friction, _across)),
)
EXACT = Matrices(
    elastic=_elastic_matrix(_exact_elastic),
    barrier=_pair_matrix(_closed_form_pairs(curved_blocks, make_contact, _curved)),
    mollified=_pair_matrix(_exact_pairs(contact_energy, make_contact, _own_contact)),
    sliding=_pair_matrix(_exact_pairs(friction_energy, make_friction, _own_friction)),
)
