"""Strain limiting: a barrier that keeps every stretch of a triangle below a limit (C-IPC 2021).

With s the limit, r = s - s0 the width of the range in which the barrier acts, x = (sigma - s0) / r,

    b(x) = -x^2 ln(1 - x) for x > 0, else 0,

per rest area, at both singular values sigma of the deformation gradient. b is convex and rises, so
the energy is convex in the positions and its Hessian needs no projection. The largest singular
value is convex along a step, so the admissible part of a step is an interval.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dress_jax.core import components as c
from dress_jax.core.components import Components
from dress_jax.core.pytree import pytree
from dress_jax.energy.deformation import (
    FrameHessian,
    PrincipalFrame,
    area_ratio,
    deformation_gradient,
)
from dress_jax.energy.membrane import SingularDerivatives, singular_hessian
from dress_jax.energy.rest import RestTriangles

_ONSET = 0.5  # of the allowed strain, where the barrier begins
_KEPT_SHARE = 0.1  # of the distance to the limit that a step leaves, like that of collisions
_NEAR = (
    1e-3  # difference of the stretches over the distance to the limit, below which b is a series
)
_BISECTIONS = 20


@pytree
class StrainLimit:
    """A limit on the stretch of every triangle.

    Attributes:
        stretch: the limit s, above 1, () or per triangle (f,).
        stiffness: of the barrier [N/m], ().
    """

    stretch: Float[Array, ""] | Float[Array, " f"]
    stiffness: Float[Array, ""]


def _onset(limit: StrainLimit) -> tuple[Array, Array]:
    """Where the barrier begins, and the width of its range."""
    width = (1.0 - _ONSET) * (limit.stretch - 1.0)
    return limit.stretch - width, width


def _barrier(x: Array) -> Array:
    """b, infinite from the limit on."""
    inside = x < 1.0
    safe = jnp.where(inside & (x > 0.0), x, 0.0)
    return jnp.where(inside, -(safe**2) * jnp.log1p(-safe), jnp.inf)


def _derivatives(x: Array) -> tuple[Array, Array, Array]:
    """b', b'' and b'''' below the limit."""
    active = x > 0.0
    x = jnp.where(active, x, 0.0)
    log, rest = jnp.log1p(-x), 1.0 - x
    return (
        -2.0 * x * log + x**2 / rest,
        -2.0 * log + 4.0 * x / rest + x**2 / rest**2,
        jnp.where(active, 2.0 / rest**2 + 10.0 / rest**3 + 6.0 * x / rest**4, 0.0),
    )


def strain_limit_energy(
    positions: Components, faces: Int[Array, "3 f"], rest: RestTriangles, limit: StrainLimit
) -> Float[Array, ""]:
    """Sum over triangles of A k (b(s1) + b(s2)) [J]; infinite where a stretch reaches the limit.

    Where the two stretches are all but equal, their derivatives in F are not defined one by one,
    and the sum, an even function of their difference, is its series.

    Args:
        positions: components (3 of (n,)) of the vertices [m].
    """
    corners = [c.gather(positions, faces[k]) for k in range(3)]
    f1, f2 = deformation_gradient(corners, rest)
    squared, doubled = c.dot(f1, f1) + c.dot(f2, f2), 2.0 * area_ratio(f1, f2)
    onset, width = _onset(limit)
    middle = (0.5 * jnp.sqrt(squared + doubled) - onset) / width
    apart = 0.25 * (squared - doubled) / width**2  # square of half the difference
    near = apart < (_NEAR * (1.0 - middle)) ** 2
    half = jnp.sqrt(jnp.where(near, 1.0, apart))
    both = _barrier(jnp.where(near, 0.0, middle + half)) + _barrier(
        jnp.where(near, 0.0, middle - half)
    )
    centre = jnp.where(near & (middle < 1.0), middle, 0.0)
    _, second, fourth = _derivatives(centre)
    series = 2.0 * _barrier(centre) + second * apart + fourth * apart**2 / 12.0
    value = jnp.where(near, jnp.where(middle < 1.0, series, jnp.inf), both)
    return limit.stiffness * jnp.sum(rest.areas * value)


def strain_limit_hessian(
    frame: PrincipalFrame, areas: Float[Array, " f"], limit: StrainLimit
) -> FrameHessian:
    """The exact Hessian, positive semidefinite as it is.

    Args:
        frame: of triangles below the limit.
        areas: rest areas [m^2].
    """
    onset, width = _onset(limit)
    x1, x2 = (frame.s1 - onset) / width, (frame.s2 - onset) / width
    (d1, d11, _), (d2, d22, _) = _derivatives(x1), _derivatives(x2)
    middle = 0.5 * (x1 + x2)
    _, second, fourth = _derivatives(middle)
    near = x1 - x2 < 2.0 * _NEAR * (1.0 - middle)
    half = 0.5 * (x1 - x2)
    slope = jnp.where(
        near, second + fourth * half**2 / 6.0, (d1 - d2) / jnp.where(near, 1.0, x1 - x2)
    )
    d = SingularDerivatives(
        d1=d1 / width,
        d2=d2 / width,
        d11=d11 / width**2,
        d22=d22 / width**2,
        d12=jnp.zeros_like(d11),
        flip=slope / width**2,
        twist=(d1 + d2) / (width * (frame.s1 + frame.s2)),
    )
    return singular_hessian(frame, limit.stiffness * areas, d, project=False)


def largest_stretch(positions: Components, faces: Int[Array, "3 f"], rest: RestTriangles) -> Array:
    """The larger singular value of the deformation gradient of every triangle."""
    corners = [c.gather(positions, faces[k]) for k in range(3)]
    return _larger(*deformation_gradient(corners, rest))


def _larger(f1: Components, f2: Components) -> Array:
    a, b, off = c.dot(f1, f1), c.dot(f2, f2), c.dot(f1, f2)
    return jnp.sqrt(0.5 * (a + b) + jnp.sqrt(0.25 * (a - b) ** 2 + off**2))


@jax.jit
def strain_step_bound(
    positions: Float[Array, "n 3"],
    displacement: Float[Array, "n 3"],
    faces: Int[Array, "3 f"],
    rest: RestTriangles,
    limit: StrainLimit,
) -> Float[Array, ""]:
    """How far along the displacement every stretch stays below the limit, in (0, 1].

    A tenth of the distance to the limit is left. The largest singular value is convex along the
    displacement: a chord ends before the limit, and whatever lies before an admissible state is
    admissible.

    Args:
        positions: below the limit [m].
    """
    columns, moved = c.split(positions), c.split(displacement)
    gradients = [
        deformation_gradient([c.gather(x, faces[k]) for k in range(3)], rest)
        for x in (columns, moved)
    ]

    def stretch(t: Array) -> Array:
        return _larger(*(c.add(f, c.scale(t, d)) for f, d in zip(*gradients, strict=True)))

    zero = jnp.zeros_like(rest.areas)
    start = stretch(zero)
    goal = start + (1.0 - _KEPT_SHARE) * (limit.stretch - start)

    def narrow(_: int, state: tuple[Array, Array, Array, Array]):
        low, high, at_low, at_high = state
        rise = at_high - at_low
        chord = low + (high - low) * jnp.clip(
            (goal - at_low) / jnp.where(rise > 0.0, rise, 1.0), 0.0, 1.0
        )
        for point in (chord, 0.5 * (low + high)):
            value = stretch(point)
            fits = (value <= goal) & (point > low)
            misses = ~(value <= goal) & (point < high)
            low, at_low = jnp.where(fits, point, low), jnp.where(fits, value, at_low)
            high, at_high = jnp.where(misses, point, high), jnp.where(misses, value, at_high)
        return low, high, at_low, at_high

    end = stretch(zero + 1.0)
    low, *_ = jax.lax.fori_loop(0, _BISECTIONS, narrow, (zero, zero + 1.0, start, end))
    return jnp.min(jnp.where(end <= goal, 1.0, low), initial=1.0)
