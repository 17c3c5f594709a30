"""The energies of a step and their derivatives, compiled.

Elasticity and the two families of contact pairs are compiled apart, so that a new capacity of one
pair list recompiles one small program. Each has a value, a gradient and an exact Hessian product;
their sparse Hessians are in `matrices`.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from dress_jax.contact.barrier import ContactSettings
from dress_jax.contact.friction import Friction, friction_energy
from dress_jax.contact.potential import (
    Contact,
    Pairs,
    active_pairs,
    contact_energy,
    mollifier,
    stencil_energy,
    stencils,
)
from dress_jax.core.pytree import pytree
from dress_jax.energy.cloth import Cloth, Parameters
from dress_jax.energy.elastic import TimeStep, elastic_energy
from dress_jax.energy.rest import rest_triangles, vertex_areas


@pytree
class Frame:
    """What all energies of one step share; made by `make_frame`.

    Attributes:
        step: state at the start of the time step.
        body_start: body vertices at the start of the step [m], (b, 3).
        areas: areas that the vertices of cloth and body stand for in contact [m^2], (n + b,).
        settings: lengths of the contact model.
    """

    step: TimeStep
    body_start: Float[Array, "b 3"]
    areas: Float[Array, " nb"]
    settings: ContactSettings


def make_frame(
    parameters: Parameters,
    cloth: Cloth,
    step: TimeStep,
    body_start: Float[Array, "b 3"],
    body_areas: Float[Array, " b"],
    settings: ContactSettings,
) -> Frame:
    """The frame of a step.

    The areas of the cloth are those of its rest shape. A derivative in the parameters has to go
    through this function, or it lacks how the weights of contact change.

    Args:
        body_areas: areas that body vertices stand for [m^2], (b,); constants.
    """
    areas = _contact_areas(parameters.rest_positions, cloth, body_areas)
    return Frame(step, body_start, areas, settings)


@jax.jit
def _contact_areas(
    rest_positions: Float[Array, "p 2"], cloth: Cloth, body_areas: Float[Array, " b"]
) -> Float[Array, " nb"]:
    rest = rest_triangles(rest_positions, cloth.rest_faces)
    return jnp.concatenate([vertex_areas(rest.areas, cloth.faces, cloth.vertex_count), body_areas])


def with_body(positions: Float[Array, "n 3"], parameters: Parameters) -> Float[Array, "nb 3"]:
    """Positions of the vertices of cloth and body [m]."""
    return jnp.concatenate([positions, parameters.body_vertices])


def make_contact(parameters: Parameters, frame: Frame, pairs: Pairs) -> Contact:
    """The barrier of one family of pairs."""
    return Contact(pairs, frame.areas, parameters.barrier_stiffness, frame.settings)


def make_friction(parameters: Parameters, frame: Frame, pairs: Pairs) -> Friction:
    """Friction of one family of pairs."""
    step_length = 1.0 / frame.step.inverse_step
    return Friction(
        contact=make_contact(parameters, frame, pairs),
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
    return contact_energy(with_body(positions, parameters), make_contact(parameters, frame, pairs))


def sliding_energy(
    positions: Float[Array, "n 3"],
    parameters: Parameters,
    cloth: Cloth,
    frame: Frame,
    pairs: Pairs,
) -> Float[Array, ""]:
    """Friction of the pairs that were in contact at the start of the step [J]."""
    friction = make_friction(parameters, frame, pairs)
    return friction_energy(with_body(positions, parameters), friction)


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


# The barrier's slopes in the stencils and their sum over vertices are programs of their own:
# in one, XLA on CPU computes a stencil anew for each of the twelve numbers that are added.


def _barrier_gradient(positions, parameters, cloth, frame, pairs):
    value, slopes = barrier_slopes(positions, parameters, frame, pairs)
    return value, _summed(slopes, pairs.indices, positions)


@jax.jit
def barrier_slopes(positions, parameters, frame, pairs):
    """The barrier of one family of pairs, and its derivative in the stencils, (4, 3, m)."""
    points, used = stencils(with_body(positions, parameters), pairs)
    contact = make_contact(parameters, frame, pairs)
    return jax.value_and_grad(stencil_energy)(points, used, contact)


@jax.jit
def _summed(stencil_rows, indices, positions):
    """Sums at the vertices of the cloth, (n, 3)."""
    rows = jnp.stack([stencil_rows[:, k].ravel() for k in range(3)], axis=1)
    return jnp.zeros_like(positions).at[indices.ravel()].add(rows, mode="drop")


ELASTIC = _kernels(frame_energy)
BARRIER = _kernels(barrier_energy)._replace(gradient=_barrier_gradient)
SLIDING = _kernels(sliding_energy)


@jax.jit
def find_active(positions, parameters, frame, pairs):
    """The pairs closer than dhat, and the smallest squared distances."""
    return active_pairs(with_body(positions, parameters), pairs, frame.settings)


@jax.jit
def find_parallel(everything, pairs):
    """Mask of the edge-edge pairs that the mollifier fades out."""
    points, _ = stencils(everything, pairs)
    return mollifier(points) < 1.0
