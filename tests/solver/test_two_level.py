"""The two-level solver beyond what every solver must do (test_linear.py)."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg
from solver_scenes import positive_definite, upper

from dress_jax.energy.fabric import make_parameters
from dress_jax.sim import static_solve
from dress_jax.sim.objective import resting_objective
from dress_jax.solver.linear import LinearSolveError, make_solver, two_level
from dress_jax.solver.linear.layout import make_layout, padded_data
from dress_jax.solver.linear.two_level import TwoLevelSolver
from tests.sim.scenes import SOFT, draped_sheet

# Times as many iterations are not enough for block-Jacobi conjugate gradients.
GAIN = 10
# The solver stops at 1e-10; with contacts rounding leaves some more.
RESIDUAL = 1e-9
SHEET = 40


def full(matrix: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
    """Both triangles."""
    return (matrix + scipy.sparse.triu(matrix, 1).T).tocsr()


def sheet_matrix(side: int, *, pairs: int = 0, seed: int = 0):
    """Two sheets of springs, 10,000 times stiffer along their threads than across.

    Args:
        side: nodes of a side of each sheet.
        pairs: stiff ties between nodes of the one and the other.

    Returns:
        The upper triangle and the positions.
    """
    rng = np.random.default_rng(seed)
    s = np.arange(side)
    a, b = (part.ravel() for part in np.meshgrid(s, s, indexing="ij"))
    sheet = np.stack([a, b, 2.0 * np.sin(0.2 * a) + 0.1 * rng.normal(size=a.size)], axis=1)
    x = np.concatenate([sheet, sheet + np.array([0.0, 0.0, 0.5])])
    i = np.arange(side**2).reshape(side, side)
    ends = np.concatenate(
        [
            np.stack([first.ravel(), second.ravel()])
            for first, second in (
                (i[:-1], i[1:]),
                (i[:, :-1], i[:, 1:]),
                (i[:-1, :-1], i[1:, 1:]),
                (i[:-1, 1:], i[1:, :-1]),
            )
        ],
        axis=1,
    )
    ends = np.concatenate([ends, ends + side**2], axis=1)
    along = x[ends[1]] - x[ends[0]]
    along /= np.linalg.norm(along, axis=1)[:, None]
    springs = 1e4 * along[:, :, None] * along[:, None, :] + np.eye(3)
    touching = rng.choice(side**2, pairs, replace=False)
    normal = np.array([0.0, 0.0, 1.0])
    contacts = np.broadcast_to(1e6 * np.outer(normal, normal), (pairs, 3, 3))
    ends = np.concatenate([ends, np.stack([touching, touching + side**2])], axis=1)
    blocks = np.concatenate([springs, contacts])

    rows, cols, values = [], [], []
    for p, q, sign in ((0, 0, 1.0), (1, 1, 1.0), (0, 1, -1.0), (1, 0, -1.0)):
        rows.append(
            np.broadcast_to(3 * ends[p][:, None, None] + np.arange(3)[:, None], blocks.shape)
        )
        cols.append(np.broadcast_to(3 * ends[q][:, None, None] + np.arange(3), blocks.shape))
        values.append(sign * blocks)
    flat = [np.concatenate(part).ravel() for part in (values, rows, cols)]
    matrix = scipy.sparse.csr_matrix((flat[0], (flat[1], flat[2])), shape=(x.size, x.size))
    out = scipy.sparse.triu(matrix + 1e-2 * scipy.sparse.eye(x.size), format="csr")
    out.sort_indices()
    return out, x


def block_jacobi_converges(matrix: scipy.sparse.csr_matrix, b: np.ndarray, limit: int) -> bool:
    """Whether conjugate gradients with inverses of the 3x3 diagonal blocks do, by SciPy."""
    blocks = [matrix[k : k + 3, k : k + 3].toarray() for k in range(0, len(b), 3)]
    inverse = scipy.sparse.block_diag([np.linalg.inv(block) for block in blocks]).tocsr()
    return scipy.sparse.linalg.cg(matrix, b, rtol=1e-10, maxiter=limit, M=inverse)[1] == 0


def _right_hand_side(size: int) -> np.ndarray:
    return np.random.default_rng(3).normal(size=size)


@pytest.mark.parametrize("pairs", [0, 400])
def test_far_fewer_iterations_than_block_jacobi(pairs):
    """Also where stiff contacts tie the sheets."""
    matrix, x = sheet_matrix(SHEET, pairs=pairs)
    b = _right_hand_side(x.size)
    factorization = TwoLevelSolver().factorize(matrix, x)
    solution = factorization.solve(b)
    assert np.linalg.norm(full(matrix) @ solution - b) <= RESIDUAL * np.linalg.norm(b)
    assert not block_jacobi_converges(full(matrix), b, GAIN * factorization.iterations)


def test_rotations_need_positions_and_help():
    matrix, x = sheet_matrix(SHEET)
    b = _right_hand_side(x.size)
    iterations = []
    for positions in (x, None):
        factorization = TwoLevelSolver().factorize(matrix, positions)
        factorization.solve(b)
        iterations.append(factorization.iterations)
    assert iterations[0] < 0.8 * iterations[1]


def _system(matrix, x):
    layout = make_layout(matrix)
    padded = np.zeros((3, layout.aggregate.shape[0]))
    padded[:, : len(x)] = x.T
    data = jnp.asarray(padded_data(matrix.data))
    system, sound = two_level.prepare(data, jnp.asarray(padded), layout)
    assert bool(sound)
    return system, layout


def _dense(apply, layout, count):
    """The matrix of a function of vectors, without padding."""
    n = layout.aggregate.shape[0]
    columns = []
    for unknown in range(3 * count):
        unit = jnp.zeros((3, n)).at[unknown % 3, unknown // 3].set(1.0)
        columns.append(np.asarray(apply(unit))[:, :count].T.ravel())
    return np.stack(columns, axis=1)


def test_product_and_preconditioner_against_dense_matrices():
    """The product is the matrix, also where rows are long; the preconditioner is symmetric,
    positive definite, and the coarse part exact for rigid motions of an aggregate."""
    matrix, x = sheet_matrix(5, pairs=20)
    dense = full(matrix).toarray()
    system, layout = _system(matrix, x)
    apply = jax.jit(two_level.product)
    np.testing.assert_allclose(
        _dense(lambda v: apply(system, layout, v), layout, len(x)), dense, atol=1e-12 * 1e6
    )
    correct = jax.jit(two_level.precondition)
    inverse = _dense(lambda v: correct(system, layout, v), layout, len(x))
    scale = np.abs(inverse).max()
    np.testing.assert_allclose(inverse, inverse.T, atol=1e-12 * scale)
    assert np.linalg.eigvalsh(inverse).min() > 0.0
    # Every part of the sum is a projection in the energy, and at most 3 + 1 of them overlap.
    energies = np.linalg.eigvals(inverse @ dense)
    assert np.abs(energies.imag).max() < 1e-6 and energies.real.max() <= 5.0

    coarse = jax.jit(two_level._coarse_correction)
    inside = np.asarray(layout.aggregate)[: len(x)] == 0
    centre = x[inside].mean(axis=0)
    motion = np.cross([0.3, -0.5, 0.2], x - centre) + np.array([1.0, 2.0, 3.0])
    turned = np.where(inside[:, None], motion, 0.0)
    padded = np.zeros((3, layout.aggregate.shape[0]))
    padded[:, : len(x)] = (dense @ turned.ravel()).reshape(-1, 3).T
    moved = np.asarray(coarse(system, layout, jnp.asarray(padded)))[:, : len(x)].T
    np.testing.assert_allclose(moved, turned, atol=1e-6)


def test_rows_longer_than_the_product_is_wide():
    """One node tied to all others."""
    count = 60
    matrix = positive_definite(count, seed=0)
    for other in range(1, count):
        v = np.zeros(3 * count)
        v[:3], v[3 * other : 3 * other + 3] = 0.3, -0.2
        matrix += np.outer(v, v)
    b = _right_hand_side(3 * count)
    found = TwoLevelSolver().factorize(upper(matrix)).solve(b)
    np.testing.assert_allclose(found, np.linalg.solve(matrix, b), atol=1e-8)


def test_many_right_hand_sides():
    """More than are solved together, and one that is zero."""
    matrix, x = sheet_matrix(6)
    b = np.random.default_rng(1).normal(size=(x.size, 11))
    b[:, 4] = 0.0
    found = TwoLevelSolver().factorize(matrix, x).solve(b)
    expected = np.linalg.solve(full(matrix).toarray(), b)
    np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())
    assert not np.any(found[:, 4])


def test_negative_curvature_that_no_block_shows_is_met_in_the_solve():
    """Indefinite along one mode, while all patches and the coarse matrix are definite."""
    matrix, x = sheet_matrix(10)
    dense = full(matrix).toarray()
    values, vectors = np.linalg.eigh(dense)
    v = vectors[:, len(values) // 2]
    dense -= 1.2 * values[len(values) // 2] * np.outer(v, v)
    factorization = TwoLevelSolver().factorize(upper(dense), x)
    with pytest.raises(LinearSolveError, match="negative curvature"):
        factorization.solve(_right_hand_side(x.size))
    with pytest.raises(LinearSolveError, match="negative curvature"):
        factorization.solve(np.stack([_right_hand_side(x.size)] * 2, axis=1))


def test_no_convergence_is_an_error(monkeypatch):
    matrix, x = sheet_matrix(10)
    monkeypatch.setattr(two_level, "_ITERATION_LIMIT", 3)
    jax.clear_caches()
    with pytest.raises(LinearSolveError, match="no convergence in 3"):
        TwoLevelSolver().factorize(matrix, x).solve(_right_hand_side(x.size))
    jax.clear_caches()


def test_right_hand_side_that_is_not_a_number_is_an_error():
    matrix, x = sheet_matrix(6)
    b = _right_hand_side(x.size)
    b[7] = np.nan
    with pytest.raises(LinearSolveError):
        TwoLevelSolver().factorize(matrix, x).solve(b)


def test_size_that_is_no_multiple_of_three_is_refused():
    with pytest.raises(ValueError, match="three unknowns"):
        TwoLevelSolver().factorize(scipy.sparse.eye(10, format="csr"))


def test_other_contacts_compile_nothing():
    """The layout is kept while the sparsity stays, and its shapes are those of buckets."""
    solver = TwoLevelSolver()
    first, x = sheet_matrix(SHEET, pairs=300)
    b = _right_hand_side(x.size)
    solver.factorize(first, x).solve(b)
    layout = solver._layout
    solver.factorize(1.5 * first, x).solve(b)
    assert solver._layout is layout
    traces = two_level.prepare._cache_size(), two_level.solve._cache_size()
    other, x = sheet_matrix(SHEET, pairs=305, seed=1)
    solver.factorize(other, x).solve(b)
    assert solver._layout is not layout
    assert (two_level.prepare._cache_size(), two_level.solve._cache_size()) == traces


@pytest.mark.slow
def test_newton_ends_at_the_same_minimum():
    """A sheet in contact, with the direct solver and with this one, and its derivative."""
    cloth, simulator, rest, start, body = draped_sheet()
    parameters = make_parameters(
        cloth, SOFT, rest, body_vertices=body, pin_targets=start[np.asarray(cloth.pins)]
    )
    weights = jnp.asarray(np.random.default_rng(0).normal(size=np.shape(start)))
    ends, gradients = [], []
    for name in ("superlu", "two-level-cg"):
        own = dataclasses.replace(simulator, linear_solver=make_solver(name))

        def loss(parameters, own=own):
            result = static_solve(own, parameters, start)
            return jnp.sum(weights * result.positions), result

        gradient, result = jax.grad(loss, has_aux=True)(parameters)
        assert result.report.converged
        ends.append(np.asarray(result.positions))
        gradients.append(np.asarray(gradient.rest_positions))
    # Newton stops at steps of 1e-5 m.
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-5)
    scale = np.abs(gradients[0]).max()
    np.testing.assert_allclose(gradients[1], gradients[0], atol=1e-3 * scale)


def test_indefinite_hessian_is_left_alone_by_newton():
    """The exact Hessian of a compressed sheet: the solver raises, in set-up or in the solve."""
    cloth, simulator, rest, start, body = draped_sheet()
    parameters = make_parameters(
        cloth, SOFT, rest, body_vertices=body, pin_targets=start[np.asarray(cloth.pins)]
    )
    simulator = dataclasses.replace(simulator, linear_solver=make_solver("two-level-cg"))
    x = np.asarray(start) * [0.9, 1.0, 0.9]
    objective = resting_objective(simulator, parameters, x)
    with pytest.raises(LinearSolveError):
        objective.factorize(x, exact=True).solve(np.cos(np.arange(x.size)))
    objective.factorize(x).solve(np.cos(np.arange(x.size)))
