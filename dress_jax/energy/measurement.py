"""What instruments of the textile trade print, in SI units.

KES-F (Kawabata 1980, "The Standardization and Analysis of Hand Evaluation") prints gram-force,
centimetres and degrees; FAST (CSIRO 1989) prints newtons and extensions in per cent. Wang, O'Brien
and Ramamoorthi 2011 ("Data-Driven Elastic Models for Cloth") store coefficients of the energies of
their simulator.
"""

import math
from collections.abc import Sequence

from dress_jax.core.errors import InputError

GRAM_FORCE = 9.80665e-3  # [N]
KES_LOAD = 500.0  # of the tensile test [gf/cm]
FAST_LOAD = 98.1  # of the extension E100 [N/m]
FAST_BIAS = 123.0  # of the shear rigidity from the bias extension EB5 [N/m per cent]


def kes_bending(rigidity: float) -> float:
    """Flexural rigidity [N m] of KES-FB2's B [gf cm^2/cm]."""
    return rigidity * GRAM_FORCE * 1e-2


def kes_shear(stiffness: float) -> float:
    """Shear modulus times thickness [N/m] of KES-FB1's G [gf/(cm degree)]."""
    return stiffness * (GRAM_FORCE / 1e-2) * 180.0 / math.pi


def kes_tensile(extension: float) -> float:
    """Secant tensile modulus times thickness [N/m] of KES-FB1's EMT [%] at 500 gf/cm."""
    return KES_LOAD * (GRAM_FORCE / 1e-2) / (1e-2 * _positive("EMT", extension))


def kes_extension(linearity: float, work: float) -> float:
    """EMT [%] of the linearity LT and the work WT [gf cm/cm^2], from LT = 2 WT / (F EMT)."""
    return 100.0 * 2.0 * work / (KES_LOAD * _positive("LT", linearity))


def kes_weight(weight: float) -> float:
    """Areal density [kg/m^2] of KES's W [mg/cm^2]."""
    return 1e-2 * weight


def fast_bending(rigidity: float) -> float:
    """Flexural rigidity [N m] of FAST-2's B [uN m]."""
    return 1e-6 * rigidity


def fast_shear(bias_extension: float) -> float:
    """Shear modulus times thickness [N/m] of FAST-3's EB5 [%]: G = 123 / EB5."""
    return FAST_BIAS / _positive("EB5", bias_extension)


def fast_tensile(extension: float) -> float:
    """Secant tensile modulus times thickness [N/m] of FAST-3's E100 [%] at 100 gf/cm."""
    return FAST_LOAD / (1e-2 * _positive("E100", extension))


def data_driven_moduli(samples: Sequence[Sequence[float]]) -> tuple[float, float, float, float]:
    """Warp, weft and shear modulus [N/m] and Poisson ratio of the stretching table of Wang et al.

    Their energy is (c11 e11^2 + c22 e22^2 + 2 c12 e11 e22 + c33 e12^2) / 2 in Green's strain, which
    for small strains is the orthotropic membrane with G = c33 / 4.

    Args:
        samples: six rows (c11, c12, c22, c33) [N/m]: at rest, then at the largest strain along five
            directions from one yarn over the bias to the other. The tensile numbers are the means
            of the five; the shear modulus is that of the bias, the only one that shears.
    """
    c11, c12, c22 = (sum(row[k] for row in samples[1:]) / 5.0 for k in range(3))
    c33 = samples[3][3]
    nu = c12 / math.sqrt(c11 * c22)
    return c22 * (1.0 - nu**2), c11 * (1.0 - nu**2), 0.25 * c33, nu


def data_driven_bending(stiffness: float) -> float:
    """Flexural rigidity [N m] of a bending stiffness of Wang et al. [N m].

    Their energy of a hinge is k e^2 theta^2 / (8 (A1 + A2)), four times less than ours.
    """
    return 0.25 * stiffness


def _positive(name: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name} is {value}", where="fabric measurement", mend="give what is > 0")
    return value
