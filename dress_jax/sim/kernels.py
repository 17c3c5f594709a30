"""The compiled pieces of a Newton iteration.

Elasticity and the two families of contact pairs are compiled apart, so that a new capacity of one
pair list recompiles one small program. Each has a value, a gradient, an exact Hessian product, and
projected blocks scattered into the sparse matrix.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.contact.barrier import ContactSettings
from dress_jax.contact.friction import Friction, friction_blocks, friction_energy
from dress_jax.contact.potential import (
    CONTACT_PAIRS,
    Contact,
    PairBlocks,
    Pairs,
    active_pairs,
    contact_blocks,
    contact_energy,
)
from dress_jax.core import components as c
from dress_jax.core.pytree import pytree, replace
from dress_jax.energy.bending import HINGE_PAIRS, bending_energy, bending_vectors
from dress_jax.energy.cloth import Cloth, Parameters, vertex_masses
from dress_jax.energy.elastic import TimeStep, elastic_energy, rest_hinges
from dress_jax.energy.membrane import (
    TRIANGLE_PAIRS,
    membrane_blocks,
    membrane_energy,
    membrane_frame,
)
from dress_jax.energy.rest import rest_triangles, vertex_areas
from dress_jax.solver.block_matrix import (
    BlockSlots,
    Values,
    empty_values,
    first_and_second,
    scatter_blocks,
    scatter_outer,
)


@pytree
class Frame:
    """What all energies of one step share.

    Attributes:
        step: state at the start of the time step.
        body_start: body vertices at the start of the step [m], (b, 3).
        body_areas: areas that body vertices stand for [m^2], (b,); constants.
        settings: lengths of the contact model.
    """

    step: TimeStep
    body_start: Float[Array, "b 3"]
    body_areas: Float[Array, " b"]
    settings: ContactSettings


@pytree
class ElasticSlots:
    """Where the blocks of the elastic energies go."""

    triangles: BlockSlots
    hinges: BlockSlots
    stitches: BlockSlots
    pins: Int[Array, " k"]
    diagonal: Int[Array, " n"]


def all_areas(parameters: Parameters, cloth: Cloth, frame: Frame) -> Float[Array, " nb"]:
    """Vertex areas of the cloth (of its rest shape, differentiable) and of the body."""
    rest = rest_triangles(parameters.rest_positions, cloth.rest_faces)
    return jnp.concatenate(
        [vertex_areas(rest.areas, cloth.faces, cloth.vertex_count), frame.body_areas]
    )


def _everything(positions: Array, parameters: Parameters) -> Array:
    return jnp.concatenate([positions, parameters.body_vertices])


def _contact(parameters: Parameters, cloth: Cloth, frame: Frame, pairs: Pairs) -> Contact:
    areas = all_areas(parameters, cloth, frame)
    return Contact(pairs, areas, parameters.barrier_stiffness, frame.settings)


def _friction(parameters: Parameters, cloth: Cloth, frame: Frame, pairs: Pairs) -> Friction:
    step_length = 1.0 / frame.step.inverse_step
    return Friction(
        contact=_contact(parameters, cloth, frame, pairs),
        start=jnp.concatenate([frame.step.start, frame.body_start]),
        coefficient=parameters.friction_coefficient,
        slip_length=frame.settings.slip_speed * step_length,
    )


def frame_energy(
    positions: Float[Array, "n 3"], parameters: Parameters, cloth: Cloth, frame: Frame
) -> Float[Array, ""]:
    """The energy without contact [J]."""
    return elastic_energy(positions, frame.step, parameters, cloth)


def barrier_energy(
    positions: Float[Array, "n 3"],
    parameters: Parameters,
    cloth: Cloth,
    frame: Frame,
    pairs: Pairs,
) -> Float[Array, ""]:
    """The barrier of one family of pairs [J]."""
    everything = _everything(positions, parameters)
    return contact_energy(everything, _contact(parameters, cloth, frame, pairs))


def sliding_energy(
    positions: Float[Array, "n 3"],
    parameters: Parameters,
    cloth: Cloth,
    frame: Frame,
    pairs: Pairs,
) -> Float[Array, ""]:
    """Friction of the pairs that were in contact at the start of the step [J]."""
    everything = _everything(positions, parameters)
    return friction_energy(everything, _friction(parameters, cloth, frame, pairs))


class Kernels(NamedTuple):
    """An energy of positions, parameters, cloth, frame and, but for the elastic one, pairs.

    Attributes:
        energy: itself, not compiled [J].
        value: compiled [J].
        gradient: value and gradient [N].
        product: exact Hessian times a direction, which is the second argument.
    """

    energy: Callable[..., Array]
    value: Callable[..., Array]
    gradient: Callable[..., tuple[Array, Array]]
    product: Callable[..., Array]


def _kernels(energy: Callable[..., Array]) -> Kernels:
    """An energy with its derivatives in the positions, each compiled on its own."""

    def product(positions, direction, *fixed):
        def gradient(x):
            return jax.grad(energy)(x, *fixed)

        return jax.jvp(gradient, (positions,), (direction,))[1]

    return Kernels(energy, jax.jit(energy), jax.jit(jax.value_and_grad(energy)), jax.jit(product))


ELASTIC = _kernels(frame_energy)
BARRIER = _kernels(barrier_energy)
SLIDING = _kernels(sliding_energy)


@jax.jit
def find_active(positions, parameters, frame, pairs):
    """Mask of the pairs closer than dhat, and the smallest squared distance."""
    return active_pairs(_everything(positions, parameters), pairs, frame.settings)


@functools.partial(jax.jit, static_argnames="capacity")
def elastic_matrix(
    positions: Float[Array, "n 3"],
    parameters: Parameters,
    cloth: Cloth,
    frame: Frame,
    slots: ElasticSlots,
    *,
    capacity: int,
) -> Values:
    """Projected Hessian of the elastic energies, scattered into its slots."""
    x = c.split(positions)
    rest = rest_triangles(parameters.rest_positions, cloth.rest_faces)
    values = empty_values(capacity)
    triangles = membrane_frame(
        x,
        cloth.faces,
        rest,
        parameters.stretching_stiffness,
        parameters.poisson_ratio,
        cloth.membrane,
    )
    blocks = membrane_blocks(
        jax.tree.map(_row, triangles),
        first_and_second(triangles.alpha, TRIANGLE_PAIRS, slots.triangles),
        first_and_second(triangles.beta, TRIANGLE_PAIRS, slots.triangles),
    )
    values = scatter_blocks(values, blocks, slots.triangles.slots)
    vectors, stiffness = bending_vectors(
        x, cloth.hinges, rest_hinges(parameters, cloth), parameters.bending_stiffness
    )
    values = scatter_outer(values, vectors, stiffness, HINGE_PAIRS, slots.hinges)
    return _add_springs(values, parameters, cloth, frame, slots)


def _add_springs(
    values: Values, parameters: Parameters, cloth: Cloth, frame: Frame, slots: ElasticSlots
) -> Values:
    """Add inertia, pins and stitches, whose Hessians are constant and isotropic."""
    masses = vertex_masses(parameters, cloth) * frame.step.inverse_step**2
    isotropic = jnp.eye(3).reshape(1, 9)

    def add(values: Values, slots: Array, amounts: Array) -> Values:
        return values.at[slots].add(jnp.broadcast_to(amounts, slots.shape)[:, None] * isotropic)

    values = add(values, slots.diagonal, masses)
    values = add(values, slots.pins, parameters.pin_stiffness)
    for pair, sign in enumerate((1.0, -1.0, 1.0)):  # pairs (0, 0), (0, 1), (1, 1) of a stitch
        values = add(values, slots.stitches.slots[pair], sign * parameters.stitch_stiffness)
    return values


def _row(array: Array) -> Array:
    """Values per triangle, ready to be combined with values per pair and triangle."""
    return array[None, :] if array.ndim == 1 else array


def _add_along(values: Values, blocks: PairBlocks, slots: BlockSlots) -> Values:
    """Add s w_p w_q n n^T."""
    vectors = blocks.weights[:, None, :] * jnp.stack(blocks.normal)[None]
    return scatter_outer(values, vectors, blocks.stiffness, CONTACT_PAIRS, slots)


def _add_across(values: Values, blocks: PairBlocks, slots: BlockSlots) -> Values:
    """Add s w_p w_q (I - n n^T)."""
    normal = blocks.normal
    first, second = first_and_second(blocks.weights, CONTACT_PAIRS, slots)
    scale = first * second * blocks.stiffness[None, :]
    added = [
        [scale * ((1.0 if i == j else 0.0) - (normal[i] * normal[j])[None, :]) for j in range(3)]
        for i in range(3)
    ]
    return scatter_blocks(values, added, slots.slots)


def _pair_matrix(
    blocks: Callable[[Array, Any], PairBlocks],
    carrier: Callable[[Parameters, Cloth, Frame, Pairs], Any],
    add: Callable[[Values, PairBlocks, BlockSlots], Values],
) -> Callable[..., Values]:
    """The function that adds the blocks of one family of pairs to a matrix.

    Two programs: the XLA compiler for CPU would compute the stencils anew for each of the ninety
    entries that are made of them, which takes twenty times as long.
    """

    def stencils(
        positions: Float[Array, "n 3"],
        parameters: Parameters,
        cloth: Cloth,
        frame: Frame,
        pairs: Pairs,
    ) -> PairBlocks:
        return blocks(_everything(positions, parameters), carrier(parameters, cloth, frame, pairs))

    stencils, add = jax.jit(stencils), jax.jit(add)

    def matrix(
        values: Values,
        positions: Float[Array, "n 3"],
        parameters: Parameters,
        cloth: Cloth,
        frame: Frame,
        pairs: Pairs,
        slots: BlockSlots,
    ) -> Values:
        return add(values, stencils(positions, parameters, cloth, frame, pairs), slots)

    return matrix


barrier_matrix = _pair_matrix(contact_blocks, _contact, _add_along)
sliding_matrix = _pair_matrix(friction_blocks, _friction, _add_across)


# Exact Hessians of the elements. Every element gets vertices of its own, so that one second
# derivative along a coordinate of all elements together is one row of each of their Hessians.


def _own_vertices(positions: Float[Array, "n 3"], elements: Int[Array, "k m"]) -> Array:
    """Positions of the elements' vertices, each element's apart, (k m, 3)."""
    return positions[elements.ravel()]


def _own_indices(elements: Int[Array, "k m"]) -> Array:
    """The elements in terms of `_own_vertices`."""
    return jnp.arange(elements.size, dtype=jnp.int32).reshape(elements.shape)


def _add_exact(
    values: Values,
    energy: Callable[[Array], Array],
    own: Float[Array, "km 3"],
    pairs: Sequence[tuple[int, int]],
    target: BlockSlots,
) -> Values:
    """Add the Hessians of an energy that is a sum over elements with vertices of their own.

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
    blocks = [
        [
            # The block of (q, p) is the transposed one of (p, q).
            jnp.where(target.transposed, rows[first, j, second, :, i], rows[first, i, second, :, j])
            for j in range(3)
        ]
        for i in range(3)
    ]
    return scatter_blocks(values, blocks, target.slots)


