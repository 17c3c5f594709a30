"""A fit as `init` and `step` over an explicit state, by either method.

A step proposes new unknowns, drapes the garment with them and keeps them only if the drape is
sound. So the state always holds an intersection-free drape, and a step can be repeated bit by bit.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from dress_jax.optimisation import first_order
from dress_jax.optimisation.draping import Clock
from dress_jax.optimisation.gauss_newton import method as gauss_newton
from dress_jax.optimisation.options import FitMethod
from dress_jax.optimisation.problem import FitProblem
from dress_jax.optimisation.report import FitInfo
from dress_jax.optimisation.state import FitState

AnyState = FitState | gauss_newton.GaussNewtonState


class _Method(NamedTuple):
    init: Callable[..., Any]
    step: Callable[..., tuple[Any, FitInfo]]
    finished: Callable[[FitProblem, Any], bool]
    blank: Callable[[FitProblem], Any]
    carry_over: Callable[..., tuple[Any, FitInfo]]
    cost: Callable[[Any], float]


_METHODS = {
    FitMethod.ADAM: _Method(
        first_order.init,
        first_order.step,
        first_order.finished,
        first_order.blank,
        first_order.carry_over,
        first_order.cost,
    ),
    FitMethod.GAUSS_NEWTON: _Method(
        gauss_newton.init,
        gauss_newton.step,
        gauss_newton.finished,
        gauss_newton.blank,
        gauss_newton.carry_over,
        gauss_newton.cost,
    ),
}


def init(
    problem: FitProblem, positions: Float[np.ndarray, "n 3"], *, clock: Clock | None = None
) -> Any:
    """Drape the initial pattern and find the derivatives there.

    Args:
        problem: made by `make_problem`.
        positions: an intersection-free state to start from (`DressedGarment.positions`) [m].
        clock: for the timings of later reports; not needed.

    Returns:
        The first state: a `FitState` for Adam, a `GaussNewtonState` for Gauss-Newton.

    Raises:
        InputError: the initial pattern does not drape.
    """
    return _METHODS[problem.options.method].init(problem, positions, clock=clock)


def step(problem: FitProblem, state: Any, *, clock: Clock | None = None) -> tuple[Any, FitInfo]:
    """The next state, and what happened; see `first_order.step` and `gauss_newton.method.step`.

    Args:
        problem: made by `make_problem`.
        state: from `init` or an earlier step.
        clock: seconds since any fixed time; without one, `FitInfo.seconds` stays empty.
    """
    return _METHODS[problem.options.method].step(problem, state, clock=clock)


def finished(problem: FitProblem, state: Any) -> bool:
    """Whether all iterations are done, or the fit has come to a halt."""
    return _METHODS[problem.options.method].finished(problem, state)


def blank_state(problem: FitProblem) -> Any:
    """A state of the right structure; only its shapes mean something."""
    return _METHODS[problem.options.method].blank(problem)


def carry_over(
    old: FitProblem,
    state: Any,
    new: FitProblem,
    positions: Float[np.ndarray, "n 3"],
    *,
    clock: Clock | None = None,
) -> tuple[Any, FitInfo]:
    """Go on with another mesh of the same pattern (S13.5 to S13.8).

    The garment relaxes from its new start to the fitted rest shape; colours, and the optimiser's
    moments of them, are looked up in the old mesh.

    Args:
        old: problem of the state.
        state: to go on from; of Gauss-Newton, its best.
        new: the problem with the new mesh.
        positions: an intersection-free state of the new mesh [m].
        clock: see `step`.

    Returns:
        The state of the new problem, or None where the drape there cannot be used; and how it went.
    """
    return _METHODS[old.options.method].carry_over(old, state, new, positions, clock=clock)


def cost(state: Any) -> float:
    """What the steps of a state's method lower; comparable between meshes of one fit."""
    method = FitMethod.ADAM if isinstance(state, FitState) else FitMethod.GAUSS_NEWTON
    return _METHODS[method].cost(state)


def fit(
    problem: FitProblem,
    state: Any,
    *,
    on_iteration: Callable[[Any, FitInfo], bool | None] | None = None,
    clock: Clock | None = None,
) -> Any:
    """Step until finished.

    Args:
        problem: made by `make_problem`.
        state: from `init`, or a checkpoint.
        on_iteration: called after every step, for progress and checkpoints; True ends the fit.
        clock: see `step`.
    """
    while not finished(problem, state):
        state, info = step(problem, state, clock=clock)
        if on_iteration is not None and on_iteration(state, info):
            break
    return state
