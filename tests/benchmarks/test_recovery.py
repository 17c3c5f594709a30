"""Cases and variants of the recovery benchmark, and what its table says of rows."""

import numpy as np
import pytest

from benchmarks.recovery.attempt import covered, valid, wrong
from benchmarks.recovery.cases import STARTS, Case, cases
from benchmarks.recovery.table import line, reached, totals
from benchmarks.recovery.variants import ADAM, GAUSS_NEWTON, VARIANTS, WHOLE
from dress_jax.optimisation import PAPER_WEIGHTS, FitMethod, FitOptions, Uncertainty
from dress_jax.pattern import edge_lengths, edge_table, pattern_parameters
from dress_jax.pattern.templates import Measurements, straight_skirt

SKIRT = straight_skirt(
    Measurements(waist=0.7, hips=1.0, waist_height=1.0, hips_height=0.8, knee_height=0.5)
)
ROW = {
    "name": "a",
    "view": "clean",
    "variant": WHOLE,
    "vertices": 1000,
    "valid": True,
    "iou": [0.8, 0.99],
    "held_out": [0.8, 0.985],
    "true_held_out": 0.99,
    "chamfer_cm": [1.0, 0.1],
    "true_chamfer_cm": 0.09,
    "median_error": [0.1, 0.005],
    "largest_error": [0.1, 0.03],
    "bending_error": -0.05,
    "stretching_error": 0.4,
    "covered": 0.95,
    "iterations": 50,
    "rejected": 5,
    "remeshed": 0,
    "crossings": 0,
    "seconds": 400.0,
    "peak_mb": 2000.0,
}


def test_cases_have_names_of_their_own():
    every = list(
        cases(("tshirt", "jumpsuit"), ("drafted",), ("10%",), ("clean",), ("whole", "adam"))
    )
    assert len({case.name for case in every}) == 4
    assert Case("tshirt", "drafted", "10%", "clean").name == "tshirt@drafted-10-clean"


@pytest.mark.parametrize("name", [name for name in VARIANTS if name not in (WHOLE, "adam")])
def test_a_variant_differs_from_the_whole(name):
    base = FitOptions()
    other = VARIANTS[name](base)
    whole = VARIANTS["adam"](base) if name in ADAM else base
    assert other != whole and other.method is whole.method
    term = name.removeprefix("adam-no-").replace("-", "_")
    if term in PAPER_WEIGHTS:
        assert set(whole.weights) - set(other.weights) == {term}


def test_every_term_of_the_paper_is_left_out_once():
    left_out = [set(PAPER_WEIGHTS) - set(make(FitOptions()).weights) for make in ADAM.values()]
    assert sorted(term for terms in left_out for term in terms) == sorted(PAPER_WEIGHTS)
    assert all(
        make(FitOptions()).method is FitMethod.GAUSS_NEWTON for make in GAUSS_NEWTON.values()
    )


def test_starts_are_wrong_and_valid():
    true_lengths = np.asarray(edge_lengths(pattern_parameters(SKIRT), edge_table(SKIRT)))
    for start in STARTS.values():
        pattern = wrong(SKIRT, start)
        assert valid(pattern)
        lengths = np.asarray(edge_lengths(pattern_parameters(pattern), edge_table(pattern)))
        assert np.abs(lengths / true_lengths - 1.0).max() > 0.05


def test_true_lengths_within_their_intervals():
    lengths = np.asarray(edge_lengths(pattern_parameters(SKIRT), edge_table(SKIRT)))
    off = np.where(np.arange(len(lengths)) % 2, 0.01, 0.03)
    zeros = np.zeros(len(lengths))
    known = Uncertainty(
        lengths + off, zeros + 0.01, zeros, zeros, zeros, zeros, zeros[None], zeros[None], {}, {}
    )
    assert covered(known, SKIRT) == 0.5  # 1.96 deviations
    assert covered(None, SKIRT) is None


def test_the_table_tells_what_was_reached():
    assert all(reached(ROW).values())
    crossed = reached({**ROW, "crossings": 1, "median_error": [0.1, 0.02]})
    assert not crossed["free"] and not crossed["edges"] and crossed["chamfer"]
    assert not reached({**ROW, "valid": False})["free"]
    failed = {"name": "b", "view": "clean", "error": "CRASH"}
    assert not any(reached(failed).values())
    assert "95 %" in line(ROW) and "CRASH" in line(failed)
    text = "\n".join(totals([ROW, failed]))
    assert "of 2, 1 reach" in text and "ended with an error: b" in text
