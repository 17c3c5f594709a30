"""Derivatives of a draped skirt by the command line, and what it says when they are wrong."""

import json

import numpy as np
import pytest

from dress_jax.application.gradcheck import simulation_of
from dress_jax.io.results import read_result
from dress_jax.sim import implicit
from dress_jax.solver import NewtonOptions

MOVED = ("rest_positions", "density", "bending_stiffness", "gravity", "body_vertices")


@pytest.mark.slow
def test_the_derivatives_of_a_skirt_agree(draped, run):
    folder, _ = draped
    result = run("gradcheck", folder)
    assert result.exit_code == 0, result.output
    report = json.loads((folder / "gradcheck.json").read_text())
    (folder / "gradcheck.json").unlink()  # the folder is shared
    rows = {row["name"]: row for row in report["rows"]}
    assert report["good"] and report["converged"]
    assert report["smallest_distance"] < report["dhat"]
    for name in MOVED:
        assert rows[name]["reverse"] != 0.0
        assert rows[name]["reverse"] == pytest.approx(rows[name]["difference"], rel=1e-5)
    assert rows["friction_coefficient"]["reverse"] == 0.0


def test_a_wrong_derivative_is_told(draped, run, monkeypatch):
    folder, _ = draped
    original = implicit._End.pull
    monkeypatch.setattr(
        implicit._End,
        "pull",
        lambda self, moved, adjoint: original(self, moved, 1.001 * np.asarray(adjoint)),
    )
    result = run("gradcheck", folder)
    assert result.exit_code == 3
    assert not json.loads((folder / "gradcheck.json").read_text())["good"]
    (folder / "gradcheck.json").unlink()


def test_the_simulation_of_a_result_is_the_one_that_made_it(draped):
    state, _ = read_result(draped[0])
    simulator, parameters = simulation_of(state, NewtonOptions())
    assert simulator.vertex_count == len(state.garment.vertices)
    assert np.array_equal(parameters.rest_positions, state.garment.rest_positions)
    assert np.array_equal(parameters.pin_targets, state.pin_targets)
