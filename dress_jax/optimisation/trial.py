"""Try unknowns: drape, judge the drape, find the loss and its gradient."""

import dataclasses
import warnings
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from dress_jax.optimisation.draping import Clock, drape_info, simulate, smallest_relative_area
from dress_jax.optimisation.losses import Assessment, Garment, assess
from dress_jax.optimisation.observation import Observation
from dress_jax.optimisation.problem import FitProblem, rest_shape
from dress_jax.optimisation.report import FitInfo, StepOutcome
from dress_jax.optimisation.rules import broken_rules
from dress_jax.optimisation.state import Unknowns, finite
from dress_jax.sim import Simulator
from dress_jax.sim.adjoint import AdjointWarning


@dataclasses.dataclass(frozen=True)
class Trial:
    """Unknowns that were draped, and what came of it.

    Attributes:
        info: how it went.
        positions: of a sound drape [m], (n, 3).
        gradient: of the loss there; None unless the trial is accepted.
    """

    info: FitInfo
    positions: Array | None = None
    gradient: Unknowns | None = None


def select_views(observation: Observation, count: int | None, seed: int, turn: int) -> Observation:
    """The views of one iteration: the next `count` of a fixed permutation, cyclically.

    Args:
        observation: all views.
        count: how many; None for all.
        seed: of the permutation.
        turn: number of the iteration.
    """
    total = observation.view_count
    if count is None or count >= total:
        return observation
    order = np.random.default_rng(seed).permutation(total)
    chosen = order[(turn * count + np.arange(count)) % total]
    return jax.tree.map(lambda leaf: leaf[chosen], observation)


def try_unknowns(
    problem: FitProblem,
    unknowns: Unknowns,
    start: Array,
    *,
    iteration: int,
    clock: Clock | None = None,
) -> Trial:
    """Drape, loss and gradient, as far as the drape is sound.

    Newton's method with projected Hessians may come to rest near a saddle, where there is no
    gradient; the drape then goes on from there with a tenth of the tolerance, `options.polish`
    times at most.

    Args:
        problem: what is fitted.
        unknowns: to try.
        start: intersection-free positions [m].
        iteration: for the report and the choice of views.
        clock: see `loop.step`.
    """
    if not finite(unknowns):
        return Trial(FitInfo(iteration, StepOutcome.NON_FINITE))
    if broken_rules(problem, unknowns.pattern):
        return Trial(FitInfo(iteration, StepOutcome.RULE_BROKEN))
    rest = np.asarray(rest_shape(problem, unknowns.pattern))
    if not smallest_relative_area(problem, rest) >= problem.options.smallest_area:
        return Trial(FitInfo(iteration, StepOutcome.REST_DEGENERATE))

    newton, spent = problem.simulator.newton, list[FitInfo]()
    while True:
        # A copy: the simulator adapts its sparsity to the contacts that it meets, and with it the
        # order of sums. All drapes begin from the same one, so that a resumed fit repeats them bit
        # by bit.
        simulator = dataclasses.replace(problem.simulator, newton=newton)
        trial = _drape_and_assess(problem, simulator, unknowns, start, iteration, clock)
        spent.append(trial.info)
        failed = trial.info.outcome is StepOutcome.ADJOINT_FAILED
        if not failed or trial.positions is None or len(spent) > problem.options.polish:
            break
        start = trial.positions
        newton = dataclasses.replace(newton, tolerance=0.1 * newton.tolerance)
    seconds = {name: sum(i.seconds.get(name, 0.0) for i in spent) for name in spent[-1].seconds}
    iterations = sum(info.newton_iterations for info in spent)
    info = dataclasses.replace(trial.info, newton_iterations=iterations, seconds=seconds)
    return dataclasses.replace(trial, info=info)


def _drape_and_assess(
    problem: FitProblem,
    simulator: Simulator,
    unknowns: Unknowns,
    start: Array,
    iteration: int,
    clock: Clock | None,
) -> Trial:
    """One drape, and loss and gradient there if it is sound."""
    now = (lambda: 0.0) if clock is None else clock
    options, times = problem.options, [now()]

    def ended(info: FitInfo, **results: Any) -> Trial:
        if clock is not None:
            parts = np.diff(times).tolist()
            seconds = dict(zip(("forward", "loss", "adjoint"), parts, strict=False))
            info = dataclasses.replace(info, seconds={**seconds, "total": sum(parts)})
        return Trial(info, **results)

    (positions, rest, pattern), pull, report = jax.vjp(
        lambda pattern, log, shift: simulate(problem, simulator, pattern, log, shift, start),
        unknowns.pattern,
        unknowns.log_stiffness,
        unknowns.pin_shift,
        has_aux=True,
    )
    times.append(now())
    info = drape_info(problem, report, positions, iteration)
    if not info.accepted:
        return ended(info)

    weights = {name: jnp.asarray(w) for name, w in options.active_weights.items()}
    views = select_views(problem.observation, options.views_per_iteration, options.seed, iteration)
    garment = Garment(positions, rest, pattern, unknowns.colors)
    assessment = jax.block_until_ready(assess(garment, weights, problem.tables, views))
    times.append(now())
    info = _with_assessment(info, assessment)
    if not np.isfinite(info.loss):
        return ended(dataclasses.replace(info, outcome=StepOutcome.NON_FINITE))

    gradient = _pull_back(pull, assessment.gradient)
    times.append(now())
    if not finite(gradient):
        failed = dataclasses.replace(info, outcome=StepOutcome.ADJOINT_FAILED)
        return ended(failed, positions=positions)
    return ended(info, positions=positions, gradient=gradient)


def _with_assessment(info: FitInfo, assessment: Assessment) -> FitInfo:
    return dataclasses.replace(
        info,
        loss=float(assessment.loss),
        terms={name: float(value) for name, value in sorted(assessment.terms.items())},
        iou=float(assessment.iou),
        unfinished=round(float(assessment.unfinished)),
    )


def _pull_back(pull: Callable, slopes: Garment) -> Unknowns:
    """The gradient of the loss in the unknowns: through the drape, and what meets them directly."""
    with warnings.catch_warnings():
        # A failed adjoint is NaN, which rejects the step; that is the report of it.
        warnings.simplefilter("ignore", AdjointWarning)
        by_pattern, by_stiffness, by_shift = pull(
            (slopes.positions, slopes.rest_positions, slopes.pattern)
        )
    return Unknowns(
        pattern=by_pattern,
        log_stiffness=by_stiffness,
        pin_shift=by_shift,
        colors=slopes.colors,
    )
