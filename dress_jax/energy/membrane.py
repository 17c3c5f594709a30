"""Stretching of triangles: isotropic membranes, their gradients and projected Hessian blocks.

A model is an energy density of the 3x2 deformation gradient F for autodiff, and its first and
second derivatives in the singular values of F, from which the positive-semidefinite Hessian
follows in closed form (an eigendecomposition on the CPU costs twenty times more).
"""

import enum
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dress_jax.core import components as c
from dress_jax.core.components import Components
from dress_jax.energy.rest import RestTriangles


class MembraneModel(enum.Enum):
    """Choice of the membrane (S1.6)."""

    ARAP = "arap"
    NEO_HOOKEAN = "neo-hookean"


class SingularDerivatives(NamedTuple):
    """Derivatives of a density in the singular values s1 >= s2 of F, per unit shear modulus."""

    d1: Array
    d2: Array
    d11: Array
    d22: Array
    d12: Array
    flip: Array  # (d1 - d2) / (s1 - s2), finite where s1 = s2
    twist: Array  # (d1 + d2) / (s1 + s2)


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


def _area_ratio(f1: Components, f2: Components) -> Array:
    """J = |f1 x f2|, with a zero derivative where the triangle is a line."""
    normal = c.cross(f1, f2)
    squared = c.dot(normal, normal)
    flat = squared <= 0.0
    return jnp.where(flat, 0.0, jnp.sqrt(jnp.where(flat, 1.0, squared)))


def arap_density(f1: Components, f2: Components) -> Array:
    """||F - R(F)||^2, the squared distance to the closest rotation (S1.7).

    Equals |F|^2 - 2 (s1 + s2) + 2 with the sum of singular values sqrt(|F|^2 + 2 J).
    """
    squared = c.dot(f1, f1) + c.dot(f2, f2)
    return squared - 2.0 * jnp.sqrt(squared + 2.0 * _area_ratio(f1, f2)) + 2.0


def neo_hookean_density(f1: Components, f2: Components, poisson_ratio: Array) -> Array:
    """(|F|^2 - 2 - 2 ln J) / 2 + (lambda / mu) / 2 ln^2 J, with plane-stress lambda."""
    squared = c.dot(f1, f1) + c.dot(f2, f2)
    log_ratio = jnp.log(_area_ratio(f1, f2))
    ratio = 2.0 * poisson_ratio / (1.0 - poisson_ratio)
    return 0.5 * (squared - 2.0 - 2.0 * log_ratio) + 0.5 * ratio * log_ratio**2


def density(model: MembraneModel, f1: Components, f2: Components, poisson_ratio: Array) -> Array:
    """Energy density over the stretching stiffness, dimensionless."""
    if model is MembraneModel.ARAP:
        return arap_density(f1, f2)
    return neo_hookean_density(f1, f2, poisson_ratio)


def membrane_energy(
    positions: Components,
    faces: Int[Array, "3 f"],
    rest: RestTriangles,
    stretching_stiffness: Float[Array, ""] | Float[Array, " f"],
    poisson_ratio: Float[Array, ""],
    model: MembraneModel,
) -> Float[Array, ""]:
    """Sum over triangles of A k_s psi(F) [J].

    Args:
        positions: components (3 of (n,)) of the vertices [m].
        stretching_stiffness: k_s [N/m], the shear modulus times the thickness; both models agree
            with it for small strains without a Poisson effect.
    """
    corners = [c.gather(positions, faces[k]) for k in range(3)]
    f1, f2 = deformation_gradient(corners, rest)
    return jnp.sum(stretching_stiffness * rest.areas * density(model, f1, f2, poisson_ratio))


def singular_derivatives(
    model: MembraneModel, s1: Array, s2: Array, poisson_ratio: Array
) -> SingularDerivatives:
    """First and second derivatives of the density in the singular values."""
    if model is MembraneModel.ARAP:
        two = jnp.full_like(s1, 2.0)
        d1, d2 = 2.0 * (s1 - 1.0), 2.0 * (s2 - 1.0)
        return SingularDerivatives(d1, d2, two, two, 0.0 * two, two, (d1 + d2) / (s1 + s2))
    ratio = 2.0 * poisson_ratio / (1.0 - poisson_ratio)
    log_ratio = jnp.log(s1 * s2)
    d1 = s1 - 1.0 / s1 + ratio * log_ratio / s1
    d2 = s2 - 1.0 / s2 + ratio * log_ratio / s2
    d11 = 1.0 + 1.0 / s1**2 + ratio * (1.0 - log_ratio) / s1**2
    d22 = 1.0 + 1.0 / s2**2 + ratio * (1.0 - log_ratio) / s2**2
    d12 = ratio / (s1 * s2)
    flip = 1.0 + (1.0 - ratio * log_ratio) / (s1 * s2)
    return SingularDerivatives(d1, d2, d11, d22, d12, flip, (d1 + d2) / (s1 + s2))


def _project_symmetric(a: Array, b: Array, off: Array) -> tuple[Array, Array, Array]:
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


# Pairs of corners (p, q), p <= q, in the order of the blocks.
TRIANGLE_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_SMALLEST_STRETCH = 1e-9  # a triangle this thin is refused before the solve; only guards 0/0


