"""Sparse LU from SciPy: always present, several times slower than a Cholesky."""

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Float

from dress_jax.solver.linear.interface import LinearSolveError


class _SuperluFactorization:
    def __init__(self, lu: scipy.sparse.linalg.SuperLU):
        self._lu = lu

    def solve(self, right_hand_side: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return self._lu.solve(np.asarray(right_hand_side, np.float64))


class SuperluSolver:
    """SciPy's splu in its symmetric mode."""

    name = "superlu"

    def factorize(
        self,
        upper: scipy.sparse.csr_matrix,
        positions: Float[np.ndarray, "nodes 3"] | None = None,
    ) -> _SuperluFactorization:
        if not np.all(np.isfinite(upper.data)):
            raise LinearSolveError("the matrix has entries that are not finite")
        full = (upper + scipy.sparse.triu(upper, 1).T).tocsc()
        try:
            lu = scipy.sparse.linalg.splu(
                full,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:
            raise LinearSolveError(f"the sparse LU factorization failed ({error})") from error
        # A positive-definite matrix needs no exchange of rows and has positive pivots; check both,
        # since a factorization of an indefinite matrix would give ascent directions.
        if np.any(lu.perm_r != lu.perm_c) or np.any(lu.U.diagonal() <= 0.0):
            raise LinearSolveError("the matrix is not positive definite")
        return _SuperluFactorization(lu)
