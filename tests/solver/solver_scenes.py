"""Small matrices and energies for the solver's tests."""

import numpy as np
import scipy.sparse

from dress_jax.solver.linear import LinearSolveError


def upper(matrix: np.ndarray) -> scipy.sparse.csr_matrix:
    """The upper triangle of a symmetric matrix with its whole diagonal stored."""
    rows, cols = np.nonzero(np.triu(matrix != 0.0) | np.eye(len(matrix), dtype=bool))
    out = scipy.sparse.csr_matrix((matrix[rows, cols], (rows, cols)), shape=matrix.shape)
    out.sort_indices()
    return out


def positive_definite(blocks: int, seed: int) -> np.ndarray:
    """A random sparse symmetric positive-definite matrix of 3x3 blocks, eigenvalues 0.5 to 20."""
    rng = np.random.default_rng(seed)
    out = 0.5 * np.eye(3 * blocks)
    for _ in range(2 * blocks):
        i, j = rng.choice(blocks, 2, replace=False)
        v = np.zeros(3 * blocks)
        v[3 * i : 3 * i + 3], v[3 * j : 3 * j + 3] = rng.normal(size=(2, 3))
        out += np.outer(v, v)
    return out


class DenseFactorization:
    """A factorization by numpy."""

    def __init__(self, matrix: np.ndarray):
        self.matrix = matrix

    def solve(self, right_hand_side: np.ndarray) -> np.ndarray:
        return np.linalg.solve(self.matrix, right_hand_side)


class BrokenFactorization:
    """A factorization that works a number of times and then fails."""

    def __init__(self, matrix: np.ndarray, uses: int):
        self.good, self.uses = DenseFactorization(matrix), uses

    def solve(self, right_hand_side: np.ndarray) -> np.ndarray:
        if self.uses == 0:
            raise LinearSolveError("out of uses")
        self.uses -= 1
        return self.good.solve(right_hand_side)


def grid_graph(side: int) -> scipy.sparse.csr_matrix:
    """Nodes of a square grid, each tied to its four neighbours."""
    path = scipy.sparse.diags([np.ones(side - 1)] * 2, [-1, 1])
    graph = scipy.sparse.kronsum(path, path).tocsr()
    graph.sort_indices()
    return graph
