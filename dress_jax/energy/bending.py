"""Bending at hinges: the discrete shell energy k_b/2 theta^2 e/h (S1.8)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dress_jax.core import components as c
from dress_jax.core.components import Components

# Pairs of stencil vertices (p, q), p <= q, in the order of the blocks.
HINGE_PAIRS = tuple((p, q) for p in range(4) for q in range(p, 4))


def hinge_angle(x0: Components, x1: Components, x2: Components, x3: Components) -> Array:
    """Signed dihedral angle [rad] at edge (x0, x1) between triangles (x0, x1, x2), (x1, x0, x3).

    Zero when flat. The arctangent keeps its derivative up to a full fold.
    """
    edge = c.subtract(x1, x0)
    left = c.cross(edge, c.subtract(x2, x0))
    right = c.cross(c.subtract(x3, x0), edge)
    length = jnp.sqrt(c.dot(edge, edge))
    sine = c.dot(c.cross(left, right), edge) / length
    return jnp.arctan2(sine, c.dot(left, right))


def bending_energy(
    positions: Components,
    hinges: Int[Array, "4 h"],
    weights: Float[Array, " h"],
    bending_stiffness: Float[Array, ""] | Float[Array, " h"],
) -> Float[Array, ""]:
    """Sum over hinges of k_b/2 theta^2 e/h [J].

    With h = (A1 + A2) / e this is k_b/2 times the squared curvature of a rolled sheet, integrated,
    so k_b is the flexural rigidity of the cloth [N m]. The rest angle is zero.

    Args:
        positions: components (3 of (n,)) of the vertices [m].
        weights: e/h of every hinge, see `rest.hinge_weights`.
    """
    stencil = [c.gather(positions, hinges[k]) for k in range(4)]
    angle = hinge_angle(*stencil)
    return jnp.sum(0.5 * bending_stiffness * weights * angle**2)


def bending_vectors(
    positions: Components,
    hinges: Int[Array, "4 h"],
    weights: Float[Array, " h"],
    bending_stiffness: Float[Array, ""] | Float[Array, " h"],
) -> tuple[Float[Array, "4 3 h"], Float[Array, " h"]]:
    """The Gauss-Newton Hessian s v v^T of every hinge, positive semidefinite.

    Returns:
        v = grad(theta) per stencil vertex [1/m], and s = k_b e/h [N m].
    """
    stencil = [c.gather(positions, hinges[k]) for k in range(4)]
    gradient = jax.grad(lambda points: jnp.sum(hinge_angle(*points)))(stencil)
    return jnp.stack([jnp.stack(point) for point in gradient]), bending_stiffness * weights
