"""The compiled pieces of a Newton iteration.

Elasticity and the two families of contact pairs are compiled apart, so that a new capacity of one
pair list recompiles one small program. Each has a value, a gradient, an exact Hessian product, and
projected blocks scattered into the sparse matrix.
"""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dress_jax.contact.barrier import ContactSettings
from dress_jax.contact.friction import friction_blocks, friction_energy
from dress_jax.contact.potential import (
    CONTACT_PAIRS,
    PairKind,
    active_pairs,
    contact_blocks,
    contact_energy,
)
from dress_jax.core import components as c
from dress_jax.core.pytree import pytree
from dress_jax.energy.bending import HINGE_PAIRS, bending_blocks
from dress_jax.energy.cloth import Cloth, Parameters, vertex_masses
from dress_jax.energy.elastic import TimeStep, elastic_energy, rest_hinges
from dress_jax.energy.membrane import TRIANGLE_PAIRS, membrane_blocks
from dress_jax.energy.rest import rest_triangles, vertex_areas
from dress_jax.solver.block_matrix import BlockSlots, Values, empty_values, scatter_blocks


@pytree
class Pairs:
    """One family of pairs, padded.

    Attributes:
        indices: stencil vertices, (4, m).
        count: number of true pairs, ().
    """

    indices: Int[Array, "4 m"]
    count: Int[Array, ""]


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


def barrier_energy(
    positions: Float[Array, "n 3"],
    parameters: Parameters,
    cloth: Cloth,
    frame: Frame,
    pairs: Pairs,
    *,
    kind: PairKind,
) -> Float[Array, ""]:
    """The barrier of one family of pairs [J]."""
    return contact_energy(
        _everything(positions, parameters),
        all_areas(parameters, cloth, frame),
        pairs.indices,
        pairs.count,
        parameters.barrier_stiffness,
        frame.settings,
        kind=kind,
    )


def _friction_arguments(
    positions: Array, parameters: Parameters, cloth: Cloth, frame: Frame, pairs: Pairs
) -> tuple:
    step_length = 1.0 / frame.step.inverse_step
    return (
        _everything(positions, parameters),
        jnp.concatenate([frame.step.start, frame.body_start]),
        all_areas(parameters, cloth, frame),
        pairs.indices,
        pairs.count,
        parameters.barrier_stiffness,
        parameters.friction_coefficient,
        frame.settings.slip_speed * step_length,
        frame.settings,
    )


def sliding_energy(
    positions: Float[Array, "n 3"],
    parameters: Parameters,
    cloth: Cloth,
    frame: Frame,
    pairs: Pairs,
    *,
    kind: PairKind,
) -> Float[Array, ""]:
    """Friction of the pairs that were in contact at the start of the step [J]."""
    arguments = _friction_arguments(positions, parameters, cloth, frame, pairs)
    return friction_energy(*arguments, kind=kind)


def total_energy(
    positions: Float[Array, "n 3"],
    parameters: Parameters,
    cloth: Cloth,
    frame: Frame,
    vertex_face: Pairs,
    edge_edge: Pairs,
    friction: tuple[Pairs, Pairs] | None,
) -> Float[Array, ""]:
    """The whole incremental potential (S1.2), as one function for the adjoint."""
    total = elastic_energy(positions, frame.step, parameters, cloth)
    for kind, pairs in ((PairKind.VERTEX_FACE, vertex_face), (PairKind.EDGE_EDGE, edge_edge)):
        total = total + barrier_energy(positions, parameters, cloth, frame, pairs, kind=kind)
    if friction is not None:
        for kind, pairs in zip(PairKind, friction, strict=True):
            total = total + sliding_energy(positions, parameters, cloth, frame, pairs, kind=kind)
    return total


def _elastic(positions: Array, parameters: Parameters, cloth: Cloth, frame: Frame) -> Array:
    return elastic_energy(positions, frame.step, parameters, cloth)


elastic_value = jax.jit(_elastic)
elastic_gradient = jax.jit(jax.value_and_grad(_elastic))
barrier_value = jax.jit(barrier_energy, static_argnames="kind")
sliding_value = jax.jit(sliding_energy, static_argnames="kind")


@functools.partial(jax.jit, static_argnames="kind")
def barrier_gradient(positions, parameters, cloth, frame, pairs, *, kind):
    """Value and gradient of `barrier_energy`."""
    return jax.value_and_grad(barrier_energy)(positions, parameters, cloth, frame, pairs, kind=kind)