@functools.partial(jax.jit, static_argnames="capacity")
def exact_elastic_matrix(
    positions: Float[Array, "n 3"],
    parameters: Parameters,
    cloth: Cloth,
    frame: Frame,
    slots: ElasticSlots,
    *,
    capacity: int,
) -> Values:
    """Exact Hessian of the elastic energies, scattered into its slots."""
    rest = rest_triangles(parameters.rest_positions, cloth.rest_faces)
    weights = rest_hinges(parameters, cloth)

    def stretched(own: Array) -> Array:
        return membrane_energy(
            c.split(own),
            _own_indices(cloth.faces),
            rest,
            parameters.stretching_stiffness,
            parameters.poisson_ratio,
            cloth.membrane,
        )

    def bent(own: Array) -> Array:
        return bending_energy(
            c.split(own), _own_indices(cloth.hinges), weights, parameters.bending_stiffness
        )

    values = empty_values(capacity)
    triangles, hinges = (_own_vertices(positions, e) for e in (cloth.faces, cloth.hinges))
    values = _add_exact(values, stretched, triangles, TRIANGLE_PAIRS, slots.triangles)
    values = _add_exact(values, bent, hinges, HINGE_PAIRS, slots.hinges)
    return _add_springs(values, parameters, cloth, frame, slots)


