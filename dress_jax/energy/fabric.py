"""The parameters of a solve, made from fabrics."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.core.errors import InputError
from dress_jax.energy.cloth import HINGE_LEAVES, Cloth, Gravity, Parameters
from dress_jax.energy.fabrics import FABRICS, named_fabric
from dress_jax.energy.material import Fabric
from dress_jax.energy.rest import rest_triangles
from dress_jax.energy.spread import panels_to_triangles, triangles_to_hinges
from dress_jax.energy.strain_limit import StrainLimit

__all__ = ["FABRICS", "Fabric", "Fabrics", "make_parameters", "named_fabric"]

BARRIER_STIFFNESS = 1.0e3  # [Pa]; cloth presses on a body with 1 to 1000 Pa, so gaps stay near dhat
PIN_STIFFNESS = 1.0e3  # [N/m]
STITCH_STIFFNESS = 100.0  # [N/m]
STRAIN_LIMIT_STIFFNESS = 10.0  # [N/m]; half way to a limit of 10 % it pulls with 240 N/m


Fabrics = Fabric | Sequence[Fabric]  # of the whole garment, or one per panel


def make_parameters(
    cloth: Cloth,
    fabric: Fabrics,
    rest_positions: Float[Array, "p 2"],
    *,
    face_panel: Int[np.ndarray, " f"] | None = None,
    body_vertices: Float[Array, "b 3"] | None = None,
    pin_targets: Float[Array, "k 3"] | None = None,
    gravity: Gravity = Gravity.DOWN,
    strain_limit: float | None = None,
) -> Parameters:
    """Parameters of a garment of one fabric, or of one per panel.

    With one fabric every stiffness is a scalar. With one per panel they are arrays, per triangle
    and per hinge; a hinge on a seam takes the mean of its two sides. Friction is one number in
    either case, the mean over the area.

    Args:
        cloth: topology; tells how many pins there are.
        fabric: of the whole garment, or one per panel.
        rest_positions: panel coordinates [m].
        face_panel: panel of each triangle; needed where there is a fabric per panel.
        body_vertices: [m]; default no body.
        pin_targets: where pins are held [m].
        gravity: direction and strength.
        strain_limit: no triangle may stretch by this factor or more, such as 1.1; None for no
            limit. The state from which a solve starts must keep it.

    Raises:
        InputError: a strain limit that is not above 1, a fabric per panel without `face_panel`, or
            too few fabrics.
    """
    pins = np.zeros((len(cloth.pins), 3)) if pin_targets is None else pin_targets
    body = np.zeros((0, 3)) if body_vertices is None else body_vertices
    rest = jnp.asarray(rest_positions, float)
    if strain_limit is not None and not (np.isfinite(strain_limit) and strain_limit > 1.0):
        raise InputError(
            f"the strain limit is {strain_limit}",
            mend="give the largest stretch, a number above 1, such as 1.1",
        )
    return Parameters(
        rest_positions=rest,
        grain_angle=jnp.asarray(0.0),
        gravity=jnp.asarray(gravity.value),
        pin_targets=jnp.asarray(pins, float),
        pin_stiffness=jnp.asarray(PIN_STIFFNESS),
        stitch_stiffness=jnp.asarray(STITCH_STIFFNESS),
        body_vertices=jnp.asarray(body, float),
        barrier_stiffness=jnp.asarray(BARRIER_STIFFNESS),
        strain_limit=None
        if strain_limit is None
        else StrainLimit(jnp.asarray(strain_limit), jnp.asarray(STRAIN_LIMIT_STIFFNESS)),
        **_fabric_leaves(cloth, fabric, rest, face_panel),
    )


def _fabric_leaves(
    cloth: Cloth, fabric: Fabrics, rest: Float[Array, "p 2"], face_panel: np.ndarray | None
) -> dict[str, Array]:
    """The leaves of the parameters that fabrics tell, scalar or per triangle and hinge."""
    if isinstance(fabric, Fabric):
        leaves = {name: jnp.asarray(value) for name, value in _numbers(fabric).items()}
        return {**leaves, "friction_coefficient": jnp.asarray(fabric.friction)}
    if face_panel is None:
        raise InputError("a fabric per panel needs to know the panel of each triangle")
    owner = np.asarray(face_panel)
    if owner.shape != (cloth.faces.shape[1],):
        raise InputError(f"{len(owner)} panels of {cloth.faces.shape[1]} triangles")
    if len(owner) and not 0 <= owner.min() <= owner.max() < len(fabric):
        raise InputError(
            f"there are {len(fabric)} fabrics, but a triangle of panel {owner.max()}",
            mend="give one fabric per panel, panels counted from 0",
        )
    numbers = [_numbers(one) for one in fabric]
    leaves = {
        name: panels_to_triangles(jnp.asarray([own[name] for own in numbers]), jnp.asarray(owner))
        for name in numbers[0]
    }
    for name in HINGE_LEAVES:
        leaves[name] = triangles_to_hinges(leaves[name], cloth.hinge_faces)
    areas = rest_triangles(rest, cloth.rest_faces).areas
    friction = jnp.asarray([one.friction for one in fabric])[owner]
    return {**leaves, "friction_coefficient": jnp.sum(areas * friction) / jnp.sum(areas)}


def _numbers(fabric: Fabric) -> dict[str, float]:
    """A fabric's numbers by the names of the parameters' leaves."""
    warp, weft, shear = fabric.orthotropic_moduli
    return {
        "density": fabric.density,
        "stretching_stiffness": fabric.stretching_stiffness,
        "poisson_ratio": fabric.poisson_ratio,
        "warp_stiffness": warp,
        "weft_stiffness": weft,
        "shear_stiffness": shear,
        "bending_stiffness": fabric.bending_stiffness,
        "bending_anisotropy": fabric.bending_anisotropy,
    }
