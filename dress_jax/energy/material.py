"""A fabric as physical numbers."""

import dataclasses

import numpy as np

from dress_jax.core.errors import InputError

LARGEST_ANISOTROPY = 2.0 / 3.0  # of bending; beyond it some hinges would have no stiffness


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
        bending_anisotropy: (B_warp - B_weft) / (B_warp + B_weft), between -2/3 and 2/3.
        source: where the numbers come from.
    """

    density: float
    stretching_stiffness: float
    bending_stiffness: float
    poisson_ratio: float = 0.3
    friction: float = 0.4
    warp_stiffness: float | None = None
    weft_stiffness: float | None = None
    shear_stiffness: float | None = None
    bending_anisotropy: float = 0.0
    source: str = ""

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
        if not (np.isfinite(self.friction) and self.friction >= 0.0):
            raise InputError(f"friction is {self.friction}", where="fabric")
        if not abs(self.bending_anisotropy) < LARGEST_ANISOTROPY:
            raise InputError(
                f"bending_anisotropy is {self.bending_anisotropy}",
                where="fabric",
                mend="hinges carry a ratio of warp to weft between 1/5 and 5, that is -2/3 to 2/3",
            )

    @property
    def orthotropic_moduli(self) -> tuple[float, float, float]:
        """Tensile moduli along warp and weft, and the shear modulus, times the thickness [N/m]."""
        tensile = 2.0 * self.stretching_stiffness * (1.0 + self.poisson_ratio)
        return (
            tensile if self.warp_stiffness is None else self.warp_stiffness,
            tensile if self.weft_stiffness is None else self.weft_stiffness,
            self.stretching_stiffness if self.shear_stiffness is None else self.shear_stiffness,
        )
