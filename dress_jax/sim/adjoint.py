"""Linear solves with the exact Hessian at the end of a step (S2.5, S2.8)."""

import warnings

import numpy as np
from jaxtyping import Float

from dress_jax.core.results import Result
from dress_jax.sim.objective import StepObjective
from dress_jax.solver.conjugate_gradient import conjugate_gradient
from dress_jax.solver.linear import Factorization, LinearSolveError
from dress_jax.solver.newton import hessian_operator

_TOLERANCE = 1e-12
# Relative residual that will do where rounding keeps the iterations from the tolerance: a
# derivative is held to differences at 1e-5.
_SUFFICIENT = 1e-10
_ITERATION_LIMIT = 300


class AdjointWarning(UserWarning):
    """The linear solve of a derivative failed; the derivative is NaN."""


class Linearization:
    """The end of a step, ready for linear solves with its exact Hessian.

    The first right-hand side is solved by conjugate gradients with what the forward solve left as
    preconditioner; from the second one on, the exact Hessian is factorized once for all.

    Args:
        objective: of the step.
        positions: its end [m].
        factorization: of a projected Hessian close to the end; None makes one where it is needed.
    """

    def __init__(
        self,
        objective: StepObjective,
        positions: Float[np.ndarray, "n 3"],
        factorization: Factorization | None = None,
    ):
        self.objective, self.positions = objective, positions
        self._projected = factorization
        self._exact: Factorization | None = None
        self._indefinite = False
        self._solves = 0

    def solve(self, right: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The inverse of the exact Hessian times a right-hand side.

        NaN, with a warning, where the solve fails: a derivative that does not exist must not pass
        as a number.
        """
        if not np.any(right):
            return np.zeros_like(right)
        self._solves += 1
        try:
            if self._wants_exact():
                self._exact = self._factorize()
            return self._preconditioned(right)
        except LinearSolveError as error:
            return _failed(right, str(error))

    def _preconditioned(self, right: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        if self._exact is not None:
            try:
                return solve_exact(self.objective, self.positions, right, self._exact)
            except LinearSolveError:
                # An iterative solver notices no earlier that a matrix is indefinite.
                self._exact, self._indefinite = None, True
        if self._projected is None:
            self._projected = self.objective.factorize(self.positions)
        return solve_exact(self.objective, self.positions, right, self._projected)

    def _wants_exact(self) -> bool:
        """Whether to factorize the exact Hessian: once, unless one solve is all that is asked."""
        once = self._solves == 1 and self._projected is not None
        return self._exact is None and not self._indefinite and not once

    def _factorize(self) -> Factorization | None:
        """The exact Hessian where it is positive definite."""
        try:
            return self.objective.factorize(self.positions, exact=True)
        except LinearSolveError:
            # Conjugate gradients will meet the negative curvature, and say so.
            self._indefinite = True
            return None


def solve_exact(
    objective: StepObjective,
    positions: Float[np.ndarray, "n 3"],
    right: Float[np.ndarray, "n 3"],
    preconditioner: Factorization,
) -> Float[np.ndarray, "n 3"]:
    """The inverse of the exact Hessian times a right-hand side; NaN with a warning if it fails."""
    solved = conjugate_gradient(
        hessian_operator(objective, positions),
        np.asarray(right, np.float64).ravel(),
        preconditioner,
        tolerance=_TOLERANCE,
        iteration_limit=_ITERATION_LIMIT,
    )
    if solved.converged or (
        solved.smallest_curvature > 0.0 and solved.relative_residual <= _SUFFICIENT
    ):
        return solved.solution.reshape(positions.shape)
    if solved.smallest_curvature <= 0.0:
        return _failed(right, Result.INDEFINITE_HESSIAN.message)
    return _failed(
        right,
        f"conjugate gradients reached a relative residual of {solved.relative_residual:.1e} in "
        f"{solved.iterations} iterations",
    )


def _failed(right: np.ndarray, reason: str) -> np.ndarray:
    warnings.warn(
        f"the linear solve of a derivative failed, and the gradient is NaN: {reason}",
        AdjointWarning,
        stacklevel=2,
    )
    return np.full_like(right, np.nan)
