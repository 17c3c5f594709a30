"""Stretching of triangles: isotropic membranes, their gradients and projected Hessian blocks.

A model is an energy density of the 3x2 deformation gradient F for autodiff, and its first and
second derivatives in the singular values of F, from which the positive-semidefinite Hessian
follows in closed form (an eigendecomposition on the CPU costs twenty times more). The orthotropic
membrane is in `orthotropic`.
"""

import enum
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dress_jax.core import components as c
from dress_jax.core.components import Components
from dress_jax.energy.deformation import (
    FrameHessian,
    PrincipalFrame,
    area_ratio,
    deformation_gradient,
    principal_frame,
    project_symmetric,
)
from dress_jax.energy.rest import RestTriangles


class MembraneModel(enum.Enum):
    """Choice of the membrane (S1.6)."""

    ARAP = "arap"
    NEO_HOOKEAN = "neo-hookean"
    ORTHOTROPIC = "orthotropic"


class SingularDerivatives(NamedTuple):
    """Derivatives of a density in the singular values s1 >= s2 of F, per unit shear modulus."""

    d1: Array
    d2: Array
    d11: Array
    d22: Array
    d12: Array
    flip: Array  # (d1 - d2) / (s1 - s2), finite where s1 = s2
    twist: Array  # (d1 + d2) / (s1 + s2)


def arap_density(f1: Components, f2: Components) -> Array:
    """||F - R(F)||^2, the squared distance to the closest rotation (S1.7).

    Equals |F|^2 - 2 (s1 + s2) + 2 with the sum of singular values sqrt(|F|^2 + 2 J).
    """
    squared = c.dot(f1, f1) + c.dot(f2, f2)
    return squared - 2.0 * jnp.sqrt(squared + 2.0 * area_ratio(f1, f2)) + 2.0


def neo_hookean_density(f1: Components, f2: Components, poisson_ratio: Array) -> Array:
    """(|F|^2 - 2 - 2 ln J) / 2 + (lambda / mu) / 2 ln^2 J, with plane-stress lambda."""
    squared = c.dot(f1, f1) + c.dot(f2, f2)
    log_ratio = jnp.log(area_ratio(f1, f2))
    ratio = 2.0 * poisson_ratio / (1.0 - poisson_ratio)
    return 0.5 * (squared - 2.0 - 2.0 * log_ratio) + 0.5 * ratio * log_ratio**2


def density(model: MembraneModel, f1: Components, f2: Components, poisson_ratio: Array) -> Array:
    """Energy density of an isotropic model over the stretching stiffness, dimensionless."""
    if model is MembraneModel.ARAP:
        return arap_density(f1, f2)
    if model is MembraneModel.NEO_HOOKEAN:
        return neo_hookean_density(f1, f2, poisson_ratio)
    raise ValueError(f"{model} is not isotropic")


