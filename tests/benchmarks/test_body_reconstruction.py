"""The people of the benchmark are human, and its table counts what it says."""

import numpy as np
import pytest

from benchmarks.body_reconstruction.attempt import errors
from benchmarks.body_reconstruction.scene import _clothes, random_truth, wrong_estimate
from benchmarks.body_reconstruction.table import line, totals
from dress_jax.core.pytree import replace
from dress_jax.io.bodies import load_default_body
from dress_jax.reconstruction import body_in_world
from dress_jax.reconstruction.prior import pose_limits


@pytest.fixture(scope="module")
def body():
    return load_default_body()


def test_people_differ_and_stay_in_human_range(body):
    low, high = pose_limits()
    people = [random_truth(body, seed) for seed in range(4)]
    for person in people:
        pose = np.asarray(person.pose)
        assert np.all(pose[1:] >= low[1:]) and np.all(pose[1:] <= high[1:])
        assert 0.85 <= person.scale <= 1.15
    assert np.ptp([float(person.shape[0]) for person in people]) > 0.1


def test_estimates_are_as_wrong_as_they_say(body):
    truth = random_truth(body, 0)
    found = errors(body, wrong_estimate(body, truth, 0), truth)
    assert found["rotation_degrees"] == pytest.approx(60.0)
    assert found["scale_percent"] == pytest.approx(20.0)
    none = errors(body, truth, truth)
    assert all(value == pytest.approx(0.0, abs=1e-5) for value in none.values())
    bigger = errors(body, replace(truth, log_scale=truth.log_scale + np.log(1.01)), truth)
    assert bigger["scale_percent"] == pytest.approx(1.0)
    assert bigger["stature_percent"] == pytest.approx(1.0)


def test_clothes_have_the_same_mesh_for_everybody(body):
    """Else every body would compile its pictures anew."""
    sizes = set()
    for seed in range(2):
        vertices = np.asarray(body_in_world(body, random_truth(body, seed)).vertices)
        clothes, faces = _clothes(body, vertices, np.asarray(body.faces))
        assert faces.min() == 0 and faces.max() == len(clothes) - 1
        sizes.add((len(clothes), len(faces)))
    assert len(sizes) == 1


def row(case, **changes):
    end = {"joints_cm": 1.0, "fingers_cm": 0.2, "vertices_cm": 0.9, "largest_cm": 3.0}
    end |= {"scale_percent": -0.6, "stature_percent": 0.1} | changes
    return {
        "case": case,
        "seed": 0,
        "hidden": 0.6,
        "stages": {name: end for name in ("coarse", "landmarks", "fine")},
        "landmark_error_px": 1.0,
        "iterations": {"coarse": 5, "landmarks": 6, "fine": 7},
        "seconds": {"total": 170.0, "compile": 10.0},
    }


def test_goals_are_counted_per_case():
    text = "\n".join(totals([row("clean"), row("clean", scale_percent=0.4), row("noisy")]))
    assert "clean, 2 bodies" in text and "noisy, 1 bodies" in text
    assert "scale <= 0.5 %: 1 (mean 0.500, largest 0.600)" in text
    assert "scale <= 1 %: 1" in text  # twice as much where landmarks are noisy
    assert "5/6/7" in line(row("clean"))
