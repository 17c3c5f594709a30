"""Weighted least squares from linearized residuals, and a damped step. Host side, numpy."""

from typing import NamedTuple

import numpy as np
import scipy.sparse
from jaxtyping import Float

from dress_jax.optimisation.gauss_newton.outline import Rows
from dress_jax.optimisation.gauss_newton.prior import Quadratic

_SMALLEST_DIAGONAL = 1e-6  # relative; directions without any effect are damped as well


class Model(NamedTuple):
    """A quadratic model of the cost around some unknowns."""

    gradient: Float[np.ndarray, " k"]
    matrix: Float[np.ndarray, "k k"]


def huber(
    residual: Float[np.ndarray, " r"], limit: float
) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, " r"]]:
    """Huber's function of every residual, and the factor on its square with the same gradient."""
    size = np.abs(residual)
    near = size <= limit
    value = np.where(near, 0.5 * size**2, limit * (size - 0.5 * limit))
    return value, np.where(near, 1.0, limit / np.where(near, 1.0, size))


def outline_cost(rows: Rows, *, scale: float, limit: float) -> float:
    """The mean of Huber's function of the outlines' distances, in units of the scale."""
    value, _ = huber(rows.residual, limit)
    return float(np.sum(rows.weight * value)) / scale**2


def outline_model(
    rows: Rows, sensitivity: Float[np.ndarray, "n3 k"], *, scale: float, limit: float
) -> Model:
    """The model of `outline_cost`.

    Args:
        rows: distances and their derivatives in the positions.
        sensitivity: derivatives of the flattened positions in the unknowns.
        scale, limit: as in `outline_cost` [m].
    """
    _, factor = huber(rows.residual, limit)
    jacobian = rows.jacobian @ sensitivity
    weighted = (rows.weight * factor / scale**2)[:, None] * jacobian
    return Model(weighted.T @ rows.residual, weighted.T @ jacobian)


def normal_cost(
    residual: Float[np.ndarray, "*q 3"],
    weight: Float[np.ndarray, "*q"],
    *,
    scale: float,
    limit: float,
) -> float:
    """The mean of Huber's function of the normals' differences, in units of the scale."""
    value, _ = huber(np.linalg.norm(residual, axis=-1), limit)
    return float(np.sum(weight * value)) / scale**2


def normal_model(
    residual: Float[np.ndarray, "*q 3"],
    weight: Float[np.ndarray, "*q"],
    jacobian: scipy.sparse.csr_array,
    sensitivity: Float[np.ndarray, "n3 k"],
    *,
    scale: float,
    limit: float,
) -> Model:
    """The model of `normal_cost`.

    Args:
        residual: differences.
        weight: share of each in the mean.
        jacobian: their derivatives in the flattened positions.
        sensitivity: derivatives of the flattened positions in the unknowns.
        scale, limit: as in `normal_cost`.
    """
    _, factor = huber(np.linalg.norm(residual, axis=-1), limit)
    root = np.repeat(np.sqrt(weight * factor).ravel() / scale, 3)
    used = root > 0.0
    root = root[used]
    rows = root[:, None] * (jacobian[used] @ sensitivity)
    return Model(rows.T @ (root * residual.ravel()[used]), rows.T @ rows)


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
    model: Model, damping: float, longest: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, " k"], float]:
    """A Levenberg-Marquardt step and the decrease that the model promises for it.

    Args:
        model: of the cost.
        damping: relative to the diagonal of the matrix.
        longest: largest change of each unknown; the whole step is shortened to fit.
    """
    diagonal = np.diag(model.matrix)
    diagonal = np.maximum(diagonal, _SMALLEST_DIAGONAL * diagonal.max())
    step = -np.linalg.solve(model.matrix + damping * np.diag(diagonal), model.gradient)
    step = step / max(1.0, float(np.max(np.abs(step) / longest)))
    return step, promised_decrease(model, step)


def promised_decrease(model: Model, step: Float[np.ndarray, " k"]) -> float:
    """By how much the model says that a step lowers the cost."""
    return -float(model.gradient @ step + 0.5 * step @ model.matrix @ step)