class MembraneFrame(NamedTuple):
    """A triangle's Hessian in the frame of its singular vectors.

    Attributes:
        axes: left singular vectors u1, u2 and the normal, components (f,) each.
        alpha, beta: shape gradients of the corners along the right singular vectors, (3, f).
        s11, s22, s12: stretch block; twist, flip; n1, n2: normal modes; all times k_s A, (f,).
    """

    axes: tuple[Components, Components, Components]
    alpha: Float[Array, "3 f"]
    beta: Float[Array, "3 f"]
    s11: Array
    s22: Array
    s12: Array
    twist: Array
    flip: Array
    n1: Array
    n2: Array


def membrane_frame(
    positions: Components,
    faces: Int[Array, "3 f"],
    rest: RestTriangles,
    stretching_stiffness: Float[Array, ""] | Float[Array, " f"],
    poisson_ratio: Float[Array, ""],
    model: MembraneModel,
    *,
    project: bool = True,
) -> MembraneFrame:
    """Hessians of all triangles, projected to positive semidefinite in closed form.

    In the frame of the singular vectors the Hessian of an isotropic density falls into a 2x2
    stretch block, a twist, a flip and two normal modes; each is clamped on its own.
    """
    corners = [c.gather(positions, faces[k]) for k in range(3)]
    f1, f2 = deformation_gradient(corners, rest)
    a, b, off = c.dot(f1, f1), c.dot(f2, f2), c.dot(f1, f2)
    area_ratio = jnp.maximum(_area_ratio(f1, f2), _SMALLEST_STRETCH**2)
    radius = jnp.sqrt(0.25 * (a - b) ** 2 + off**2)
    s1 = jnp.sqrt(0.5 * (a + b) + radius)
    s2 = jnp.maximum(area_ratio / s1, _SMALLEST_STRETCH)
    angle = 0.5 * jnp.arctan2(2.0 * off, a - b)
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    u1 = c.scale(1.0 / s1, c.add(c.scale(cos, f1), c.scale(sin, f2)))
    u2 = c.scale(1.0 / s2, c.subtract(c.scale(cos, f2), c.scale(sin, f1)))

    d = singular_derivatives(model, s1, s2, poisson_ratio)
    s11, s22, s12 = d.d11, d.d22, d.d12
    modes = (d.twist, d.flip, d.d1 / s1, d.d2 / s2)
    if project:
        s11, s22, s12 = _project_symmetric(s11, s22, s12)
        modes = tuple(jnp.maximum(mode, 0.0) for mode in modes)

    i00, i01, i10, i11 = rest.inverse
    shape = [(-i00 - i10, -i01 - i11), (i00, i01), (i10, i11)]
    stiffness = stretching_stiffness * rest.areas
    return MembraneFrame(
        (u1, u2, c.cross(u1, u2)),
        jnp.stack([g[0] * cos + g[1] * sin for g in shape]),
        jnp.stack([g[1] * cos - g[0] * sin for g in shape]),
        *(stiffness * value for value in (s11, s22, s12, *modes)),
    )


def membrane_blocks(
    frame: MembraneFrame,
    alpha: tuple[Float[Array, "pairs f"], Float[Array, "pairs f"]],
    beta: tuple[Float[Array, "pairs f"], Float[Array, "pairs f"]],
) -> list[list[Array]]:
    """Hessian blocks of pairs of corners.

    Args:
        frame: see `membrane_frame`.
        alpha, beta: its shape gradients at the first and the second corner of each pair.

    Returns:
        A 3x3 nested list of (pairs, f) arrays [N/m].
    """
    u1, u2, normal = frame.axes
    aa, bb, ab, ba = (
        alpha[0] * alpha[1],
        beta[0] * beta[1],
        alpha[0] * beta[1],
        beta[0] * alpha[1],
    )
    mean, difference = 0.5 * (frame.flip + frame.twist), 0.5 * (frame.flip - frame.twist)
    k11, k22 = frame.s11 * aa + mean * bb, frame.s22 * bb + mean * aa
    k12, k21 = frame.s12 * ab + difference * ba, frame.s12 * ba + difference * ab
    k33 = frame.n1 * aa + frame.n2 * bb
    return [
        [
            u1[i] * (k11 * u1[j] + k12 * u2[j])
            + u2[i] * (k21 * u1[j] + k22 * u2[j])
            + normal[i] * k33 * normal[j]
            for j in range(3)
        ]
        for i in range(3)
    ]


def principal_stretches(
    positions: Float[Array, "n 3"], faces: Int[Array, "3 f"], rest: RestTriangles
) -> tuple[Float[Array, " f"], Float[Array, " f"]]:
    """Singular values (larger, smaller) of the deformation gradient of every triangle."""
    columns = c.split(positions)
    corners = [c.gather(columns, faces[k]) for k in range(3)]
    f1, f2 = deformation_gradient(corners, rest)
    a, b, off = c.dot(f1, f1), c.dot(f2, f2), c.dot(f1, f2)
    largest = jnp.sqrt(0.5 * (a + b) + jnp.sqrt(0.25 * (a - b) ** 2 + off**2))
    return largest, _area_ratio(f1, f2) / largest


principal_stretches = jax.jit(principal_stretches)
