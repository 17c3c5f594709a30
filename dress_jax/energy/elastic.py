"""The energy of a cloth without contact: a sum of registered terms."""

from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float

from dress_jax.core import components as c
from dress_jax.core.components import Components
from dress_jax.core.pytree import pytree
from dress_jax.energy.bending import bending_energy
from dress_jax.energy.cloth import Cloth, Parameters, vertex_masses
from dress_jax.energy.rest import hinge_anisotropy, hinge_weights, rest_triangles
from dress_jax.energy.stretching import stretching_energy, stretching_rest


@pytree
class TimeStep:
    """What an implicit time step carries over from the last state.

    Attributes:
        start: positions x^n [m], (n, 3).
        velocity: v^n [m/s], (n, 3).
        inverse_step: 1/h [1/s], (); zero leaves inertia out (a true static solve).
    """

    start: Float[Array, "n 3"]
    velocity: Float[Array, "n 3"]
    inverse_step: Float[Array, ""]


Term = Callable[[Components, TimeStep, Parameters, Cloth], Array]


def inertia(x: Components, step: TimeStep, parameters: Parameters, cloth: Cloth) -> Array:
    """m/2 |(x - x^n)/h - v^n|^2: the incremental potential over h^2 (S1.2, S1.3, S1.5).

    Divided by h^2, elasticity and contact keep their own units and no term depends on h.
    """
    start, velocity = c.split(step.start), c.split(step.velocity)
    change = c.subtract(c.scale(step.inverse_step, c.subtract(x, start)), velocity)
    return jnp.sum(0.5 * vertex_masses(parameters, cloth) * c.dot(change, change))


def weight(x: Components, step: TimeStep, parameters: Parameters, cloth: Cloth) -> Array:
    """-m g.(x - x^n), counted from x^n so that small changes are not lost to rounding."""
    moved = c.subtract(x, c.split(step.start))
    g = tuple(parameters.gravity[k] for k in range(3))
    return -jnp.sum(vertex_masses(parameters, cloth) * c.dot(moved, g))


def membrane(x: Components, step: TimeStep, parameters: Parameters, cloth: Cloth) -> Array:
    """Stretching, see `membrane` and `orthotropic`."""
    rest = stretching_rest(parameters, cloth)
    return stretching_energy(x, cloth.faces, rest, parameters, cloth.membrane)


def bending(x: Components, step: TimeStep, parameters: Parameters, cloth: Cloth) -> Array:
    """Bending, see `bending_energy`."""
    return bending_energy(
        x, cloth.hinges, rest_hinges(parameters, cloth), parameters.bending_stiffness
    )


def pins(x: Components, step: TimeStep, parameters: Parameters, cloth: Cloth) -> Array:
    """k/2 |x - target|^2 at every pin."""
    offset = c.subtract(c.gather(x, cloth.pins), c.split(parameters.pin_targets))
    return 0.5 * parameters.pin_stiffness * jnp.sum(c.dot(offset, offset))


def stitches(x: Components, step: TimeStep, parameters: Parameters, cloth: Cloth) -> Array:
    """k/2 |x_a - x_b|^2 at every stitch (S1.17)."""
    gap = c.subtract(c.gather(x, cloth.stitches[0]), c.gather(x, cloth.stitches[1]))
    return 0.5 * parameters.stitch_stiffness * jnp.sum(c.dot(gap, gap))


TERMS: dict[str, Term] = {
    "inertia": inertia,
    "weight": weight,
    "membrane": membrane,
    "bending": bending,
    "pins": pins,
    "stitches": stitches,
}


def rest_hinges(parameters: Parameters, cloth: Cloth) -> Float[Array, " h"]:
    """The weights e/h of the cloth's hinges, times their factors for warp and weft."""
    rest, faces = parameters.rest_positions, cloth.rest_faces
    hinges = cloth.hinge_faces, cloth.hinge_corners
    weights = hinge_weights(rest, faces, rest_triangles(rest, faces).areas, *hinges)
    directions = parameters.bending_anisotropy, parameters.grain_angle
    return weights * hinge_anisotropy(rest, faces, *hinges, *directions)


def elastic_energy(
    positions: Float[Array, "n 3"], step: TimeStep, parameters: Parameters, cloth: Cloth
) -> Float[Array, ""]:
    """The sum of all terms [J].

    Args:
        positions: [m], (n, 3).
    """
    x = c.split(positions)
    total = jnp.zeros((), positions.dtype)
    for term in TERMS.values():
        total = total + term(x, step, parameters, cloth)
    return total
