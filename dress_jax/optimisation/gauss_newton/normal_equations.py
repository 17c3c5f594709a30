"""Weighted least squares from linearized residuals, and a damped step. Host side, numpy."""

import numpy as np
from jaxtyping import Float

from dress_jax.optimisation.gauss_newton.constraints import Constraints, constrained_step
from dress_jax.optimisation.gauss_newton.prior import Quadratic
from dress_jax.optimisation.gauss_newton.quadratic_model import Model

_SMALLEST_DIAGONAL = 1e-6  # relative; directions without any effect are damped as well


def huber(
    residual: Float[np.ndarray, " r"], limit: float
) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, " r"]]:
    """Huber's function of every residual, and the factor on its square with the same gradient."""
    size = np.abs(residual)
    near = size <= limit
    value = np.where(near, 0.5 * size**2, limit * (size - 0.5 * limit))
    return value, np.where(near, 1.0, limit / np.where(near, 1.0, size))


def mean_square_model(
    residual: Float[np.ndarray, " r"], jacobian: Float[np.ndarray, "r k"]
) -> Model:
    """The model of half the mean square of residuals; zero without any."""
    count = max(len(residual), 1)
    return Model(jacobian.T @ residual / count, jacobian.T @ jacobian / count)


def along_rows(model: Model, basis: Float[np.ndarray, "r k"]) -> Model:
    """The model in k unknowns of a model in their coordinates along r basis vectors."""
    return Model(basis.T @ model.gradient, basis.T @ model.matrix @ basis)


def add(*models: Model) -> Model:
    """The sum."""
    return Model(
        np.sum([m.gradient for m in models], axis=0), np.sum([m.matrix for m in models], axis=0)
    )


def prior_model(prior: Quadratic, at: Float[np.ndarray, " k"]) -> Model:
    """The prior around some unknowns; exact."""
    return Model(prior.gradient(at), prior.matrix)


def damped_step(
    model: Model,
    damping: float,
    longest: Float[np.ndarray, " k"],
    constraints: Constraints | None = None,
) -> tuple[Float[np.ndarray, " k"], float]:
    """A Levenberg-Marquardt step and the decrease that the model promises for it.

    Args:
        model: of the cost.
        damping: relative to the diagonal of the matrix.
        longest: largest change of each unknown; the whole step is shortened to fit.
        constraints: that the step keeps; None for none.
    """
    diagonal = np.diag(model.matrix)
    diagonal = np.maximum(diagonal, _SMALLEST_DIAGONAL * diagonal.max())
    damped = Model(model.gradient, model.matrix + damping * np.diag(diagonal))
    if constraints is None:
        step = -np.linalg.solve(damped.matrix, damped.gradient)
    else:
        step = constrained_step(damped, constraints)
    step = step / max(1.0, float(np.max(np.abs(step) / longest)))
    return step, promised_decrease(model, step)


def promised_decrease(model: Model, step: Float[np.ndarray, " k"]) -> float:
    """By how much the model says that a step lowers the cost."""
    return -float(model.gradient @ step + 0.5 * step @ model.matrix @ step)
