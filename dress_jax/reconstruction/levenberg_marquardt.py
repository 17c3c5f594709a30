"""Levenberg-Marquardt for a few hundred unknowns, on the host in double precision."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

Residuals = Callable[[np.ndarray], np.ndarray]

_FIRST_DAMPING = 1e-3  # of the largest curvature
_SMALLEST_DAMPING = 1e-12
_LARGEST_DAMPING = 1e8


@dataclasses.dataclass(frozen=True)
class Minimum:
    """Where a minimization ended.

    Attributes:
        vector: the unknowns.
        loss: sum of squares of the residuals there.
        losses: of every accepted step, the start first.
        iterations: Jacobians that were computed.
        converged: the last step would have changed the loss by less than the tolerance.
    """

    vector: Float[np.ndarray, " u"]
    loss: float
    losses: tuple[float, ...]
    iterations: int
    converged: bool


def minimize(
    residuals: Residuals,
    jacobian: Residuals,
    start: Float[np.ndarray, " u"],
    free: Bool[np.ndarray, " u"],
    *,
    iterations: int,
    tolerance: float = 1e-8,
    tidy: Callable[[np.ndarray], np.ndarray] = lambda vector: vector,
) -> Minimum:
    """Lower a sum of squares.

    A step solves (J^T J + d D) s = -J^T r, with D the diagonal of J^T J, which makes it independent
    of the units of the unknowns; d falls after a step that lowered the loss and rises otherwise.

    Args:
        residuals: r of the unknowns, (m,).
        jacobian: J there, (m, u).
        start: first unknowns.
        free: those that may change.
        iterations: Jacobians at most.
        tolerance: relative fall of the loss below which it has converged.
        tidy: brings accepted unknowns into a form of the same meaning.
    """
    vector, columns = np.array(start, np.float64), np.flatnonzero(free)
    rest = np.asarray(residuals(vector), np.float64)
    loss = float(np.sum(rest**2))
    losses, damping, rejections, done = [loss], _FIRST_DAMPING, 2.0, 0
    converged = not len(columns) or not np.isfinite(loss)
    while not converged and done < iterations:
        slopes = np.asarray(jacobian(vector), np.float64)[:, columns]
        done += 1
        normal, gradient = slopes.T @ slopes, slopes.T @ rest
        # An unknown without any influence has neither slope nor curvature; it stays.
        diagonal = np.maximum(np.diag(normal), 1e-12 * max(float(np.max(np.diag(normal))), 1e-300))
        while True:
            step = -np.linalg.solve(normal + damping * np.diag(diagonal), gradient)
            predicted = -float(step @ (gradient + 0.5 * normal @ step)) * 2.0
            trial = vector.copy()
            trial[columns] += step
            there = np.asarray(residuals(trial), np.float64)
            value = float(np.sum(there**2))
            if np.isfinite(value) and value <= loss:
                converged = loss - value <= tolerance * loss
                gain = (loss - value) / predicted if predicted > 0.0 else 1.0
                damping = max(damping * max(1 / 3, 1 - (2 * gain - 1) ** 3), _SMALLEST_DAMPING)
                rejections = 2.0
                vector = tidy(trial)
                rest, loss = np.asarray(residuals(vector), np.float64), value
                losses.append(loss)
                break
            damping, rejections = damping * rejections, 2.0 * rejections
            if damping > _LARGEST_DAMPING or predicted <= tolerance * loss:
                converged = True
                break
    return Minimum(vector, loss, tuple(losses), done, converged and np.isfinite(loss))
