"""Kinematics of triangles: deformation gradients and their principal frames."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dress_jax.core import components as c
from dress_jax.core.components import Components
from dress_jax.energy.rest import RestTriangles

_SMALLEST_STRETCH = 1e-9  # a triangle this thin is refused before the solve; only guards 0/0


def deformation_gradient(
    corners: Sequence[Components], rest: RestTriangles
) -> tuple[Components, Components]:
    """The two columns of F = [x1 - x0, x2 - x0] D^-1."""
    first = c.subtract(corners[1], corners[0])
    second = c.subtract(corners[2], corners[0])
    i00, i01, i10, i11 = rest.inverse
    return (
        c.add(c.scale(i00, first), c.scale(i10, second)),
        c.add(c.scale(i01, first), c.scale(i11, second)),
    )


def area_ratio(f1: Components, f2: Components) -> Array:
    """J = |f1 x f2|, with a zero derivative where the triangle is a line."""
    normal = c.cross(f1, f2)
    squared = c.dot(normal, normal)
    flat = squared <= 0.0
    return jnp.where(flat, 0.0, jnp.sqrt(jnp.where(flat, 1.0, squared)))


class PrincipalFrame(NamedTuple):
    """Singular value decomposition F = [u1 u2] diag(s1, s2) [v1 v2]^T of every triangle.

    Attributes:
        s1, s2: singular values, s1 >= s2, (f,).
        axes: u1, u2 and the normal, components (f,) each.
        v1: components of v1 in panel coordinates; v2 is v1 turned by 90 degrees.
        alpha, beta: shape gradients of the corners along v1 and v2 [1/m], (3, f).
    """

    s1: Array
    s2: Array
    axes: tuple[Components, Components, Components]
    v1: tuple[Array, Array]
    alpha: Float[Array, "3 f"]
    beta: Float[Array, "3 f"]


def principal_frame(
    positions: Components, faces: Int[Array, "3 f"], rest: RestTriangles
) -> PrincipalFrame:
    """The principal frames of all triangles, in closed form."""
    corners = [c.gather(positions, faces[k]) for k in range(3)]
    f1, f2 = deformation_gradient(corners, rest)
    a, b, off = c.dot(f1, f1), c.dot(f2, f2), c.dot(f1, f2)
    ratio = jnp.maximum(area_ratio(f1, f2), _SMALLEST_STRETCH**2)
    radius = jnp.sqrt(0.25 * (a - b) ** 2 + off**2)
    s1 = jnp.sqrt(0.5 * (a + b) + radius)
    s2 = jnp.maximum(ratio / s1, _SMALLEST_STRETCH)
    angle = 0.5 * jnp.arctan2(2.0 * off, a - b)
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    u1 = c.scale(1.0 / s1, c.add(c.scale(cos, f1), c.scale(sin, f2)))
    u2 = c.scale(1.0 / s2, c.subtract(c.scale(cos, f2), c.scale(sin, f1)))
    i00, i01, i10, i11 = rest.inverse
    shape = [(-i00 - i10, -i01 - i11), (i00, i01), (i10, i11)]
    return PrincipalFrame(
        s1,
        s2,
        (u1, u2, c.cross(u1, u2)),
        (cos, sin),
        jnp.stack([g[0] * cos + g[1] * sin for g in shape]),
        jnp.stack([g[1] * cos - g[0] * sin for g in shape]),
    )


class ShearCoupling(NamedTuple):
    """The part of a `FrameHessian` that couples stretches with shears, and both normal modes."""

    h1112: Array
    h1121: Array
    h1222: Array
    h2122: Array
    n12: Array


class FrameHessian(NamedTuple):
    """Second derivatives of an energy of triangles in dF, in their principal frames.

    `hikjl` belongs to the components (i, k) and (j, l) of dF, (i, k) along u_i per v_k; `n..` to
    those along the normal. All times the rest area, (f,). Isotropic densities have no coupling.
    """

    h1111: Array
    h1122: Array
    h2222: Array
    h1212: Array
    h1221: Array
    h2121: Array
    n11: Array
    n22: Array
    coupling: ShearCoupling | None = None


def add_isotropic(hessian: FrameHessian, isotropic: FrameHessian) -> FrameHessian:
    """The sum of a Hessian and one without coupling, in the same frames."""
    sums = (a + b for a, b in zip(hessian[:-1], isotropic[:-1], strict=True))
    return FrameHessian(*sums, coupling=hessian.coupling)


def project_symmetric(a: Array, b: Array, off: Array) -> tuple[Array, Array, Array]:
    """The positive-semidefinite part of [[a, off], [off, b]], in closed form."""
    mean, half = 0.5 * (a + b), 0.5 * (a - b)
    radius = jnp.sqrt(half**2 + off**2)
    high, low = mean + radius, mean - radius
    high_part, low_part = jnp.maximum(high, 0.0), jnp.maximum(low, 0.0)
    isotropic = radius <= 1e-14 * jnp.abs(mean)
    slope = jnp.where(
        isotropic, 0.0, (high_part - low_part) / jnp.where(isotropic, 1.0, 2.0 * radius)
    )
    middle = 0.5 * (high_part + low_part)
    return middle + slope * half, middle - slope * half, slope * off
