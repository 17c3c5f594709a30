"""What a sparse solver for symmetric positive-definite systems must offer."""

from typing import Protocol

import numpy as np
import scipy.sparse
from jaxtyping import Float


class LinearSolveError(RuntimeError):
    """The matrix could not be factorized: not positive definite, singular or not finite."""


class Factorization(Protocol):
    """A factorized matrix."""

    def solve(self, right_hand_side: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """A^-1 b; also takes several right-hand sides as columns (n, k).

        Raises:
            LinearSolveError: the matrix is not positive definite, which an iterative solver may
                notice no earlier; or its iterations do not converge.
        """
        ...


class LinearSolver(Protocol):
    """Factorizes symmetric positive-definite matrices; keeps the symbolic part between calls."""

    name: str

    def factorize(
        self,
        upper: scipy.sparse.csr_matrix,
        positions: Float[np.ndarray, "nodes 3"] | None = None,
    ) -> Factorization:
        """Factorize a matrix given by its upper triangle, with sorted indices.

        Args:
            upper: with its whole diagonal, (n, n).
            positions: of nodes that have three unknowns each [m]. A direct solver has no use for
                them; an iterative one takes their rigid motions for what costs little energy.

        Raises:
            LinearSolveError: the matrix is not positive definite or not finite.
        """
        ...