@functools.partial(jax.jit, static_argnames="kind")
def sliding_gradient(positions, parameters, cloth, frame, pairs, *, kind):
    """Value and gradient of `sliding_energy`."""
    return jax.value_and_grad(sliding_energy)(positions, parameters, cloth, frame, pairs, kind=kind)


@jax.jit
def elastic_product(positions, direction, parameters, cloth, frame):
    """Exact Hessian of the elastic energy times a direction."""

    def gradient(x):
        return jax.grad(_elastic)(x, parameters, cloth, frame)

    return jax.jvp(gradient, (positions,), (direction,))[1]


@functools.partial(jax.jit, static_argnames="kind")
def barrier_product(positions, direction, parameters, cloth, frame, pairs, *, kind):
    """Exact Hessian of the barrier times a direction."""

    def gradient(x):
        return jax.grad(barrier_energy)(x, parameters, cloth, frame, pairs, kind=kind)

    return jax.jvp(gradient, (positions,), (direction,))[1]


@functools.partial(jax.jit, static_argnames="kind")
def sliding_product(positions, direction, parameters, cloth, frame, pairs, *, kind):
    """Exact Hessian of friction times a direction."""

    def gradient(x):
        return jax.grad(sliding_energy)(x, parameters, cloth, frame, pairs, kind=kind)

    return jax.jvp(gradient, (positions,), (direction,))[1]


@functools.partial(jax.jit, static_argnames="kind")
def find_active(positions, parameters, frame, pairs, *, kind):
    """Mask of the pairs closer than dhat, and the smallest squared distance."""
    everything = _everything(positions, parameters)
    return active_pairs(everything, pairs.indices, pairs.count, frame.settings, kind=kind)


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
    values = scatter_blocks(
        values,
        membrane_blocks(
            x,
            cloth.faces,
            rest,
            parameters.stretching_stiffness,
            parameters.poisson_ratio,
            cloth.membrane,
        ),
        slots.triangles,
    )
    values = scatter_blocks(
        values,
        bending_blocks(
            x, cloth.hinges, rest_hinges(parameters, cloth), parameters.bending_stiffness
        ),
        slots.hinges,
    )
    masses = vertex_masses(parameters, cloth) * frame.step.inverse_step**2
    signs = (1.0, -1.0, 1.0)  # of the pairs (0, 0), (0, 1), (1, 1) of a stitch
    out = list(values)
    for k in range(3):
        total = out[4 * k].at[slots.diagonal].add(masses)
        total = total.at[slots.pins].add(parameters.pin_stiffness)
        for pair, sign in enumerate(signs):
            total = total.at[slots.stitches.slots[pair]].add(sign * parameters.stitch_stiffness)
        out[4 * k] = total
    return tuple(out)


@functools.partial(jax.jit, static_argnames="kind")
def barrier_matrix(
    values: Values,
    positions: Float[Array, "n 3"],
    parameters: Parameters,
    cloth: Cloth,
    frame: Frame,
    pairs: Pairs,
    slots: BlockSlots,
    *,
    kind: PairKind,
) -> Values:
    """Add the rank-one blocks of the barrier."""
    weights, normal, stiffness = contact_blocks(
        _everything(positions, parameters),
        all_areas(parameters, cloth, frame),
        pairs.indices,
        pairs.count,
        parameters.barrier_stiffness,
        frame.settings,
        kind=kind,
    )
    outer = [[stiffness * normal[i] * normal[j] for j in range(3)] for i in range(3)]
    blocks = [
        [[weights[p] * weights[q] * outer[i][j] for j in range(3)] for i in range(3)]
        for p, q in CONTACT_PAIRS
    ]
    return scatter_blocks(values, blocks, slots)


@functools.partial(jax.jit, static_argnames="kind")
def sliding_matrix(
    values: Values,
    positions: Float[Array, "n 3"],
    parameters: Parameters,
    cloth: Cloth,
    frame: Frame,
    pairs: Pairs,
    slots: BlockSlots,
    *,
    kind: PairKind,
) -> Values:
    """Add the blocks of friction."""
    arguments = _friction_arguments(positions, parameters, cloth, frame, pairs)
    weights, normal, stiffness = friction_blocks(*arguments, kind=kind)
    outer = [
        [stiffness * ((1.0 if i == j else 0.0) - normal[i] * normal[j]) for j in range(3)]
        for i in range(3)
    ]
    blocks = [
        [[weights[p] * weights[q] * outer[i][j] for j in range(3)] for i in range(3)]
        for p, q in CONTACT_PAIRS
    ]
    return scatter_blocks(values, blocks, slots)


__all__ = [
    "HINGE_PAIRS",
    "TRIANGLE_PAIRS",
    "ElasticSlots",
    "Frame",
    "Pairs",
]
