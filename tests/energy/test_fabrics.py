"""Units of the instruments, and the named fabrics against their sources."""

import math

import numpy as np
import pytest

from dress_jax.core.errors import InputError
from dress_jax.energy import measurement
from dress_jax.energy.fabric import FABRICS, Fabric

# Rows of the file of the 11 oz black denim: c11, c12, c22, c33 [N/m].
DENIM = (
    (205.352005, 10.234077, 1013.88629, 53.387184),
    (232.027634, 40.646339, 1052.84289, 64.980499),
    (224.592209, 40.384563, 1054.43444, 67.184807),
    (225.951050, 62.095657, 1059.59741, 83.992020),
    (226.039566, 40.502792, 1058.27771, 75.118423),
    (225.767487, 40.917892, 1051.55712, 71.810631),
)


def test_kawabata_units():
    """1 gf cm^2/cm is 98.0665 uN m; 1 gf/(cm degree) is 56.19 N/m; 500 gf/cm is 490.3 N/m."""
    assert measurement.kes_bending(1.0) == pytest.approx(98.0665e-6, rel=1e-12)
    assert measurement.kes_shear(1.0) == pytest.approx(0.980665 * 57.29577951, rel=1e-9)
    assert measurement.kes_tensile(5.0) == pytest.approx(490.3325 / 0.05, rel=1e-12)
    assert measurement.kes_weight(20.0) == pytest.approx(0.2)
    # A straight line to 500 gf/cm at 4 % has LT = 1 and WT = 10 gf cm/cm^2.
    assert measurement.kes_extension(1.0, 10.0) == pytest.approx(4.0)


def test_fast_units():
    assert measurement.fast_bending(7.5) == pytest.approx(7.5e-6)
    assert measurement.fast_shear(3.0) == pytest.approx(41.0)
    assert measurement.fast_tensile(2.0) == pytest.approx(4905.0)
    # The bias extension is at 4.9 N/m: G = 123 / EB5 is load / (4 strain), up to rounding.
    assert measurement.fast_shear(1.0) == pytest.approx(4.905 / (4.0 * 0.01), rel=5e-3)


@pytest.mark.parametrize(
    "conversion", [measurement.kes_tensile, measurement.fast_shear, measurement.fast_tensile]
)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_what_cannot_be_measured_is_refused(conversion, value):
    with pytest.raises(InputError, match="measurement"):
        conversion(value)


def test_data_driven_moduli_have_the_energy_of_their_source():
    """Green's strain to first order, the mean of the five rows, and the shear of the bias."""
    warp, weft, shear, nu = measurement.data_driven_moduli(DENIM)
    c11, c12, c22, _ = np.mean(DENIM[1:], axis=0)
    bound = 1.0 - nu**2
    assert warp / bound == pytest.approx(c22)
    assert weft / bound == pytest.approx(c11)
    assert nu * math.sqrt(warp * weft) / bound == pytest.approx(c12)
    # 2 G e^2 against c33 e^2 / 2.
    assert 2.0 * shear == pytest.approx(0.5 * DENIM[3][3])
    assert measurement.data_driven_bending(4.0e-6) == pytest.approx(1.0e-6)


def test_the_denim_is_that_of_its_file():
    warp, weft, shear, nu = measurement.data_driven_moduli(DENIM)
    denim = FABRICS["denim-stretch"]
    assert denim.orthotropic_moduli == pytest.approx((warp, weft, shear), rel=2e-3)
    assert denim.poisson_ratio == pytest.approx(nu, abs=1e-3)
    assert denim.bending_stiffness == pytest.approx((64.196457 + 96.951576) / 8.0 * 1e-6, rel=1e-3)


def test_wool_suiting_in_words_of_the_document():
    wool = FABRICS["wool-suiting"]
    assert wool.density == pytest.approx(0.264, abs=1e-3)
    assert wool.bending_stiffness == pytest.approx(1.33e-5, rel=1e-2)
    assert wool.shear_stiffness == pytest.approx(54.0, rel=1e-2)
    assert wool.warp_stiffness == pytest.approx(8.1e3, rel=1e-2)


def test_every_fabric_has_a_source_and_the_old_names_are_there():
    assert {"cotton", "denim", "jersey", "silk", "wool"} <= set(FABRICS)
    for fabric in FABRICS.values():
        assert fabric.source
        warp, weft, shear = fabric.orthotropic_moduli
        # Woven or knitted, cloth shears more easily than it stretches.
        assert shear < min(warp, weft)


@pytest.mark.parametrize(
    "bad",
    [
        {"warp_stiffness": -1.0},
        {"weft_stiffness": math.inf},
        {"shear_stiffness": 0.0},
        {"bending_anisotropy": 0.7},
        {"bending_anisotropy": math.nan},
        {"friction": math.nan},
    ],
)
def test_faults(bad):
    good = {"density": 0.1, "stretching_stiffness": 1.0, "bending_stiffness": 1.0}
    with pytest.raises(InputError, match=next(iter(bad))):
        Fabric(**good, **bad)
