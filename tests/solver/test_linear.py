import numpy as np
import pytest
from solver_scenes import positive_definite, upper

from dress_jax.core.errors import InputError
from dress_jax.solver.linear import LinearSolveError, available_solvers, make_solver

SOLVERS = available_solvers()
SOLVER = pytest.mark.parametrize("name", SOLVERS)
BLOCKS = 8
# Condition numbers are below 100; the iterative solver stops at a residual of 1e-10.
TOLERANCE = {"two-level-cg": 1e-8}
DIRECT = 1e-12


def _right_hand_sides(columns: int, seed: int = 9) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(3 * BLOCKS, columns))


def _check(name, factorization, matrix):
    b = _right_hand_sides(3)
    tolerance = TOLERANCE.get(name, DIRECT)
    expected = np.linalg.solve(matrix, b)
    np.testing.assert_allclose(factorization.solve(b[:, 0]), expected[:, 0], atol=tolerance)
    several = factorization.solve(b)
    assert several.shape == b.shape
    np.testing.assert_allclose(several, expected, atol=tolerance)


@SOLVER
def test_against_a_dense_solve(name):
    solver = make_solver(name)
    assert solver.name == name
    matrix = positive_definite(BLOCKS, seed=0)
    _check(name, solver.factorize(upper(matrix)), matrix)


@SOLVER
def test_right_hand_side_is_left_alone(name):
    matrix = positive_definite(BLOCKS, seed=0)
    b = _right_hand_sides(1)[:, 0]
    copy = b.copy()
    factorization = make_solver(name).factorize(upper(matrix))
    first = factorization.solve(b)
    np.testing.assert_array_equal(b, copy)
    np.testing.assert_array_equal(factorization.solve(b), first)
    np.testing.assert_array_equal(factorization.solve(0.0 * b), 0.0)


@SOLVER
def test_old_factorizations_stay_valid(name):
    """Also after other matrices of the same and of another pattern went through the solver."""
    solver = make_solver(name)
    first = positive_definite(BLOCKS, seed=1)
    same_pattern = first + np.diag(np.linspace(1.0, 2.0, len(first)))
    other_pattern = positive_definite(BLOCKS, seed=2)
    matrices = [first, same_pattern, other_pattern]
    factorizations = [solver.factorize(upper(matrix)) for matrix in matrices]
    for matrix, factorization in zip(matrices, factorizations, strict=True):
        _check(name, factorization, matrix)
    _check(name, factorizations[0], first)


def _indefinite():
    out = positive_definite(BLOCKS, seed=3)
    values, vectors = np.linalg.eigh(out)
    values[len(values) // 2] = -3.0
    return vectors @ np.diag(values) @ vectors.T


def _zero_diagonal():
    """Indefinite with zero pivots: an exchange of rows would make all of them positive."""
    out = np.eye(3 * BLOCKS)
    out[:2, :2] = [[0.0, 1.0], [1.0, 0.0]]
    return out


def _singular():
    """A vertex without mass or stiffness."""
    out = positive_definite(BLOCKS, seed=4)
    out[6:9] = 0.0
    out[:, 6:9] = 0.0
    return out


def _not_finite():
    out = positive_definite(BLOCKS, seed=5)
    out[4, 4] = np.nan
    return out


BAD = {
    "indefinite": _indefinite,
    "zero diagonal": _zero_diagonal,
    "singular": _singular,
    "not finite": _not_finite,
}


@SOLVER
@pytest.mark.parametrize("fault", BAD)
def test_faults_raise_and_the_solver_recovers(name, fault):
    """An iterative solver has no factorization to fail, so its error may come from the solve."""
    solver = make_solver(name)
    good = positive_definite(BLOCKS, seed=6)
    before = solver.factorize(upper(good))
    with pytest.raises(LinearSolveError):
        solver.factorize(upper(BAD[fault]())).solve(_right_hand_sides(1)[:, 0])
    _check(name, before, good)
    other = positive_definite(BLOCKS, seed=7)
    _check(name, solver.factorize(upper(other)), other)


@pytest.mark.parametrize("name", [name for name in SOLVERS if name != "two-level-cg"])
@pytest.mark.parametrize("fault", BAD)
def test_direct_solvers_find_faults_when_factorizing(name, fault):
    with pytest.raises(LinearSolveError):
        make_solver(name).factorize(upper(BAD[fault]()))


def test_choice():
    assert make_solver().name == make_solver("auto").name == SOLVERS[0]
    assert {"superlu", "two-level-cg"} <= set(SOLVERS)
    with pytest.raises(InputError, match="choose one of"):
        make_solver("gauss")


@pytest.mark.parametrize(("backend", "chosen"), [("cpu", SOLVERS[0]), ("gpu", "two-level-cg")])
def test_where_jax_computes_elsewhere_the_host_factorizes_nothing(monkeypatch, backend, chosen):
    monkeypatch.setattr("jax.default_backend", lambda: backend)
    assert make_solver("auto").name == chosen
