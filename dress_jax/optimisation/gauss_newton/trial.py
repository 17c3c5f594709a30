"""Try unknowns: drape, cost, and the model of the cost there."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from dress_jax.core.pytree import pytree
from dress_jax.energy.cloth import Parameters
from dress_jax.optimisation.draping import (
    Clock,
    drape_info,
    fitted_parameters,
    smallest_relative_area,
)
from dress_jax.optimisation.gauss_newton.guidance import Guided, guided_start
from dress_jax.optimisation.gauss_newton.model import (
    Reference,
    make_model,
    make_reference,
    measure,
    predict_displacement,
    pulls,
)
from dress_jax.optimisation.gauss_newton.quadratic_model import Model
from dress_jax.optimisation.losses import Garment, assess_value
from dress_jax.optimisation.problem import FitProblem, rest_shape, validated_pattern
from dress_jax.optimisation.report import FitInfo, StepOutcome
from dress_jax.optimisation.rules import broken_rules
from dress_jax.optimisation.state import Unknowns, finite
from dress_jax.sim import static_solve
from dress_jax.sim.sensitivity import predicted_start
from dress_jax.solver.linear import LinearSolveError


@pytree
class Iterate:
    """Accepted unknowns, and the model of the cost there.

    Attributes:
        unknowns: the pattern and the two stiffnesses.
        positions: their intersection-free drape [m], (n, 3).
        cost: of the drape, ().
        gradient, matrix: of the model, (k,) and (k, k).
    """

    unknowns: Unknowns
    positions: Float[Array, "n 3"]
    cost: Float[Array, ""]
    gradient: Float[Array, " k"]
    matrix: Float[Array, "k k"]


@dataclasses.dataclass(frozen=True)
class Trial:
    """Unknowns that were draped.

    Attributes:
        info: how it went.
        reached: None unless the trial is accepted.
    """

    info: FitInfo
    reached: Iterate | None = None


class _Stages:
    """Seconds by stage; all zero without a clock."""

    def __init__(self, clock: Clock | None):
        self._clock, self._last = clock, 0.0 if clock is None else clock()
        self._seconds = {"guidance": 0.0, "forward": 0.0, "loss": 0.0, "adjoint": 0.0}

    def done(self, stage: str) -> None:
        """Count the time since the last stage."""
        if self._clock is not None:
            now = self._clock()
            self._seconds[stage] += now - self._last
            self._last = now

    def seconds(self) -> dict[str, float]:
        """By stage and in total; empty without a clock."""
        if self._clock is None:
            return {}
        return {**self._seconds, "total": sum(self._seconds.values())}


def try_step(
    problem: FitProblem,
    unknowns: Unknowns,
    start: Array | tuple[Iterate, Float[np.ndarray, " k"]],
    ceiling: float,
    *,
    center: Float[Array, " k"],
    iteration: int,
    clock: Clock | None,
) -> Trial:
    """Drape, cost and model, as far as the drape is sound and its cost below the ceiling.

    A drape that is no stable equilibrium has no derivative; it goes on to a tighter tolerance,
    `options.polish` times at most.

    Args:
        problem: what is fitted.
        unknowns: to try.
        start: intersection-free positions [m], or an iterate and the change of its unknowns: the
            drape then begins where the sensitivities predict it.
        ceiling: of the cost.
        center: of the prior.
        iteration: for the report.
        clock: see `step`.
    """
    if not finite(unknowns):
        return Trial(FitInfo(iteration, StepOutcome.NON_FINITE))
    if broken_rules(problem, unknowns.pattern):
        return Trial(FitInfo(iteration, StepOutcome.RULE_BROKEN))
    rest = rest_shape(problem, unknowns.pattern)
    if not smallest_relative_area(problem, np.asarray(rest)) >= problem.options.smallest_area:
        return Trial(FitInfo(iteration, StepOutcome.REST_DEGENERATE))
    parameters = fitted_parameters(problem, rest, unknowns.log_stiffness, unknowns.pin_shift)
    reference = make_reference_once(problem)
    prior = reference.prior._replace(center=np.asarray(center))
    stages, newton, iterations = _Stages(clock), problem.simulator.newton, 0

    def ended(info: FitInfo, reached: Iterate | None = None, **changes: Any) -> Trial:
        changes |= {
            "newton_iterations": iterations,
            "guided_rounds": rounds,
            "seconds": stages.seconds(),
        }
        return Trial(dataclasses.replace(info, **changes), reached)

    if isinstance(start, tuple):
        begin = _prediction(problem, *start, parameters)
        positions, rounds = _guided(problem, parameters, begin)
        stages.done("guidance")
    else:
        positions, rounds = start, 0
    for attempt in range(1 + problem.options.polish):
        # A copy: see `optimisation.trial.try_unknowns`.
        simulator = dataclasses.replace(problem.simulator, newton=newton)
        drape = static_solve(simulator, parameters, positions)
        positions = drape.positions
        iterations += int(drape.report.iterations)
        info = drape_info(problem, drape.report, positions, iteration)
        stages.done("forward")
        if not info.accepted:
            return ended(info)
        measured = measure(problem, reference, prior, unknowns, positions)
        info = dataclasses.replace(
            info, cost=measured.cost, outline=measured.outline, unfinished=measured.unfinished
        )
        stages.done("loss")
        if not np.isfinite(measured.cost):
            return ended(info, outcome=StepOutcome.NON_FINITE)
        if not measured.cost < ceiling:
            return ended(info, outcome=StepOutcome.WORSE)
        try:
            model = make_model(problem, reference, prior, unknowns, positions, measured, parameters)
        except LinearSolveError:
            stages.done("adjoint")
            if attempt == problem.options.polish:
                return ended(info, outcome=StepOutcome.ADJOINT_FAILED)
            newton = dataclasses.replace(newton, tolerance=0.1 * newton.tolerance)
            continue
        stages.done("adjoint")
        info = _with_loss(problem, info, unknowns, positions, rest)
        stages.done("loss")
        return ended(info, _iterate(unknowns, positions, measured.cost, model))
    raise AssertionError("unreachable: every attempt returns or is followed by another")


def guided(problem: FitProblem, unknowns: Unknowns, positions: Array) -> Guided:
    """Where to begin the drape of some unknowns, from a state [m] toward the pictures."""
    rest = rest_shape(problem, unknowns.pattern)
    parameters = fitted_parameters(problem, rest, unknowns.log_stiffness, unknowns.pin_shift)
    return _guided(problem, parameters, positions)


def _guided(problem: FitProblem, parameters: Parameters, positions: Array) -> Guided:
    reference = make_reference_once(problem)
    return guided_start(
        problem.simulator,
        parameters,
        positions,
        lambda x: pulls(problem, reference, x),
        problem.options.gauss_newton.guidance,
    )


def _iterate(unknowns: Unknowns, positions: Array, cost: float, model: Model) -> Iterate:
    return Iterate(
        unknowns=unknowns,
        positions=positions,
        cost=jnp.asarray(cost),
        gradient=jnp.asarray(model.gradient),
        matrix=jnp.asarray(model.matrix),
    )


@functools.lru_cache(maxsize=2)
def make_reference_once(problem: FitProblem) -> Reference:
    """`make_reference`, kept for the problem in use."""
    return make_reference(problem)


def _prediction(
    problem: FitProblem, before: Iterate, change: Float[np.ndarray, " k"], parameters: Parameters
) -> Array:
    """Where the drape of changed unknowns is expected, as far as the way there is free [m]."""
    positions = np.asarray(before.positions)
    displacement = predict_displacement(problem, before.unknowns, positions, change)
    simulator = dataclasses.replace(problem.simulator)
    return jnp.asarray(predicted_start(simulator, parameters, positions, displacement))


def _with_loss(
    problem: FitProblem, info: FitInfo, unknowns: Unknowns, positions: Array, rest: Array
) -> FitInfo:
    """With the paper's loss, which no step looks at: it makes fits of both methods comparable."""
    weights = {name: jnp.asarray(w) for name, w in problem.options.active_weights.items()}
    pattern = validated_pattern(problem, unknowns.pattern)
    garment = Garment(positions, rest, pattern, unknowns.colors)
    assessment = jax.block_until_ready(
        assess_value(garment, weights, problem.tables, problem.observation)
    )
    return dataclasses.replace(
        info,
        loss=float(assessment.loss),
        terms={name: float(value) for name, value in sorted(assessment.terms.items())},
        iou=float(assessment.iou),
    )
