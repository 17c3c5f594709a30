import numpy as np
import pytest
from solver_scenes import DenseFactorization, positive_definite

from dress_jax.solver.conjugate_gradient import conjugate_gradient

SIZE = 8
A = positive_definite(SIZE, seed=0)
M = A + 0.3 * positive_definite(SIZE, seed=1)  # a nearby preconditioner
B = np.random.default_rng(2).normal(size=3 * SIZE)


def _solve(matrix, tolerance=1e-12, b=B, preconditioner=M, **options):
    return conjugate_gradient(
        lambda v: matrix @ v, b, DenseFactorization(preconditioner), tolerance=tolerance, **options
    )


def test_against_a_dense_solve():
    result = _solve(A)
    assert result.converged and result.iterations <= 3 * SIZE
    # A relative residual of 1e-12 times a condition number below 100.
    np.testing.assert_allclose(result.solution, np.linalg.solve(A, B), rtol=0, atol=1e-9)


def test_a_perfect_preconditioner_takes_one_product():
    result = _solve(A, preconditioner=A)
    assert result.converged and result.iterations == 1
    assert result.smallest_curvature == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("limit", [1, 3, 6, 200])
def test_residual_is_in_the_norm_of_the_preconditioner(limit):
    """sqrt(r^T M^-1 r / b^T M^-1 b), also when the limit ends the iteration."""
    result = _solve(A, tolerance=1e-5, iteration_limit=limit)
    r = B - A @ result.solution
    expected = np.sqrt(r @ np.linalg.solve(M, r) / (B @ np.linalg.solve(M, B)))
    # The residual is updated, not recomputed.
    assert result.relative_residual == pytest.approx(expected, rel=1e-6)
    assert result.converged == (result.relative_residual <= 1e-5)
    assert result.iterations == limit or result.converged


def test_smallest_curvature_bounds_the_spectrum():
    """p^T A p / p^T M p lies within the spectrum of M^-1 A and comes near its lower end."""
    values = np.linalg.eigvals(np.linalg.solve(M, A)).real
    result = _solve(A)
    assert values.min() * (1.0 - 1e-9) <= result.smallest_curvature <= values.max()
    assert result.smallest_curvature < np.median(values)


def test_negative_curvature_is_noticed():
    """The last iterate before it is returned, and it is no ascent direction."""
    values, vectors = np.linalg.eigh(A)
    values[5] = -0.5
    indefinite = vectors @ np.diag(values) @ vectors.T
    result = _solve(indefinite, preconditioner=np.eye(len(A)))
    assert not result.converged and result.smallest_curvature <= 0.0
    assert np.all(np.isfinite(result.solution)) and result.solution @ B >= 0.0
    before = _solve(
        indefinite, preconditioner=np.eye(len(A)), iteration_limit=result.iterations - 1
    )
    np.testing.assert_array_equal(result.solution, before.solution)
    r = B - indefinite @ result.solution
    assert result.relative_residual == pytest.approx(np.linalg.norm(r) / np.linalg.norm(B))


def test_negative_curvature_along_the_first_direction():
    result = _solve(-A)
    assert not result.converged and result.iterations == 1
    np.testing.assert_array_equal(result.solution, 0.0)
    assert result.smallest_curvature < 0.0 and result.relative_residual == 1.0


def test_zero_right_hand_side():
    result = _solve(A, b=np.zeros_like(B))
    assert result.converged and result.iterations == 0
    np.testing.assert_array_equal(result.solution, 0.0)


def test_not_a_number_does_not_converge():
    assert not _solve(np.full_like(A, np.nan)).converged
