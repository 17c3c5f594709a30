"""Named fabrics, each with its source; `docs/fabrics.md` says how the numbers came about."""

from dress_jax.core.errors import InputError
from dress_jax.energy.material import Fabric
from dress_jax.energy.measurement import (
    data_driven_bending,
    kes_bending,
    kes_extension,
    kes_shear,
    kes_tensile,
    kes_weight,
)

_ESTIMATE = "estimate within the ranges of KES-F handbooks"
_DATA_DRIVEN = "Wang, O'Brien, Ramamoorthi 2011 (SIGGRAPH), material file of "
_WINTER_SUITING = "Kawabata 1980, KN-101-Winter: mean of 214 men's winter suitings (not re-read)"


def _estimate(
    density: float, stretching: float, bending: float, *, shear: float, tensile: float | None = None
) -> Fabric:
    """A fabric by orders of magnitude, as stiff along the weft as along the warp."""
    tensile = 2.0 * stretching if tensile is None else tensile
    return Fabric(
        density=density,
        stretching_stiffness=stretching,
        bending_stiffness=bending,
        warp_stiffness=tensile,
        weft_stiffness=tensile,
        shear_stiffness=shear,
        source=_ESTIMATE,
    )


def _data_driven(
    name: str,
    density: float,
    warp: float,
    weft: float,
    shear: float,
    poisson_ratio: float,
    bending: tuple[float, float],
) -> Fabric:
    """A fabric of the database of Wang et al.

    Args:
        name: of the file.
        density: [kg/m^2].
        warp, weft, shear, poisson_ratio: by `measurement.data_driven_moduli` [N/m].
        bending: their stiffness along both yarns at the smallest curvature [N m]; the file does not
            tell which is which, so the mean is taken.
    """
    return Fabric(
        density=density,
        stretching_stiffness=0.5 * (warp * weft) ** 0.5,
        bending_stiffness=data_driven_bending(0.5 * (bending[0] + bending[1])),
        poisson_ratio=poisson_ratio,
        warp_stiffness=warp,
        weft_stiffness=weft,
        shear_stiffness=shear,
        source=_DATA_DRIVEN + name,
    )


def _winter_suiting() -> Fabric:
    """W, B, G, LT and WT are means of logarithms (base 10), LT is a mean."""
    tensile = kes_tensile(kes_extension(0.6082, 10.0**0.9621))
    return Fabric(
        density=kes_weight(10.0**1.4208),
        stretching_stiffness=0.5 * tensile,
        bending_stiffness=kes_bending(10.0**-0.8673),
        warp_stiffness=tensile,
        weft_stiffness=tensile,
        shear_stiffness=kes_shear(10.0**-0.0143),
        friction=0.2085,
        source=_WINTER_SUITING,
    )


FABRICS: dict[str, Fabric] = {
    "cotton": _estimate(0.15, 400.0, 1.0e-5, shear=40.0),
    "denim": _estimate(0.40, 1200.0, 6.0e-5, shear=80.0),
    "jersey": _estimate(0.18, 120.0, 4.0e-6, shear=15.0),
    "linen": _estimate(0.19, 600.0, 2.0e-5, shear=30.0),
    "silk": _estimate(0.07, 250.0, 3.0e-6, shear=20.0),
    "wool": _estimate(0.25, 500.0, 2.5e-5, shear=50.0),
    "wool-suiting": _winter_suiting(),
    "blanket-fleece": _data_driven(
        "pink-ribbon-brown", 0.228, 213.7, 111.4, 32.4, 0.478, (117.07e-6, 59.77e-6)
    ),
    "denim-stretch": _data_driven(
        "11oz-black-denim", 0.324, 1046.0, 225.0, 21.0, 0.092, (64.20e-6, 96.95e-6)
    ),
    "interlock": _data_driven(
        "gray-interlock", 0.187, 262.9, 77.4, 11.1, 0.453, (23.19e-6, 14.27e-6)
    ),
    "poly-cotton": _data_driven(
        "royal-target", 0.220, 2147.0, 2108.0, 30.4, 0.025, (125.41e-6, 125.41e-6)
    ),
    "polyester": _data_driven(
        "white-dots-on-blk", 0.128, 2145.0, 2106.0, 25.4, 0.024, (51.71e-6, 31.28e-6)
    ),
    "polyester-jacket": _data_driven(
        "tango-red-jet-set", 0.113, 256.8, 103.5, 10.3, 0.446, (14.29e-6, 20.35e-6)
    ),
    "ponte": _data_driven(
        "camel-ponte-roma", 0.284, 153.8, 88.1, 11.2, 0.443, (36.35e-6, 37.16e-6)
    ),
    "rib-knit": _data_driven(
        "ivory-rib-knit", 0.276, 176.9, 65.5, 6.9, 0.012, (46.24e-6, 32.24e-6)
    ),
    "sweater-knit": _data_driven(
        "navy-sparkle-sweat", 0.224, 153.6, 52.4, 1.53, 0.551, (59.47e-6, 45.63e-6)
    ),
    "swim-knit": _data_driven(
        "white-swim-solid", 0.204, 110.1, 48.2, 9.0, 0.211, (60.24e-6, 51.02e-6)
    ),
}


def named_fabric(name: str) -> Fabric:
    """A fabric of `FABRICS`.

    Raises:
        InputError: there is none of that name.
    """
    if name not in FABRICS:
        raise InputError(f"unknown fabric {name!r}", mend=f"choose one of {sorted(FABRICS)}")
    return FABRICS[name]
