"""Gauss-Newton with damping as `init` and `step` over an explicit state.

A pattern has a few hundred unknowns. The sensitivity of the drape to all of them costs one
factorization of the exact Hessian and a back-substitution for each; with it the distances between
drawn and target outlines are linearized, and a step solves for all unknowns at once. Folds that
snap from one shape to another are beyond any derivative: a step that meets one is rejected, and
tried again with more damping.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.core.pytree import pytree, replace
from dress_jax.optimisation.draping import (
    Clock,
    does_not_drape,
    drape_info,
    fitted_parameters,
    initial_unknowns,
    settle,
    smallest_relative_area,
)
from dress_jax.optimisation.gauss_newton.model import (
    Measurement,
    Reference,
    as_vector,
    from_vector,
    make_model,
    make_reference,
    measure,
    step_limits,
)
from dress_jax.optimisation.gauss_newton.normal_equations import Model, damped_step
from dress_jax.optimisation.losses import Garment, assess_value
from dress_jax.optimisation.problem import FitProblem
from dress_jax.optimisation.report import FitInfo, StepOutcome
from dress_jax.optimisation.state import Unknowns, finite
from dress_jax.pattern import rest_positions
from dress_jax.sim import static_solve
from dress_jax.solver.linear import LinearSolveError

_WELL_PREDICTED, _BADLY_PREDICTED = 0.6, 0.25
"""Actual over promised decrease from which the damping falls, and below which it rises."""


@pytree
class GaussNewtonState:
    """A fit between two steps; the unknowns are always ones that drape without intersections.

    Attributes:
        unknowns: last accepted values.
        positions: the drape there, and the start of the next one (S9.5) [m], (n, 3).
        cost: there, ().
        gradient, matrix: the model of the cost there, (k,) and (k, k).
        damping: of the next step, ().
        idle: accepted steps in a row that hardly lowered the cost, ().
        iteration: steps so far, accepted or not, ().
    """

    unknowns: Unknowns
    positions: Float[Array, "n 3"]
    cost: Float[Array, ""]
    gradient: Float[Array, " k"]
    matrix: Float[Array, "k k"]
    damping: Float[Array, ""]
    idle: Int[Array, ""]
    iteration: Int[Array, ""]


@dataclasses.dataclass(frozen=True)
class _Trial:
    """Unknowns that were draped; without a model unless they are accepted."""

    info: FitInfo
    positions: Array | None = None
    model: Model | None = None


def init(
    problem: FitProblem, positions: Float[np.ndarray, "n 3"], *, clock: Clock | None = None
) -> GaussNewtonState:
    """Drape the initial pattern and find the model there.

    Args:
        problem: made by `make_problem`.
        positions: an intersection-free state to start from (`DressedGarment.positions`) [m].
        clock: for the timings of later reports; not needed.

    Raises:
        InputError: the initial pattern does not drape.
    """
    unknowns = initial_unknowns(problem)
    trial = _try(problem, unknowns, settle(problem, positions), np.inf, iteration=0, clock=clock)
    if trial.model is None or trial.positions is None:
        raise does_not_drape(problem, trial.info)
    return GaussNewtonState(
        unknowns=unknowns,
        positions=trial.positions,
        cost=jnp.asarray(trial.info.cost),
        gradient=jnp.asarray(trial.model.gradient),
        matrix=jnp.asarray(trial.model.matrix),
        damping=jnp.asarray(problem.options.gauss_newton.damping),
        idle=jnp.asarray(0),
        iteration=jnp.asarray(0),
    )


def step(
    problem: FitProblem, state: GaussNewtonState, *, clock: Clock | None = None
) -> tuple[GaussNewtonState, FitInfo]:
    """Propose, drape, and keep what lowers the cost.

    Besides that, what is accepted is what Adam accepts, see `first_order.step`.

    Args:
        problem: made by `make_problem`.
        state: from `init` or an earlier step.
        clock: seconds since any fixed time; without one, `FitInfo.seconds` stays empty.
    """
    options = problem.options.gauss_newton
    damping, iteration = float(state.damping), int(state.iteration)
    model = Model(np.asarray(state.gradient), np.asarray(state.matrix))
    change, promised = damped_step(model, damping, step_limits(state.unknowns, options))
    unknowns = from_vector(as_vector(state.unknowns) + change, state.unknowns)
    cost = float(state.cost)
    trial = _try(problem, unknowns, state.positions, cost, iteration=iteration, clock=clock)
    info = dataclasses.replace(trial.info, damping=damping)
    following = jnp.asarray(iteration + 1)
    if trial.model is None or trial.positions is None:
        raised = jnp.asarray(damping * options.raise_damping)
        return replace(state, iteration=following, damping=raised), info
    decrease = cost - info.cost
    if decrease > _WELL_PREDICTED * promised:
        damping = max(damping * options.lower_damping, options.least_damping)
    elif decrease < _BADLY_PREDICTED * promised:
        damping = damping / options.lower_damping
    idle = int(state.idle) + 1 if decrease < options.idle_decrease * cost else 0
    return (
        GaussNewtonState(
            unknowns=unknowns,
            positions=trial.positions,
            cost=jnp.asarray(info.cost),
            gradient=jnp.asarray(trial.model.gradient),
            matrix=jnp.asarray(trial.model.matrix),
            damping=jnp.asarray(damping),
            idle=jnp.asarray(idle),
            iteration=following,
        ),
        info,
    )


def finished(problem: FitProblem, state: GaussNewtonState) -> bool:
    """Whether all iterations are done, or the cost does not fall any more."""
    options = problem.options.gauss_newton
    return (
        int(state.iteration) >= problem.options.iterations
        or int(state.idle) >= options.idle_steps
        or float(state.damping) > options.most_damping
    )


def blank(problem: FitProblem) -> GaussNewtonState:
    """A state of the right structure; only its shapes mean something."""
    unknowns = initial_unknowns(problem)
    count = len(as_vector(unknowns))
    return GaussNewtonState(
        unknowns=unknowns,
        positions=jnp.zeros((problem.discretization.vertex_count, 3)),
        cost=jnp.asarray(0.0),
        gradient=jnp.zeros(count),
        matrix=jnp.zeros((count, count)),
        damping=jnp.asarray(0.0),
        idle=jnp.asarray(0),
        iteration=jnp.asarray(0),
    )


@functools.lru_cache(maxsize=2)
def _reference(problem: FitProblem) -> Reference:
    return make_reference(problem)


def _try(
    problem: FitProblem,
    unknowns: Unknowns,
    start: Array,
    cost: float,
    *,
    iteration: int,
    clock: Clock | None,
) -> _Trial:
    """Drape, cost and model, as far as the drape is sound and its cost below the given one.

    A drape that is no stable equilibrium has no derivative; it goes on to a tighter tolerance,
    `options.polish` times at most.
    """
    if not finite(unknowns):
        return _Trial(FitInfo(iteration, StepOutcome.NON_FINITE))
    rest = rest_positions(unknowns.pattern, problem.discretization)
    if not smallest_relative_area(problem, np.asarray(rest)) >= problem.options.smallest_area:
        return _Trial(FitInfo(iteration, StepOutcome.REST_DEGENERATE))
    now = (lambda: 0.0) if clock is None else clock
    seconds = {"forward": 0.0, "loss": 0.0, "adjoint": 0.0}
    parameters = fitted_parameters(problem, rest, unknowns.log_stiffness)
    reference, newton, iterations = _reference(problem), problem.simulator.newton, 0

    def ended(info: FitInfo, **results) -> _Trial:
        times = {} if clock is None else {**seconds, "total": sum(seconds.values())}
        info = dataclasses.replace(info, newton_iterations=iterations, seconds=times)
        return _Trial(info, **results)

    for _ in range(1 + problem.options.polish):
        begun = now()
        # A copy: see `trial.try_unknowns`.
        simulator = dataclasses.replace(problem.simulator, newton=newton)
        drape = static_solve(simulator, parameters, start)
        iterations += int(drape.report.iterations)
        info = drape_info(problem, drape.report, drape.positions, iteration)
        seconds["forward"] += now() - begun
        if not info.accepted:
            return ended(info)
        begun = now()
        measured = measure(problem, reference, unknowns, drape.positions)
        info = dataclasses.replace(
            info,
            cost=measured.cost,
            outline=measured.outline,
            unfinished=measured.unfinished,
        )
        seconds["loss"] += now() - begun
        if not np.isfinite(measured.cost):
            return ended(dataclasses.replace(info, outcome=StepOutcome.NON_FINITE))
        if not measured.cost < cost:
            return ended(dataclasses.replace(info, outcome=StepOutcome.WORSE))
        begun = now()
        try:
            model = make_model(problem, reference, unknowns, drape.positions, measured, parameters)
        except LinearSolveError:
            seconds["adjoint"] += now() - begun
            info = dataclasses.replace(info, outcome=StepOutcome.ADJOINT_FAILED)
            start = drape.positions
            newton = dataclasses.replace(newton, tolerance=0.1 * newton.tolerance)
            continue
        seconds["adjoint"] += now() - begun
        begun = now()
        info = _with_loss(problem, info, unknowns, drape.positions, rest)
        seconds["loss"] += now() - begun
        return ended(info, positions=drape.positions, model=model)
    return ended(info)


def _with_loss(
    problem: FitProblem, info: FitInfo, unknowns: Unknowns, positions: Array, rest: Array
) -> FitInfo:
    """With the paper's loss, which no step looks at: it makes fits of both methods comparable."""
    weights = {name: jnp.asarray(w) for name, w in problem.options.active_weights.items()}
    garment = Garment(positions, rest, unknowns.pattern, unknowns.colors)
    assessment = jax.block_until_ready(
        assess_value(garment, weights, problem.tables, problem.observation)
    )
    return dataclasses.replace(
        info,
        loss=float(assessment.loss),
        terms={name: float(value) for name, value in sorted(assessment.terms.items())},
        iou=float(assessment.iou),
    )


__all__ = ["GaussNewtonState", "Measurement", "blank", "finished", "init", "step"]