def membrane_energy(
    positions: Components,
    faces: Int[Array, "3 f"],
    rest: RestTriangles,
    stretching_stiffness: Float[Array, ""] | Float[Array, " f"],
    poisson_ratio: Float[Array, ""] | Float[Array, " f"],
    model: MembraneModel,
) -> Float[Array, ""]:
    """Sum over triangles of A k_s psi(F) [J], of an isotropic model.

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
    if model is not MembraneModel.NEO_HOOKEAN:
        raise ValueError(f"{model} is not isotropic")
    ratio = 2.0 * poisson_ratio / (1.0 - poisson_ratio)
    log_ratio = jnp.log(s1 * s2)
    d1 = s1 - 1.0 / s1 + ratio * log_ratio / s1
    d2 = s2 - 1.0 / s2 + ratio * log_ratio / s2
    d11 = 1.0 + 1.0 / s1**2 + ratio * (1.0 - log_ratio) / s1**2
    d22 = 1.0 + 1.0 / s2**2 + ratio * (1.0 - log_ratio) / s2**2
    d12 = ratio / (s1 * s2)
    flip = 1.0 + (1.0 - ratio * log_ratio) / (s1 * s2)
    return SingularDerivatives(d1, d2, d11, d22, d12, flip, (d1 + d2) / (s1 + s2))


# Pairs of corners (p, q), p <= q, in the order of the blocks.
TRIANGLE_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


class MembraneFrame(NamedTuple):
    """A triangle's Hessian in the frame of its singular vectors.

    Attributes:
        axes: left singular vectors u1, u2 and the normal, components (f,) each.
        alpha, beta: shape gradients of the corners along the right singular vectors, (3, f).
        hessian: second derivatives along these.
    """

    axes: tuple[Components, Components, Components]
    alpha: Float[Array, "3 f"]
    beta: Float[Array, "3 f"]
    hessian: FrameHessian


def isotropic_hessian(
    frame: PrincipalFrame,
    areas: Float[Array, " f"],
    stretching_stiffness: Float[Array, ""] | Float[Array, " f"],
    poisson_ratio: Float[Array, ""] | Float[Array, " f"],
    model: MembraneModel,
    *,
    project: bool = True,
) -> FrameHessian:
    """Hessians of all triangles in their principal frames."""
    d = singular_derivatives(model, frame.s1, frame.s2, poisson_ratio)
    return singular_hessian(frame, stretching_stiffness * areas, d, project=project)


def singular_hessian(
    frame: PrincipalFrame, scale: Array, d: SingularDerivatives, *, project: bool
) -> FrameHessian:
    """The Hessian of a function of the singular values.

    It falls into a 2x2 stretch block, a twist, a flip and two normal modes; projected, each is
    clamped on its own.

    Args:
        scale: factor of everything, (f,).
        project: whether to make it positive semidefinite.
    """
    s11, s22, s12 = d.d11, d.d22, d.d12
    twist, flip, n11, n22 = d.twist, d.flip, d.d1 / frame.s1, d.d2 / frame.s2
    if project:
        s11, s22, s12 = project_symmetric(s11, s22, s12)
        twist, flip, n11, n22 = (jnp.maximum(mode, 0.0) for mode in (twist, flip, n11, n22))
    mean = 0.5 * (flip + twist)
    return FrameHessian(
        h1111=scale * s11,
        h1122=scale * s12,
        h2222=scale * s22,
        h1212=scale * mean,
        h1221=scale * (0.5 * (flip - twist)),
        h2121=scale * mean,
        n11=scale * n11,
        n22=scale * n22,
    )


def membrane_frame(
    positions: Components,
    faces: Int[Array, "3 f"],
    rest: RestTriangles,
    stretching_stiffness: Float[Array, ""] | Float[Array, " f"],
    poisson_ratio: Float[Array, ""] | Float[Array, " f"],
    model: MembraneModel,
    *,
    project: bool = True,
) -> MembraneFrame:
    """Hessians of all triangles of an isotropic model, projected to positive semidefinite."""
    frame = principal_frame(positions, faces, rest)
    hessian = isotropic_hessian(
        frame, rest.areas, stretching_stiffness, poisson_ratio, model, project=project
    )
    return MembraneFrame(frame.axes, frame.alpha, frame.beta, hessian)


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
    h = frame.hessian
    aa, bb, ab, ba = (
        alpha[0] * alpha[1],
        beta[0] * beta[1],
        alpha[0] * beta[1],
        beta[0] * alpha[1],
    )
    k11, k22 = h.h1111 * aa + h.h1212 * bb, h.h2222 * bb + h.h2121 * aa
    k12, k21 = h.h1122 * ab + h.h1221 * ba, h.h1122 * ba + h.h1221 * ab
    k33 = h.n11 * aa + h.n22 * bb
    if h.coupling is not None:
        both = ab + ba
        k11, k22 = k11 + h.coupling.h1112 * both, k22 + h.coupling.h2122 * both
        mixed = h.coupling.h1121 * aa + h.coupling.h1222 * bb
        k12, k21, k33 = k12 + mixed, k21 + mixed, k33 + h.coupling.n12 * both
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
    return largest, area_ratio(f1, f2) / largest


principal_stretches = jax.jit(principal_stretches)
