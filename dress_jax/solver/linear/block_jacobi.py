"""Conjugate gradients with a block-Jacobi preconditioner: portable, no factorization at all."""

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jax.experimental import sparse
from jaxtyping import Float

from dress_jax.solver.linear.interface import LinearSolveError

_RELATIVE_TOLERANCE = 1e-10
_ITERATION_LIMIT = 20_000


@jax.jit
def _solve(matrix: sparse.BCSR, inverse_blocks: jax.Array, b: jax.Array):
    def precondition(r):
        return jnp.einsum("nij,nj->ni", inverse_blocks, r.reshape(-1, 3)).reshape(-1)

    limit = _RELATIVE_TOLERANCE**2 * jnp.vdot(b, b)

    def unfinished(carry):
        _, r, _, _, iteration, curvature = carry
        return (jnp.vdot(r, r) > limit) & (iteration < _ITERATION_LIMIT) & (curvature > 0.0)

    def iterate(carry):
        x, r, p, rz, iteration, _ = carry
        product = matrix @ p
        curvature = jnp.vdot(p, product)
        step = rz / curvature
        x, r = x + step * p, r - step * product
        z = precondition(r)
        new = jnp.vdot(r, z)
        return x, r, z + (new / rz) * p, new, iteration + 1, curvature

    z = precondition(b)
    start = (jnp.zeros_like(b), b, z, jnp.vdot(b, z), 0, jnp.asarray(1.0))
    x, r, _, _, iterations, curvature = jax.lax.while_loop(unfinished, iterate, start)
    return x, jnp.vdot(r, r) <= limit, iterations, curvature


class _BlockJacobiSystem:
    def __init__(self, matrix: sparse.BCSR, inverse_blocks: jax.Array):
        self._matrix, self._inverse_blocks = matrix, inverse_blocks

    def solve(self, right_hand_side: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        b = np.asarray(right_hand_side, np.float64)
        if b.ndim == 2:
            return np.stack([self.solve(column) for column in b.T], axis=1)
        x, done, iterations, curvature = _solve(self._matrix, self._inverse_blocks, jnp.asarray(b))
        if not bool(done):
            cause = "negative curvature" if float(curvature) <= 0.0 else "the iteration limit"
            raise LinearSolveError(f"conjugate gradients met {cause} after {int(iterations)}")
        return np.asarray(x)


class BlockJacobiSolver:
    """Preconditioned conjugate gradients in JAX."""

    name = "block-jacobi-cg"

    def factorize(self, upper: scipy.sparse.csr_matrix) -> _BlockJacobiSystem:
        if not np.all(np.isfinite(upper.data)):
            raise LinearSolveError("the matrix has entries that are not finite")
        full = (upper + scipy.sparse.triu(upper, 1).T).tocsr()
        size = full.shape[0] // 3
        blocks = np.zeros((size, 3, 3))
        for i in range(3):
            for j in range(3):
                diagonal = full.diagonal(j - i)
                start = min(i, j)
                blocks[:, i, j] = diagonal[start::3][:size]
        try:
            np.linalg.cholesky(blocks)  # an indefinite preconditioner would hide a bad matrix
            inverse = np.linalg.inv(blocks)
        except np.linalg.LinAlgError as error:
            raise LinearSolveError("a diagonal block is not positive definite") from error
        return _BlockJacobiSystem(sparse.BCSR.from_scipy_sparse(full), jnp.asarray(inverse))
