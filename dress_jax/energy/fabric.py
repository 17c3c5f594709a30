"""Fabrics as physical numbers, and the parameters of a solve made from them."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.core.errors import InputError
from dress_jax.energy.cloth import HINGE_LEAVES, Cloth, Gravity, Parameters
from dress_jax.energy.rest import rest_triangles
from dress_jax.energy.spread import panels_to_triangles, triangles_to_hinges


@dataclasses.dataclass(frozen=True)
class Fabric:
    """A fabric in SI units.

    Attributes:
        density: [kg/m^2].
        stretching_stiffness: k_s [N/m] of the isotropic membranes; a strip of this cloth has a
            tensile stiffness of about 2 k_s (1 + nu) per metre of width.
        bending_stiffness: flexural rigidity [N m].
        poisson_ratio: for the neo-Hookean membrane; for the orthotropic one the geometric mean of
            its two Poisson ratios.
        friction: Coulomb's coefficient against body and cloth.
        warp_stiffness, weft_stiffness, shear_stiffness: tensile moduli and shear modulus of the
            orthotropic membrane, times the thickness [N/m]; where they are None, those of the
            isotropic material of the same k_s and Poisson ratio.
    """

    density: float
    stretching_stiffness: float
    bending_stiffness: float
    poisson_ratio: float = 0.3
    friction: float = 0.4
    warp_stiffness: float | None = None
    weft_stiffness: float | None = None
    shear_stiffness: float | None = None

    def __post_init__(self) -> None:
        for name in (
            "density",
            "stretching_stiffness",
            "bending_stiffness",
            "warp_stiffness",
            "weft_stiffness",
            "shear_stiffness",
        ):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise InputError(f"{name} is {value}", where="fabric", mend="it must be positive")
        if not 0.0 <= self.poisson_ratio < 1.0:
            raise InputError(f"poisson_ratio is {self.poisson_ratio}", where="fabric")
        if not self.friction >= 0.0:
            raise InputError(f"friction is {self.friction}", where="fabric")

    @property
    def orthotropic_moduli(self) -> tuple[float, float, float]:
        """Tensile moduli along warp and weft, and the shear modulus, times the thickness [N/m]."""
        tensile = 2.0 * self.stretching_stiffness * (1.0 + self.poisson_ratio)
        return (
            tensile if self.warp_stiffness is None else self.warp_stiffness,
            tensile if self.weft_stiffness is None else self.weft_stiffness,
            self.stretching_stiffness if self.shear_stiffness is None else self.shear_stiffness,
        )


# Orders of magnitude of apparel fabrics: areal densities of trade descriptions, bending rigidities
# of KES-F handbooks (5e-6 to 5e-5 N m for shirting and suiting). The stretching stiffness is that
# of a garment, with its weave slack and knit loops, below that of the yarns.
FABRICS: dict[str, Fabric] = {
    "cotton": Fabric(density=0.15, stretching_stiffness=400.0, bending_stiffness=1.0e-5),
    "denim": Fabric(density=0.40, stretching_stiffness=1200.0, bending_stiffness=6.0e-5),
    "jersey": Fabric(density=0.18, stretching_stiffness=120.0, bending_stiffness=4.0e-6),
    "silk": Fabric(density=0.07, stretching_stiffness=250.0, bending_stiffness=3.0e-6),
    "wool": Fabric(density=0.25, stretching_stiffness=500.0, bending_stiffness=2.5e-5),
}


def named_fabric(name: str) -> Fabric:
    """A fabric of `FABRICS`.

    Raises:
        InputError: there is none of that name.
    """
    if name not in FABRICS:
        raise InputError(f"unknown fabric {name!r}", mend=f"choose one of {sorted(FABRICS)}")
    return FABRICS[name]


BARRIER_STIFFNESS = 1.0e3  # [Pa]; cloth presses on a body with 1 to 1000 Pa, so gaps stay near dhat
PIN_STIFFNESS = 1.0e3  # [N/m]
STITCH_STIFFNESS = 100.0  # [N/m]


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

    Raises:
        InputError: a fabric per panel without `face_panel`, or too few fabrics.
    """
    pins = np.zeros((len(cloth.pins), 3)) if pin_targets is None else pin_targets
    body = np.zeros((0, 3)) if body_vertices is None else body_vertices
    rest = jnp.asarray(rest_positions, float)
    return Parameters(
        rest_positions=rest,
        grain_angle=jnp.asarray(0.0),
        gravity=jnp.asarray(gravity.value),
        pin_targets=jnp.asarray(pins, float),
        pin_stiffness=jnp.asarray(PIN_STIFFNESS),
        stitch_stiffness=jnp.asarray(STITCH_STIFFNESS),
        body_vertices=jnp.asarray(body, float),
        barrier_stiffness=jnp.asarray(BARRIER_STIFFNESS),
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
    }
