"""What observations tell about lengths and fabric, and what they leave open."""

import dataclasses

import numpy as np
import pytest
from fit_scenes import EDGE_LENGTH, with_options

from dress_jax.optimisation import FitMethod, Landmark, fit, init, make_problem
from dress_jax.optimisation.gauss_newton.residuals import Observed
from dress_jax.optimisation.gauss_newton.uncertainty import Before, find_uncertainty
from dress_jax.optimisation.landmarks import landmark_weights
from dress_jax.pattern import discretize, edge_lengths, edge_table, pattern_parameters


@pytest.fixture(scope="module")
def scene(problem, fresh):
    """The wrong tube, and its first drape by Gauss-Newton's rules."""
    changed = with_options(problem, method=FitMethod.GAUSS_NEWTON)
    return changed, init(changed, fresh()[1])


@pytest.fixture(scope="module")
def by_pictures(scene):
    problem, state = scene
    return find_uncertainty(problem, state.unknowns, state.positions)


def marked(problem, truth, weights, marks):
    seen = landmark_weights(marks, discretize(truth[0], EDGE_LENGTH)).dot(
        np.asarray(truth[2].positions)
    )
    own = [dataclasses.replace(m, position=tuple(p)) for m, p in zip(marks, seen, strict=True)]
    return make_problem(
        problem.pattern,
        problem.discretization,
        problem.simulator,
        problem.parameters,
        problem.observation,
        options=dataclasses.replace(problem.options, weights=weights),
        landmarks=own,
    )


def test_pictures_tell_lengths(by_pictures):
    u = by_pictures
    assert set(u.noise) == {Observed.OUTLINES, Observed.NORMALS}
    for told in (u.length_told, u.fabric_told):
        assert np.all((told > -1e-9) & (told <= 1.0))
    assert np.all(u.length_deviation > 0.0)
    # Sides hang freely and end in a hem that every view sees: they are told most.
    sides = u.length_told[[1, 3, 5, 7]]
    assert sides.min() > 0.6
    # Directions are sorted, and no edge varies more along one than it does at all.
    sizes = np.linalg.norm(u.directions, axis=1)
    assert np.all(np.diff(sizes) <= 0.0) and sizes[0] > 0.0
    assert np.all(np.abs(u.directions) <= u.length_deviation * (1 + 1e-9))


def test_more_is_known_with_more_observations(scene, truth, by_pictures):
    problem, state = scene
    marks = [
        Landmark(panel, 1, t, (0.0, 0.0, 0.0))
        for panel in ("front", "back")
        for t in (0.0, 0.5, 1.0)
    ]
    with_marks = marked(problem, truth, problem.options.weights, marks)
    more = find_uncertainty(with_marks, state.unknowns, state.positions)
    assert np.all(more.length_deviation <= by_pictures.length_deviation * (1 + 1e-9))
    assert more.length_deviation.sum() < 0.95 * by_pictures.length_deviation.sum()


def test_nothing_is_known_without_any(scene, truth):
    """One landmark at the top says nothing about what hangs below."""
    problem, state = scene
    mark = [Landmark("front", 2, 0.5, (0.0, 0.0, 0.0))]
    little = marked(problem, truth, {}, mark)
    u = find_uncertainty(little, state.unknowns, state.positions)
    assert set(u.noise) == {Observed.LANDMARKS}
    assert u.length_told[[0, 1, 3]].max() < 0.2 and u.fabric_told.max() < 0.2
    before = find_uncertainty(
        little, state.unknowns, state.positions, before=Before(strain=0.2, seam=0.01)
    )
    ratio = before.length_deviation[[0, 1]] / u.length_deviation[[0, 1]]
    np.testing.assert_allclose(ratio, 2.0, rtol=0.25)


def test_true_lengths_lie_within_the_intervals(scene, truth):
    """After a fit from lengths that are off by 4 to 18 %."""
    problem, state = scene
    end = fit(problem, state)
    u = find_uncertainty(problem, end.unknowns, end.positions)
    true_lengths = np.asarray(edge_lengths(pattern_parameters(truth[0]), edge_table(truth[0])))
    off = np.abs(u.lengths - true_lengths) / u.length_deviation
    first = find_uncertainty(problem, state.unknowns, state.positions)
    assert np.abs(first.lengths - true_lengths).max() > 0.03
    assert off.max() < 2.5
    # And intervals say something: they are narrower than at the start, and than what was known.
    assert np.all(u.length_deviation < first.length_deviation)
    assert u.length_told.min() > 0.6
