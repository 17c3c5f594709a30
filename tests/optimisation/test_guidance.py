"""Starts of drapes that lie closer to the pictures."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse

from dress_jax.geometry.intersection import count_intersections
from dress_jax.optimisation import FitMethod, init
from dress_jax.optimisation.draping import fitted_parameters
from dress_jax.optimisation.gauss_newton.guidance import (
    Pull,
    _smoothness,
    displacement,
    guided_start,
)
from dress_jax.optimisation.gauss_newton.model import make_reference, measure, pulls
from dress_jax.optimisation.problem import rest_shape
from dress_jax.sim import static_solve

GRID = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]])
"""A strip of four triangles."""


def test_without_a_pull_nothing_moves():
    nothing = Pull(np.zeros(0), scipy.sparse.csr_array((0, 18)), np.zeros(0))
    moved = displacement([nothing], np.ones(6), _smoothness(GRID, 6))
    assert np.array_equal(moved, np.zeros((6, 3)))


def test_one_row_moves_its_vertex_and_its_neighbours_less():
    row = scipy.sparse.csr_array(([1.0], ([0], [0])), shape=(1, 18))
    pull = Pull(np.array([-0.01]), row, np.array([1e4]))
    moved = displacement([pull], np.ones(6), _smoothness(GRID, 6))
    assert 0.009 < moved[0, 0] < 0.01
    assert moved[0, 0] > moved[1, 0] > moved[5, 0] > 0.0
    assert np.abs(moved[:, 1:]).max() < 1e-12


def test_smoothness_is_the_mean_squared_difference_along_edges():
    x = np.random.default_rng(1).normal(size=6)
    edges = [(GRID[f, k], GRID[f, (k + 1) % 3]) for f in range(4) for k in range(3)]
    expected = sum((x[i] - x[j]) ** 2 for i, j in edges) / 6
    assert x @ (_smoothness(GRID, 6) @ x) == pytest.approx(expected)


def test_a_guided_start_is_closer_and_free(fresh):
    """The drape of a wrong pattern is pulled toward the true one's pictures; let go, it is again a
    drape, and where folds decide nothing it is the same one."""
    problem, start = fresh(method=FitMethod.GAUSS_NEWTON, iterations=2)
    state = init(problem, start)
    unknowns, reference = state.unknowns, make_reference(problem)
    rest = rest_shape(problem, unknowns.pattern)
    parameters = fitted_parameters(problem, rest, unknowns.log_stiffness, unknowns.pin_shift)
    simulator = dataclasses.replace(problem.simulator)

    def guided(rounds):
        start = state.positions
        return guided_start(
            simulator, parameters, start, lambda x: pulls(problem, reference, x), rounds
        )

    assert guided(0).positions is state.positions
    pulled, rounds = guided(3)
    assert rounds == 3
    counts = count_intersections(
        np.asarray(pulled),
        np.asarray(problem.discretization.faces),
        np.asarray(parameters.body_vertices),
        simulator.body_faces,
    )
    assert counts.self == counts.body == 0
    off = [
        measure(problem, reference, reference.prior, unknowns, x).outline
        for x in (state.positions, pulled)
    ]
    assert off[1] < 0.7 * off[0]
    let_go = static_solve(simulator, parameters, pulled)
    assert let_go.report.converged and let_go.report.intersection_free
    assert float(jnp.abs(let_go.positions - state.positions).max()) < 2e-3
