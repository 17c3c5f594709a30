"""An orthotropic membrane: woven cloth that resists along warp, along weft and in shear.

The energy is quadratic in the Biot strain E = U - I, where F = R U, as that of ARAP is:

    psi = 1/2 (c_w E_w^2 + c_f E_f^2) + c_wf E_w E_f + 2 G E_s^2

per unit of rest area, in the frame of warp and weft. With Y the tensile moduli and nu the geometric
mean of the two Poisson ratios, c_w = Y_w / (1 - nu^2), c_f likewise and
c_wf = nu sqrt(Y_w Y_f) / (1 - nu^2). A strip at an angle a to the warp, pulled by the dead load p
per width of its rest shape, then stretches by p / Y(a) with

    1 / Y(a) = cos^4 a / Y_w + sin^4 a / Y_f + (1 / G - 2 nu / sqrt(Y_w Y_f)) sin^2 a cos^2 a,

exactly along warp and weft, and to first order in p in between, where it shears as well.

Under compression the force stays finite down to a collapsed triangle, as ARAP's. With
Y_w = Y_f = 2 k_s, G = k_s and nu = 0 the energy is ARAP.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dress_jax.core import components as c
from dress_jax.core.components import Components
from dress_jax.energy.deformation import (
    FrameHessian,
    PrincipalFrame,
    ShearCoupling,
    area_ratio,
    deformation_gradient,
    project_symmetric,
)
from dress_jax.energy.rest import RestTriangles


class OrthotropicStiffness(NamedTuple):
    """Elastic constants of an orthotropic membrane, each () or per triangle (f,).

    Attributes:
        warp, weft: tensile moduli Y_w, Y_f, times the thickness [N/m].
        shear: shear modulus G times the thickness [N/m].
        poisson_ratio: nu, the geometric mean of the two Poisson ratios, below 1.
        grain_angle: of the warp from the panel's +y, counter-clockwise [rad].
    """

    warp: Array
    weft: Array
    shear: Array
    poisson_ratio: Array
    grain_angle: Array


class _Strain(NamedTuple):
    """Components along warp and weft, and between them, of a symmetric tensor in the panel."""

    warp: Array
    weft: Array
    shear: Array


def _along_grain(xx: Array, yy: Array, xy: Array, cos: Array, sin: Array) -> _Strain:
    """A tensor in axes of which the warp is (-sin, cos) and the weft (cos, sin)."""
    cos2, sin2, both = cos * cos, sin * sin, sin * cos
    return _Strain(
        sin2 * xx + cos2 * yy - 2.0 * both * xy,
        cos2 * xx + sin2 * yy + 2.0 * both * xy,
        both * (yy - xx) + (cos2 - sin2) * xy,
    )


def orthotropic_density(f1: Components, f2: Components, stiffness: OrthotropicStiffness) -> Array:
    """psi [J/m^2] of the deformation gradient with the columns f1, f2."""
    a, b, off = c.dot(f1, f1), c.dot(f2, f2), c.dot(f1, f2)
    ratio = area_ratio(f1, f2)
    trace = jnp.sqrt(a + b + 2.0 * ratio)  # of U = (C + J I) / tr U, C = F^T F
    strain = _along_grain(
        (a + ratio) / trace - 1.0,
        (b + ratio) / trace - 1.0,
        off / trace,
        jnp.cos(stiffness.grain_angle),
        jnp.sin(stiffness.grain_angle),
    )
    stress = _stress(strain, stiffness)
    return (
        0.5 * (strain.warp * stress.warp + strain.weft * stress.weft) + strain.shear * stress.shear
    )


def _stress(strain: _Strain, stiffness: OrthotropicStiffness) -> _Strain:
    """The Biot stress [N/m], the derivative of psi in U."""
    nu = stiffness.poisson_ratio
    bound = 1.0 - nu * nu
    coupling = nu * jnp.sqrt(stiffness.warp * stiffness.weft) / bound
    return _Strain(
        stiffness.warp / bound * strain.warp + coupling * strain.weft,
        stiffness.weft / bound * strain.weft + coupling * strain.warp,
        2.0 * stiffness.shear * strain.shear,
    )


def orthotropic_energy(
    positions: Components,
    faces: Int[Array, "3 f"],
    rest: RestTriangles,
    stiffness: OrthotropicStiffness,
) -> Float[Array, ""]:
    """Sum over triangles of A psi [J].

    Args:
        positions: components (3 of (n,)) of the vertices [m].
    """
    corners: Sequence[Components] = [c.gather(positions, faces[k]) for k in range(3)]
    f1, f2 = deformation_gradient(corners, rest)
    return jnp.sum(rest.areas * orthotropic_density(f1, f2, stiffness))


def orthotropic_hessian(
    frame: PrincipalFrame,
    areas: Float[Array, " f"],
    stiffness: OrthotropicStiffness,
    *,
    project: bool = True,
) -> FrameHessian:
    """Hessians of all triangles in their principal frames.

    With a, d, b, c the in-plane components 11, 22, 12, 21 of dF, the stretch U changes by a, d and
    g = (s1 b + s2 c) / (s1 + s2), the rotation R by w = (c - b) / (s1 + s2). To second order psi
    gains dU:C:dU and, from the stress T in this frame,

        2 w S:dU + w^2 (T11 s1 + T22 s2),   S = ((-2 T12 s2, .), (., 2 T12 s1)) / (s1 + s2)
                                                with (T11 - T22) / 2 off the diagonal.

    C is positive definite, so the block is positive semidefinite just where the coefficient of w^2
    is at least S:C^-1:S (Schur's complement). Projected, it is mirrored at that value where it is
    less. Raised to the value itself, which for ARAP is the clamp of the eigenvalues, the block
    would have no resistance along a direction in which the stress, not aligned with the stretch,
    still works: steps of metres, and a squeezed sheet that never opens. Out of the plane stands a
    2x2 block, whose negative part is removed.

    Args:
        frame: of the triangles.
        areas: rest areas [m^2].
        project: whether to make them positive semidefinite.
    """
    s1, s2 = frame.s1, frame.s2
    total = s1 + s2
    # The grain in the frame of v1, v2, which stand at this angle to the panel's axes.
    cos_grain, sin_grain = jnp.cos(stiffness.grain_angle), jnp.sin(stiffness.grain_angle)
    cos = cos_grain * frame.v1[0] + sin_grain * frame.v1[1]
    sin = sin_grain * frame.v1[0] - cos_grain * frame.v1[1]

    zero = jnp.zeros_like(s1)
    stress = _stress(_along_grain(s1 - 1.0, s2 - 1.0, zero, cos, sin), stiffness)
    t11, t22, t12 = _from_grain(stress, cos, sin)

    def of_strain(xx: Array, yy: Array, xy: Array) -> tuple[Array, Array, Array]:
        return _from_grain(_stress(_along_grain(xx, yy, xy, cos, sin), stiffness), cos, sin)

    one = jnp.ones_like(s1)
    caa, cad, half_ag = of_strain(one, zero, zero)
    _, cdd, half_dg = of_strain(zero, one, zero)
    _, _, half_gg = of_strain(zero, zero, one)
    cag, cdg, cgg = 2.0 * half_ag, 2.0 * half_dg, 2.0 * half_gg

    wa, wd, wg = -2.0 * t12 * s2 / total, 2.0 * t12 * s1 / total, t11 - t22
    ww = t11 * s1 + t22 * s2
    n11, n22, n12 = t11 / s1, t22 / s2, 2.0 * t12 / total
    if project:
        least = _complementary(_along_grain(wa, wd, 0.5 * wg, cos, sin), stiffness)
        ww = least + jnp.abs(ww - least)
        n11, n22, n12 = project_symmetric(n11, n22, n12)

    gb, gc, wb, wc = s1 / total, s2 / total, -1.0 / total, 1.0 / total
    coupling = ShearCoupling(
        h1112=areas * (cag * gb + wa * wb),
        h1121=areas * (cag * gc + wa * wc),
        h1222=areas * (cdg * gb + wd * wb),
        h2122=areas * (cdg * gc + wd * wc),
        n12=areas * n12,
    )
    return FrameHessian(
        h1111=areas * caa,
        h1122=areas * cad,
        h2222=areas * cdd,
        h1212=areas * (cgg * gb**2 + 2.0 * wg * gb * wb + ww * wb**2),
        h1221=areas * (cgg * gb * gc + wg * (gb * wc + gc * wb) + ww * wb * wc),
        h2121=areas * (cgg * gc**2 + 2.0 * wg * gc * wc + ww * wc**2),
        n11=areas * n11,
        n22=areas * n22,
        coupling=coupling,
    )


def _from_grain(tensor: _Strain, cos: Array, sin: Array) -> tuple[Array, Array, Array]:
    """The components 11, 22, 12 of a tensor that is given along warp and weft."""
    cos2, sin2, both = cos * cos, sin * sin, sin * cos
    return (
        sin2 * tensor.warp + cos2 * tensor.weft - 2.0 * both * tensor.shear,
        cos2 * tensor.warp + sin2 * tensor.weft + 2.0 * both * tensor.shear,
        both * (tensor.weft - tensor.warp) + (cos2 - sin2) * tensor.shear,
    )


def _complementary(stress: _Strain, stiffness: OrthotropicStiffness) -> Array:
    """S:C^-1:S."""
    mixed = stiffness.poisson_ratio / jnp.sqrt(stiffness.warp * stiffness.weft)
    return (
        stress.warp**2 / stiffness.warp
        + stress.weft**2 / stiffness.weft
        - 2.0 * mixed * stress.warp * stress.weft
        + stress.shear**2 / stiffness.shear
    )
