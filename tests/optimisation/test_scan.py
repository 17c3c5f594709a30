"""A scan as the target of a fit: its rows, their derivatives, and what they recover."""

import dataclasses

import numpy as np
import pytest
from fit_scenes import with_options

from dress_jax.core.errors import InputError
from dress_jax.loss.metrics import chamfer_distance
from dress_jax.optimisation import FitMethod, evaluate, fit, init, make_problem, make_scan
from dress_jax.optimisation.gauss_newton.scan_rows import scan_rows
from tests.central_differences import central_difference

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
FACES = np.array([[0, 1, 2], [1, 3, 2]])


def test_rows_over_and_beyond_a_surface():
    scan = make_scan(np.array([[0.3, 0.3, 0.2], [1.4, 0.5, 0.0], [0.5, 0.5, 0.0]]))
    rows = scan_rows(scan, SQUARE, FACES)
    np.testing.assert_allclose(rows.residual, [0.2, 0.4, 0.0], atol=1e-12)
    # The first is pulled across the cloth, the second along it.
    lifted = np.tile([0.0, 0.0, 1.0], 4)
    wider = np.tile([1.0, 0.0, 0.0], 4)
    np.testing.assert_allclose(rows.jacobian.dot(lifted)[:2], [-1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(rows.jacobian.dot(wider)[:2], [0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(rows.weight, 1.0 / 3.0)


def test_a_complete_scan_draws_in_what_hangs_out():
    inside = np.array([[0.5, 0.5, 0.0]])
    assert scan_rows(make_scan(inside), SQUARE, FACES).residual.max() < 1e-12
    rows = scan_rows(make_scan(inside, complete=True), SQUARE, FACES)
    np.testing.assert_allclose(rows.residual[1:], np.sqrt(0.5))
    assert rows.weight.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("complete", [False, True])
def test_derivatives_against_differences(complete):
    rng = np.random.default_rng(3)
    x = SQUARE + 0.1 * rng.normal(size=SQUARE.shape)
    scan = make_scan(rng.uniform(-0.3, 1.3, size=(40, 3)), complete=complete)
    way = rng.normal(size=x.shape)
    rows = scan_rows(scan, x, FACES)

    def value(length):
        moved = scan_rows(scan, x + length * way, FACES)
        return np.sum(moved.weight * moved.residual**2)

    slope = 2.0 * np.sum(rows.weight * rows.residual * rows.jacobian.dot(way.ravel()))
    assert abs(slope) > 1e-2
    assert central_difference(value, 1e-6) == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize(
    "vertices, faces, message",
    [
        (np.zeros((0, 3)), None, "shape"),
        (np.array([[0.0, np.nan, 0.0]]), None, "finite"),
        (SQUARE, np.array([[0, 1, 9]]), "face"),
        (SQUARE, np.zeros((0, 3), int), "faces"),
    ],
)
def test_scans_that_are_none(vertices, faces, message):
    with pytest.raises(InputError, match=message):
        make_scan(vertices, faces)


def with_scan(problem, scan, **options):
    changed = with_options(problem, **options)
    return make_problem(
        changed.pattern,
        changed.discretization,
        changed.simulator,
        changed.parameters,
        changed.observation,
        options=changed.options,
        scan=scan,
    )


def test_adam_refuses_a_scan(problem):
    with pytest.raises(InputError, match="Adam"):
        with_scan(problem, make_scan(SQUARE))


def test_a_noisy_scan_with_a_hole_recovers_the_pattern(fresh, truth):
    """No picture is looked at. A third of the tube is missing, the rest is 1 mm off."""
    problem, start = fresh(method=FitMethod.GAUSS_NEWTON, iterations=12)
    x = np.asarray(truth[2].positions)
    from fit_scenes import EDGE_LENGTH  # the true drape's mesh

    from dress_jax.pattern import discretize

    faces = np.asarray(discretize(truth[0], EDGE_LENGTH).faces)
    seen = faces[x[faces].mean(axis=1)[:, 0] > -0.06]
    assert 0.5 * len(faces) < len(seen) < 0.85 * len(faces)
    clean = make_scan(x, seen, samples=1500)
    noise = 1e-3 * np.random.default_rng(1).normal(size=clean.points.shape)
    scan = dataclasses.replace(clean, points=clean.points + noise)
    scanned = with_scan(problem, scan, weights={})
    state = init(scanned, start)
    end = fit(scanned, state)
    before, after = (evaluate(scanned, s, true_pattern=truth[0]) for s in (state, end))
    own = np.asarray(problem.discretization.faces)
    apart = [chamfer_distance(np.asarray(s.positions), own, x, faces) for s in (state, end)]
    assert apart[1] < 0.35 * apart[0]
    assert after.median_length_error < 0.5 * before.median_length_error
    assert after.iou > before.iou
