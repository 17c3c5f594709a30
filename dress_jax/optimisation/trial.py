"""Try unknowns: drape, judge the drape, find the loss and its gradient."""

import dataclasses
import warnings
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from dress_jax.core.pytree import replace
from dress_jax.core.results import Result
from dress_jax.energy.cloth import Parameters
from dress_jax.optimisation.losses import Assessment, Garment, assess
from dress_jax.optimisation.observation import Observation
from dress_jax.optimisation.problem import FitProblem
from dress_jax.optimisation.report import FitInfo, StepOutcome
from dress_jax.optimisation.state import Unknowns, finite
from dress_jax.pattern import rest_positions
from dress_jax.pattern.parameters import PatternParameters
from dress_jax.sim import Simulator, static_solve
from dress_jax.sim.equilibrium import AdjointWarning, Report

Clock = Callable[[], float]


@dataclasses.dataclass(frozen=True)
class Trial:
    """Unknowns that were draped, and what came of it."""

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


def simulate(
    problem: FitProblem,
    simulator: Simulator,
    pattern: PatternParameters,
    log_stiffness: Float[Array, "2"],
    start: Float[Array, "n 3"],
) -> tuple[tuple[Array, Array], Report]:
    """Rest shape and drape, differentiable in pattern and stiffness (S9.7).

    One implicit step of 1 s from rest (S9.3, S9.8); the start carries no gradient (S9.4).

    Returns:
        (draped positions, rest positions) [m], and how the solve went.
    """
    rest = rest_positions(pattern, problem.discretization)
    drape = static_solve(simulator, fitted_parameters(problem, rest, log_stiffness), start)
    return (drape.positions, rest), drape.report


def fitted_parameters(
    problem: FitProblem, rest: Float[Array, "p 2"], log_stiffness: Float[Array, "2"]
) -> Parameters:
    """The problem's parameters with a rest shape and factors on the two stiffnesses."""
    base = problem.parameters
    factor = jnp.exp(log_stiffness)
    return replace(
        base,
        rest_positions=rest,
        stretching_stiffness=base.stretching_stiffness * factor[0],
        bending_stiffness=base.bending_stiffness * factor[1],
    )


def smallest_relative_area(problem: FitProblem, rest: Float[np.ndarray, "p 2"]) -> float:
    """Least signed area of a rest triangle over the one it was meshed with."""
    corners = np.asarray(problem.discretization.rest_faces)

    def doubled(points: np.ndarray) -> np.ndarray:
        a, b, c = (points[corners[:, k]] for k in range(3))
        u, v = b - a, c - a
        return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]

    meshed = np.asarray(problem.discretization.meshed_positions)
    return float(np.min(doubled(np.asarray(rest)) / doubled(meshed)))


def try_unknowns(
    problem: FitProblem,
    unknowns: Unknowns,
    start: Array,
    *,
    iteration: int,
    clock: Clock | None,
) -> Trial:
    """Drape, loss and gradient, as far as the drape is sound."""
    now = (lambda: 0.0) if clock is None else clock
    options = problem.options
    begin = now()

    if not finite(unknowns):
        return Trial(FitInfo(iteration, StepOutcome.NON_FINITE))
    rest = np.asarray(rest_positions(unknowns.pattern, problem.discretization))
    if not smallest_relative_area(problem, rest) >= options.smallest_area:
        return Trial(FitInfo(iteration, StepOutcome.REST_DEGENERATE))

    # A copy: the simulator adapts its sparsity to the contacts that it meets, and with it the order
    # of sums. Every step begins from the same one, so that a resumed fit repeats it bit by bit.
    simulator = dataclasses.replace(problem.simulator)
    (positions, rest), pull, report = jax.vjp(
        lambda pattern, log: simulate(problem, simulator, pattern, log, start),
        unknowns.pattern,
        unknowns.log_stiffness,
        has_aux=True,
    )
    draped = now()
    info = FitInfo(
        iteration,
        _judge(report, positions, options.largest_remaining_step),
        newton_iterations=int(report.iterations),
        solve_result=Result(int(report.result)),
        remaining_step=float(report.step_size),
        intersections=int(report.self_intersections) + int(report.body_intersections),
    )

    def timed(info: FitInfo, **stages: float) -> FitInfo:
        if clock is None:
            return info
        stages = {"forward": draped - begin, **stages, "total": now() - begin}
        return dataclasses.replace(info, seconds=stages)

    if not info.accepted:
        return Trial(timed(info))

    weights = {name: jnp.asarray(w) for name, w in options.active_weights.items()}
    views = select_views(problem.observation, options.views_per_iteration, options.seed, iteration)
    garment = Garment(positions, rest, unknowns.pattern, unknowns.colors)
    assessment = jax.block_until_ready(assess(garment, weights, problem.tables, views))
    assessed = now()
    info = _with_assessment(info, assessment)
    if not np.isfinite(info.loss):
        return Trial(timed(dataclasses.replace(info, outcome=StepOutcome.NON_FINITE)))

    gradient = _pull_back(pull, assessment.gradient)
    info = timed(info, loss=assessed - draped, adjoint=now() - assessed)
    if not finite(gradient):
        return Trial(dataclasses.replace(info, outcome=StepOutcome.ADJOINT_FAILED))
    return Trial(info, positions, gradient)


def _judge(report: Report, positions: Array, largest_remaining_step: float) -> StepOutcome:
    if not bool(jnp.all(jnp.isfinite(positions))):
        return StepOutcome.NON_FINITE
    if not report.intersection_free:
        return StepOutcome.INTERSECTS
    close = float(report.step_size) <= largest_remaining_step
    return StepOutcome.ACCEPTED if report.converged or close else StepOutcome.SOLVE_FAILED


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
        by_pattern, by_stiffness = pull((slopes.positions, slopes.rest_positions))
    return Unknowns(
        pattern=jax.tree.map(jnp.add, by_pattern, slopes.pattern),
        log_stiffness=by_stiffness,
        colors=slopes.colors,
    )
