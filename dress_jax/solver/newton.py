"""Newton's method with a bounded line search; it knows no cloth.

The direction solves a projected (positive-definite) Hessian. That is stiffer than the true one
wherever the cloth is compressed, so its steps are too short, and twice the step is tried as well.
Once steps are small the exact Hessian takes over, which turns the linear convergence of the
projection into a quadratic one: by its Cholesky factorization, or where it is indefinite by
conjugate gradients preconditioned by the projected one. Where they meet negative curvature, as in a
cloth that is about to buckle, the step follows it downhill: the projected Hessian would creep
toward the saddle and leave it only after dozens of iterations.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from dress_jax.core.results import Result
from dress_jax.solver.conjugate_gradient import conjugate_gradient
from dress_jax.solver.linear import Factorization, LinearSolveError

Positions = Float[np.ndarray, "n 3"]


class Objective(Protocol):
    """An energy of vertex positions with a bound on how far one may step."""

    def value(self, positions: Positions) -> float:
        """The energy [J]."""
        ...

    def value_and_gradient(self, positions: Positions) -> tuple[float, Positions]:
        """The energy and its gradient [N]."""
        ...

    def factorize(self, positions: Positions, *, exact: bool = False) -> Factorization:
        """The Hessian, projected or exact, factorized.

        Raises:
            LinearSolveError: it is not positive definite.
        """
        ...

    def hessian_product(self, positions: Positions, direction: Positions) -> Positions:
        """The exact Hessian times a direction."""
        ...

    def step_bound(self, positions: Positions, displacement: Positions) -> float:
        """The largest admissible step length in (0, 1]; prepares evaluations up to it."""
        ...


@dataclasses.dataclass(frozen=True)
class NewtonOptions:
    """When to stop and how far to step.

    Attributes:
        tolerance: stop when no vertex would move further than this in a Newton step [m].
        iteration_limit: stop after this many steps.
        longest_step: no vertex moves further than this in one step [m]; keeps the candidate set
            small while the start is far from the solution.
        exact_below: use the exact Hessian once the last step was shorter than this [m].
    """

    tolerance: float = 1e-5
    iteration_limit: int = 300
    longest_step: float = 0.05
    exact_below: float = 1e-3


class NewtonProgress(NamedTuple):
    """What one iteration reports."""

    iteration: int
    energy: float
    step_size: float  # longest vertex displacement of the full step [m]
    step_length: float  # accepted fraction of the step
    bound: float  # admissible fraction of the step, up to 2 where twice the step was looked at
    exact: bool  # whether the exact Hessian gave the direction
    positions: Positions


@dataclasses.dataclass(frozen=True)
class NewtonSolution:
    """Where Newton's method ended.

    Attributes:
        positions: [m], (n, 3).
        result: how it ended.
        iterations: steps taken.
        step_size: longest vertex displacement of the last Newton step [m].
        energy: [J].
        residual: largest force on a vertex [N].
        factorization: of the exact or the projected Hessian at (or one step before) the solution.
    """

    positions: Positions
    result: Result
    iterations: int
    step_size: float
    energy: float
    residual: float
    factorization: Factorization | None


_ARMIJO = 1e-4
_STRETCH = 2.0  # how far beyond a step with the projected Hessian the search looks
_SHORTEST_FRACTION = 1e-10
# The inner conjugate gradients stop between these: loosely far away, tightly near the end. In
# between the tolerance is the step over a length [m]; that ties the order of convergence to it.
_LOOSEST, _TIGHTEST, _LENGTH = 3e-2, 1e-5, 2e-3
_EXACT_LIMIT = 40
# Relative to the energy: its rounding, and the change below which a step is judged by the gradient,
# because the energy is a sum of terms that may be orders larger and cancel.
_ROUNDING, _FAINT = 64.0 * np.finfo(float).eps, 1e-10


def minimize(
    objective: Objective,
    start: Positions,
    options: NewtonOptions,
    *,
    progress: Callable[[NewtonProgress], None] | None = None,
) -> NewtonSolution:
    """Minimize an energy from an admissible start.

    Every iterate is admissible: the line search starts at the objective's step bound.

    Args:
        objective: the energy.
        start: an admissible state [m].
        options: stopping rule and step limits.
        progress: called after every iteration.

    Returns:
        The solution with its result; never raises for a failed solve.
    """
    x = np.array(start, np.float64)
    factorization: Factorization | None = None
    size = math.inf
    # Where the exact Hessian was indefinite, it is left alone for 1, 2, 4 ... iterations.
    rested, rest = 0, 1
    energy, gradient = objective.value_and_gradient(x)

    def finish(result: Result, iterations: int) -> NewtonSolution:
        residual = float(np.max(np.linalg.norm(gradient, axis=1), initial=0.0))
        return NewtonSolution(x, result, iterations, size, energy, residual, factorization)

    for iteration in range(options.iteration_limit):
        if not (math.isfinite(energy) and np.all(np.isfinite(gradient))):
            return finish(Result.NON_FINITE, iteration)
        attempt = size < options.exact_below and iteration >= rested
        try:
            direction, exact, curvature, factorization = _direction(
                objective, x, gradient, options, attempt
            )
        except LinearSolveError:
            return finish(Result.LINEAR_SOLVE_FAILED, iteration)
        if attempt:
            rested, rest = (0, 1) if exact else (iteration + rest, 2 * rest)
        if not np.all(np.isfinite(direction)):
            return finish(Result.NON_FINITE, iteration)
        size = _longest(direction)
        if size <= options.tolerance:
            return finish(Result.CONVERGED, iteration)

        if size > options.longest_step:
            direction = direction * (options.longest_step / size)
            curvature *= (options.longest_step / size) ** 2
        # Only where the bound leaves room: the energy is asked nowhere beyond it.
        stretch = 1.0 if exact or curvature < 0.0 else _STRETCH
        stretch = min(stretch, options.longest_step / _longest(direction))
        bound = stretch * objective.step_bound(x, stretch * direction)
        slope = float(np.vdot(gradient, direction))
        rounding = _ROUNDING * abs(energy)
        fraction, trial = min(1.0, bound), None
        if abs(slope) + abs(curvature) <= _FAINT * abs(energy):
            # The energy can hardly tell a step from its own rounding, the gradient still can.
            trial = objective.value_and_gradient(x + fraction * direction)
            ratio = np.linalg.norm(trial[1]) / np.linalg.norm(gradient)
            if not (ratio < 0.5 and trial[0] <= energy + _FAINT * abs(energy)):
                trial = trial if ratio < 1.0 and abs(slope) <= rounding else None
                if trial is None and abs(slope) + abs(curvature) <= rounding:
                    return finish(Result.LINE_SEARCH_STALLED, iteration)
        if trial is None:
            found = _line_search(objective, x, direction, energy, slope, curvature, bound)
            if found is None:
                return finish(Result.LINE_SEARCH_STALLED, iteration)
            fraction = found
            trial = objective.value_and_gradient(x + fraction * direction)
        x = x + fraction * direction
        energy, gradient = trial
        if progress is not None:
            progress(NewtonProgress(iteration + 1, energy, size, fraction, bound, exact, x))
    return finish(Result.ITERATION_LIMIT, options.iteration_limit)


def _line_search(
    objective: Objective,
    x: Positions,
    direction: Positions,
    energy: float,
    slope: float,
    curvature: float,
    bound: float,
) -> float | None:
    """The largest of the fractions min(1, bound), a half of it, a quarter ... with enough descent.

    Where the first is enough and the bound is larger, the bound is taken if it is better.

    Args:
        energy, slope, curvature: at x along the direction [J].
        bound: admissible fraction.

    Returns:
        The fraction, or None where there is no descent.
    """
    rounding = _ROUNDING * abs(energy)

    def value_and_limit(fraction: float) -> tuple[float, float]:
        promised = fraction * slope + 0.5 * fraction**2 * curvature
        return objective.value(x + fraction * direction), energy + _ARMIJO * promised + rounding

    first = min(1.0, bound)
    fraction = first
    value, limit = value_and_limit(fraction)
    while not value <= limit:
        fraction *= 0.5
        if fraction < _SHORTEST_FRACTION * bound:
            return None
        value, limit = value_and_limit(fraction)
    if fraction == first < bound:
        further, limit = value_and_limit(bound)
        if further < value and further <= limit:
            return bound
    return fraction


class _Direction(NamedTuple):
    """Where to step.

    Attributes:
        displacement: the full step [m].
        exact: whether it solves the exact Hessian.
        curvature: the negative curvature that it follows [J], 0 where it does not.
        factorization: of the exact or of the projected Hessian.
    """

    displacement: Positions
    exact: bool
    curvature: float
    factorization: Factorization


def _direction(
    objective: Objective,
    x: Positions,
    gradient: Positions,
    options: NewtonOptions,
    attempt: bool,
) -> _Direction:
    """The step with the exact Hessian where it is definite, or the projected Newton step.

    Args:
        attempt: whether to try the exact one.

    Raises:
        LinearSolveError: the projected Hessian has no factorization, or a back-substitution failed.
    """
    if attempt:
        try:
            factorization = objective.factorize(x, exact=True)
            step = -factorization.solve(gradient.ravel()).reshape(x.shape)
        except LinearSolveError:
            pass  # it is indefinite, which an iterative solver notices in the solve
        else:
            return _Direction(step, True, 0.0, factorization)
    factorization = objective.factorize(x)
    projected = -factorization.solve(gradient.ravel()).reshape(x.shape)
    if not _longest(projected) < options.exact_below:
        return _Direction(projected, False, 0.0, factorization)
    return _refined(objective, x, gradient, projected, factorization, options)


def _refined(
    objective: Objective,
    x: Positions,
    gradient: Positions,
    projected: Positions,
    factorization: Factorization,
    options: NewtonOptions,
) -> _Direction:
    """A step with the exact Hessian by conjugate gradients, downhill along negative curvature."""
    operator = hessian_operator(objective, x)
    nearness = _longest(projected) / _LENGTH
    refined = conjugate_gradient(
        operator,
        -gradient.ravel(),
        factorization,
        tolerance=min(_LOOSEST, max(_TIGHTEST, nearness)),
        iteration_limit=_EXACT_LIMIT,
    )
    if refined.converged:
        return _Direction(refined.solution.reshape(x.shape), True, 0.0, factorization)
    if refined.negative_direction is None:
        return _Direction(projected, False, 0.0, factorization)
    # Besides the step so far; the two are conjugate.
    escape = refined.negative_direction
    length = min(options.exact_below, options.longest_step)
    escape = escape * (length / _longest(escape.reshape(x.shape)))
    if float(escape @ gradient.ravel()) > 0.0:
        escape = -escape
    curvature = min(float(escape @ operator(escape)), 0.0)
    step = (refined.solution + escape).reshape(x.shape)
    return _Direction(step, False, curvature, factorization)


def hessian_operator(
    objective: Objective, positions: Positions
) -> Callable[[Float[np.ndarray, " m"]], Float[np.ndarray, " m"]]:
    """The exact Hessian at a state, as a function of flat vectors."""

    def product(direction: np.ndarray) -> np.ndarray:
        return objective.hessian_product(positions, direction.reshape(positions.shape)).ravel()

    return product


def _longest(displacement: Positions) -> float:
    return float(np.sqrt(np.max(np.sum(displacement**2, axis=1), initial=0.0)))
