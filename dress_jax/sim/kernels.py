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
from dress_jax.energy.bending import HINGE_PAIRS, bending_vectors
from dress_jax.energy.cloth import Cloth, Parameters, vertex_masses
from dress_jax.energy.elastic import TimeStep, elastic_energy, rest_hinges
from dress_jax.energy.membrane import TRIANGLE_PAIRS, membrane_blocks, membrane_frame
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


def frame_energy(
    positions: Float[Array, "n 3"], parameters: Parameters, cloth: Cloth, frame: Frame
) -> Float[Array, ""]:
    """The energy without contact [J]."""
    return elastic_energy(positions, frame.step, parameters, cloth)


elastic_value = jax.jit(frame_energy)
elastic_gradient = jax.jit(jax.value_and_grad(frame_energy))
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
        return jax.grad(frame_energy)(x, parameters, cloth, frame)

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
    vectors = weights[:, None, :] * jnp.stack(normal)[None]
    return scatter_outer(values, vectors, stiffness, CONTACT_PAIRS, slots)


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
    first, second = first_and_second(weights, CONTACT_PAIRS, slots)
    scale = first * second * stiffness[None, :]
    blocks = [
        [scale * ((1.0 if i == j else 0.0) - (normal[i] * normal[j])[None, :]) for j in range(3)]
        for i in range(3)
    ]
    return scatter_blocks(values, blocks, slots.slots)


__all__ = [
    "HINGE_PAIRS",
    "TRIANGLE_PAIRS",
    "ElasticSlots",
    "Frame",
    "Pairs",
]