def _exact_pair_matrix(
    energy: Callable[[Array, Any], Array],
    own_carrier: Callable[[Any, Pairs], Any],
    carrier: Callable[[Parameters, Cloth, Frame, Pairs], Any],
) -> Callable[..., Values]:
    """The compiled function that adds the exact Hessian of one family of pairs to a matrix."""

    def matrix(
        values: Values,
        positions: Float[Array, "n 3"],
        parameters: Parameters,
        cloth: Cloth,
        frame: Frame,
        pairs: Pairs,
        slots: BlockSlots,
    ) -> Values:
        everything = _everything(positions, parameters)
        own_pairs = Pairs(_own_indices(pairs.indices), pairs.count, pairs.kind)
        own = own_carrier(carrier(parameters, cloth, frame, pairs), own_pairs)
        vertices = _own_vertices(everything, pairs.indices)
        return _add_exact(values, lambda x: energy(x, own), vertices, CONTACT_PAIRS, slots)

    return jax.jit(matrix)


def _own_contact(contact: Contact, pairs: Pairs) -> Contact:
    areas = contact.areas[contact.pairs.indices.ravel()]
    return Contact(pairs, areas, contact.barrier_stiffness, contact.settings)


def _own_friction(friction: Friction, pairs: Pairs) -> Friction:
    return replace(
        friction,
        contact=_own_contact(friction.contact, pairs),
        start=_own_vertices(friction.start, friction.contact.pairs.indices),
    )


exact_barrier_matrix = _exact_pair_matrix(contact_energy, _own_contact, _contact)
exact_sliding_matrix = _exact_pair_matrix(friction_energy, _own_friction, _friction)


class Matrices(NamedTuple):
    """Assembly of the Hessian: of elasticity, of the barrier and of friction."""

    elastic: Callable[..., Values]
    barrier: Callable[..., Values]
    sliding: Callable[..., Values]


PROJECTED = Matrices(elastic_matrix, barrier_matrix, sliding_matrix)
EXACT = Matrices(exact_elastic_matrix, exact_barrier_matrix, exact_sliding_matrix)


__all__ = ["HINGE_PAIRS", "TRIANGLE_PAIRS", "ElasticSlots", "Frame", "Kernels"]
