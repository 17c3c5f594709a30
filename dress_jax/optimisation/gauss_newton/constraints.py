"""The minimum of a quadratic model under linear constraints, by a dense active set. Host, numpy."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from dress_jax.optimisation.gauss_newton.quadratic_model import Model

_FEASIBLE = 1e-9  # [m or rad] by which a bound may be missed before it becomes active
_RANK = 1e-9  # relative; rules may say the same thing twice


class Constraints(NamedTuple):
    """Quantities that a step must bring to zero, or not below it.

    Attributes:
        gap: their values before the step, (m,).
        jacobian: their derivatives, (m, k).
        at_least: which may be positive, (m,).
    """

    gap: Float[np.ndarray, " m"]
    jacobian: Float[np.ndarray, "m k"]
    at_least: Bool[np.ndarray, " m"]


def constrained_step(model: Model, constraints: Constraints) -> Float[np.ndarray, " k"]:
    """The step that minimizes a model, with gap + jacobian step = 0 or >= 0.

    Bounds that a step would break become active, one after the other; those that hold it back for
    nothing become free again. Constraints that contradict each other are met in the least squares
    sense, and where the active set does not settle, its last choice is returned: callers check what
    they get.

    Args:
        model: with a positive definite matrix.
        constraints: see there.
    """
    gap, jacobian, bounds = constraints
    active = ~bounds
    for _ in range(4 * len(gap) + 1):
        step = _with_equalities(model, gap[active], jacobian[active])
        lack = np.where(bounds & ~active, gap + jacobian @ step, 0.0)
        if lack.min(initial=0.0) < -_FEASIBLE:
            active[int(np.argmin(lack))] = True
            continue
        # At the minimum the model's slope is what the active constraints hold up.
        force = np.zeros(len(gap))
        slope = model.gradient + model.matrix @ step
        force[active] = np.linalg.lstsq(jacobian[active].T, slope, rcond=_RANK)[0]
        pulling = np.where(bounds & active, force, 0.0)
        if not pulling.min(initial=0.0) < 0.0:
            break
        active[int(np.argmin(pulling))] = False
    return step


def _with_equalities(
    model: Model, gap: Float[np.ndarray, " m"], jacobian: Float[np.ndarray, "m k"]
) -> Float[np.ndarray, " k"]:
    """The minimum where all constraints are equalities, in a basis of what they leave free."""
    count = len(model.gradient)
    if not len(gap):
        return -np.linalg.solve(model.matrix, model.gradient)
    left, sizes, right = np.linalg.svd(jacobian, full_matrices=True)
    rank = int(np.sum(sizes > _RANK * sizes.max(initial=0.0)))
    along = right[:rank].T @ ((left[:, :rank].T @ -gap) / sizes[:rank])
    if rank == count:
        return along
    free = right[rank:].T
    slope = free.T @ (model.gradient + model.matrix @ along)
    return along - free @ np.linalg.solve(free.T @ model.matrix @ free, slope)
