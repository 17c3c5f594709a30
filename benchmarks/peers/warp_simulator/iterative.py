"""Warp's own conjugate gradients, where there is no direct solver: on the device of the kernels."""

import numpy as np
import scipy.sparse
import warp as wp
import warp.optim.linear
import warp.sparse
from jaxtyping import Float

from dress_jax.solver.linear import LinearSolveError

_TOLERANCE = 1e-8  # of the residual, relative
_LIMIT = 20000


class WarpConjugateGradient:
    """Block-Jacobi conjugate gradients, behind the interface of a direct solver."""

    def __init__(self, device: str):
        self._device = device
        self.name = f"conjugate gradients on {device}"

    def factorize(self, upper: scipy.sparse.csr_matrix) -> "_Prepared":
        """The matrix on the device, with its preconditioner."""
        full = (upper + scipy.sparse.triu(upper, 1).T).tobsr((3, 3))
        rows = np.repeat(np.arange(full.shape[0] // 3), np.diff(full.indptr))
        matrix = warp.sparse.bsr_from_triplets(
            full.shape[0] // 3,
            full.shape[1] // 3,
            wp.array(rows, dtype=int, device=self._device),
            wp.array(full.indices, dtype=int, device=self._device),
            wp.array(full.data, dtype=wp.mat33d, device=self._device),
        )
        return _Prepared(matrix, self._device)


class _Prepared:
    def __init__(self, matrix: warp.sparse.BsrMatrix, device: str):
        self._matrix, self._device = matrix, device
        self._preconditioner = warp.optim.linear.preconditioner(matrix, "block_jacobi_sequential")

    def solve(self, right_hand_side: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """A^-1 b.

        Raises:
            LinearSolveError: it does not converge, or b^T A^-1 b is negative: not definite.
        """
        b = wp.array(right_hand_side.reshape(-1, 3), dtype=wp.vec3d, device=self._device)
        x = wp.zeros_like(b)
        _, residual, allowed = warp.optim.linear.cg(
            self._matrix, b, x, tol=_TOLERANCE, maxiter=_LIMIT, M=self._preconditioner
        )
        solution = x.numpy().ravel()
        if not (residual <= allowed and float(solution @ right_hand_side) >= 0.0):
            raise LinearSolveError(f"conjugate gradients ended at a residual of {residual:.1e}")
        return solution
