"""Conjugate gradients on the host for matrices known by their products.

Preconditioned with a factorization of a nearby positive-definite matrix it takes a handful of
iterations, and it notices a direction of negative curvature.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from dress_jax.solver.linear.interface import Factorization


class ConjugateGradientResult(NamedTuple):
    """Solution and how it was reached.

    Attributes:
        solution: x, (n,).
        converged: whether the residual fell below the tolerance.
        iterations: number of matrix products.
        relative_residual: |b - A x| / |b| in the preconditioner's norm.
        smallest_curvature: smallest p^T A p / p^T M p met, with M the preconditioner; at or below
            zero the matrix is not positive definite.
        negative_direction: a p with p^T A p <= 0 where one was met, (n,), and p^T A x = 0.
    """

    solution: Float[np.ndarray, " n"]
    converged: bool
    iterations: int
    relative_residual: float
    smallest_curvature: float
    negative_direction: Float[np.ndarray, " n"] | None = None


def conjugate_gradient(
    product: Callable[[np.ndarray], np.ndarray],
    b: Float[np.ndarray, " n"],
    preconditioner: Factorization,
    *,
    tolerance: float,
    iteration_limit: int = 200,
) -> ConjugateGradientResult:
    """Solve A x = b.

    Args:
        product: v -> A v.
        tolerance: on the residual relative to b, both in the norm of the inverse preconditioner.
        iteration_limit: give up after this many products.

    Returns:
        The last iterate; on negative curvature, the iterate before it was met.
    """
    x = np.zeros_like(b)
    r = b.copy()
    z = preconditioner.solve(r)
    p = z
    preconditioned_p = r  # M p, updated along with p
    rz = float(r @ z)
    start = rz
    smallest = np.inf
    if start == 0.0:
        return ConjugateGradientResult(x, True, 0, 0.0, smallest)
    for iteration in range(1, iteration_limit + 1):
        q = product(p)
        curvature = float(p @ q)
        smallest = min(smallest, curvature / float(p @ preconditioned_p))
        if not curvature > 0.0:
            return ConjugateGradientResult(x, False, iteration, (rz / start) ** 0.5, smallest, p)
        step = rz / curvature
        x = x + step * p
        r = r - step * q
        z = preconditioner.solve(r)
        new = float(r @ z)
        if new <= tolerance**2 * start:
            return ConjugateGradientResult(
                x, True, iteration, max(new / start, 0.0) ** 0.5, smallest
            )
        ratio, rz = new / rz, new
        p = z + ratio * p
        preconditioned_p = r + ratio * preconditioned_p
    return ConjugateGradientResult(x, False, iteration_limit, (rz / start) ** 0.5, smallest)
