"""Levenberg-Marquardt against closed forms and scipy."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from dress_jax.reconstruction.levenberg_marquardt import minimize


def test_a_linear_problem_is_solved():
    rng = np.random.default_rng(0)
    matrix, target = rng.normal(size=(12, 5)), rng.normal(size=12)
    found = minimize(
        lambda x: matrix @ x - target, lambda x: matrix, np.zeros(5), np.ones(5, bool),
        iterations=50, tolerance=1e-14,
    )  # fmt: skip
    np.testing.assert_allclose(found.vector, np.linalg.lstsq(matrix, target)[0], atol=1e-7)
    assert found.converged and found.iterations < 15


def rosenbrock(x):
    return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0], 0.3 * x[0] * x[1]])


def slopes(x):
    return np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0], [0.3 * x[1], 0.3 * x[0]]])


def test_a_curved_problem_ends_where_scipy_ends():
    start = np.array([-1.2, 1.0])
    found = minimize(rosenbrock, slopes, start, np.ones(2, bool), iterations=200, tolerance=1e-15)
    expected = least_squares(rosenbrock, start, slopes, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(found.vector, expected.x, atol=1e-5)
    assert np.all(np.diff(found.losses) <= 0.0)


def test_fixed_unknowns_stay_and_powerless_ones_too():
    def residuals(x):
        return np.array([x[0] - 3.0, 2.0 * (x[0] + x[1])])

    def jacobian(x):
        return np.array([[1.0, 0.0, 0.0], [2.0, 2.0, 0.0]])

    start = np.array([0.0, 1.0, 7.0])
    found = minimize(residuals, jacobian, start, np.array([True, False, True]), iterations=30)
    np.testing.assert_array_equal(found.vector[1:], start[1:])
    assert found.vector[0] == pytest.approx(-1.0 / 5.0, abs=1e-6)


def test_nothing_free_and_nothing_finite():
    nothing = minimize(rosenbrock, slopes, np.ones(2), np.zeros(2, bool), iterations=5)
    np.testing.assert_array_equal(nothing.vector, np.ones(2))
    lost = minimize(
        lambda x: np.array([np.nan]), lambda x: np.ones((1, 2)), np.ones(2), np.ones(2, bool),
        iterations=5,
    )  # fmt: skip
    assert not lost.converged
