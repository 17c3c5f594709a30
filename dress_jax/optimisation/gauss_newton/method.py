"""Gauss-Newton with damping as `init` and `step` over an explicit state.

A pattern has a few hundred unknowns. The sensitivity of the drape to all of them costs one
factorization of the exact Hessian and a back-substitution for each; with it the distances between
drawn and target outlines are linearized, and a step solves for all unknowns at once. Folds that
snap from one shape to another are beyond any derivative: a step that meets one is rejected, and
tried again with more damping.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.core.pytree import pytree, replace
from dress_jax.optimisation.draping import Clock, does_not_drape, initial_unknowns, settle
from dress_jax.optimisation.flip_guard import guard_flips
from dress_jax.optimisation.gauss_newton.normal_equations import (
    damped_step,
    promised_decrease,
)
from dress_jax.optimisation.gauss_newton.quadratic_model import Model
from dress_jax.optimisation.gauss_newton.rule_constraints import rule_constraints
from dress_jax.optimisation.gauss_newton.trial import Iterate, guided, make_reference_once, try_step
from dress_jax.optimisation.gauss_newton.vector import as_vector, from_vector, step_limits
from dress_jax.optimisation.problem import FitProblem
from dress_jax.optimisation.remeshing import carried_unknowns, pin_change, transfer_weights
from dress_jax.optimisation.report import FitInfo
from dress_jax.optimisation.rules import follow_rules
from dress_jax.optimisation.state import Unknowns

_WELL_PREDICTED, _BADLY_PREDICTED = 0.6, 0.25
"""Actual over promised decrease from which the damping falls, and below which it rises."""


@pytree
class GaussNewtonState:
    """A fit between two steps.

    Attributes:
        best: the lowest cost so far, and what the fit returns.
        current: where the next step begins.
        damping: of the next step, ().
        excursion: accepted steps since the best; `GaussNewtonOptions.longest_excursion` bars the
            way above it until there is a new best, ().
        idle: steps in a row that hardly lowered the best cost, ().
        reference: the best cost before them, ().
        center: of the prior, (k,).
        recentered: how often it was moved, ().
        iteration: steps so far, accepted or not, ().
    """

    best: Iterate
    current: Iterate
    damping: Float[Array, ""]
    excursion: Int[Array, ""]
    idle: Int[Array, ""]
    reference: Float[Array, ""]
    center: Float[Array, " k"]
    recentered: Int[Array, ""]
    iteration: Int[Array, ""]

    @property
    def unknowns(self) -> Unknowns:
        """Of the best drape."""
        return self.best.unknowns

    @property
    def positions(self) -> Float[Array, "n 3"]:
        """The best drape [m]."""
        return self.best.positions


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
    settled = settle(problem, unknowns, positions)
    center = jnp.asarray(as_vector(unknowns))
    trial = try_step(problem, unknowns, settled, np.inf, center=center, iteration=0, clock=clock)
    begin = trial.reached
    if begin is None:
        raise does_not_drape(problem, trial.info)
    return GaussNewtonState(
        best=begin,
        current=begin,
        damping=jnp.asarray(problem.options.gauss_newton.damping),
        excursion=jnp.asarray(0),
        idle=jnp.asarray(0),
        reference=begin.cost,
        center=center,
        recentered=jnp.asarray(0),
        iteration=jnp.asarray(0),
    )


def step(
    problem: FitProblem, state: GaussNewtonState, *, clock: Clock | None = None
) -> tuple[GaussNewtonState, FitInfo]:
    """Propose, drape, and keep what lowers the cost, or leads on from a fold that snapped.

    A fold that snaps raises the cost at once, and the steps after it often lower it further than
    before. So a few steps in a row may stay above the best cost, within a factor; if none of them
    finds a new best, the fit goes back to the best with more damping, and any further step must
    lower the cost. Besides that, what is accepted is what Adam accepts, see `first_order.step`.

    Args:
        problem: made by `make_problem`.
        state: from `init` or an earlier step.
        clock: seconds since any fixed time; without one, `FitInfo.seconds` stays empty.
    """
    options = problem.options.gauss_newton
    damping, iteration, excursion = float(state.damping), int(state.iteration), int(state.excursion)
    now, best = state.current, float(state.best.cost)
    model = Model(np.asarray(now.gradient), np.asarray(now.matrix))
    limits = step_limits(now.unknowns, options)
    constraints = rule_constraints(problem, now.unknowns)
    change, promised = damped_step(model, damping, limits, constraints)
    guarded = guard_flips(problem, from_vector(as_vector(now.unknowns) + change, now.unknowns))
    unknowns = follow_rules(problem, guarded.unknowns)
    if guarded.acted or problem.rules:
        change = as_vector(unknowns) - as_vector(now.unknowns)
        promised = promised_decrease(model, change)
    free = excursion < options.longest_excursion
    ceiling = best * options.excursion_height if free else best
    trial = try_step(
        problem,
        unknowns,
        (now, change),
        ceiling,
        center=state.center,
        iteration=iteration,
        clock=clock,
    )
    info = dataclasses.replace(trial.info, damping=damping)
    state = replace(state, iteration=jnp.asarray(iteration + 1))
    reached = trial.reached
    if reached is None:
        raised = jnp.asarray(damping * options.raise_damping)
        barred = jnp.asarray(options.longest_excursion if excursion else 0)
        state = replace(state, current=state.best, damping=raised, excursion=barred)
        return _recentered(problem, _counted(problem, state)), info

    decrease = float(now.cost) - info.cost
    if decrease > _WELL_PREDICTED * promised:
        damping = max(damping * options.lower_damping, options.least_damping)
    elif decrease < _BADLY_PREDICTED * promised:
        damping = damping / options.lower_damping
    state = replace(state, current=reached, damping=jnp.asarray(damping))
    if info.cost < best:
        state = replace(state, best=reached, excursion=jnp.asarray(0))
    else:
        state = replace(state, excursion=jnp.asarray(excursion + 1))
    return _recentered(problem, _counted(problem, state)), info


def _counted(problem: FitProblem, state: GaussNewtonState) -> GaussNewtonState:
    """The state after a step, with its idle steps counted.

    Where folds snap, new bests turn up by chance every few steps, each hardly better than the last;
    what they add up to over several steps says whether the fit still gets anywhere.
    """
    lowered = 1.0 - problem.options.gauss_newton.idle_decrease
    if float(state.best.cost) < lowered * float(state.reference):
        return replace(state, idle=jnp.asarray(0), reference=state.best.cost)
    return replace(state, idle=state.idle + 1)


def _recentered(problem: FitProblem, state: GaussNewtonState) -> GaussNewtonState:
    """A state at rest with its prior moved to its best unknowns; any other as it is.

    This is Tikhonov regularization iterated: with each round the fit may go as far again from where
    it was as the prior allows.
    """
    options = problem.options.gauss_newton
    if not _rests(problem, state) or int(state.recentered) >= options.recenterings:
        return state
    best, at = state.best, as_vector(state.best.unknowns)
    prior = make_reference_once(problem).prior._replace(center=np.asarray(state.center))
    moved = replace(
        best,
        cost=best.cost - prior.value(at),
        gradient=best.gradient - jnp.asarray(prior.gradient(at)),
    )
    return replace(
        state,
        best=moved,
        current=moved,
        damping=jnp.asarray(options.damping),
        excursion=jnp.asarray(0),
        idle=jnp.asarray(0),
        reference=moved.cost,
        center=jnp.asarray(at),
        recentered=state.recentered + 1,
    )


def _rests(problem: FitProblem, state: GaussNewtonState) -> bool:
    options = problem.options.gauss_newton
    return int(state.idle) >= options.idle_steps or float(state.damping) > options.most_damping


def carry_over(
    old: FitProblem,
    state: GaussNewtonState,
    new: FitProblem,
    positions: Float[np.ndarray, "n 3"],
    *,
    clock: Clock | None = None,
) -> tuple[GaussNewtonState | None, FitInfo]:
    """The best state on another mesh: see `loop.carry_over`."""
    weights = transfer_weights(old, new, state.unknowns.pattern)
    unknowns = carried_unknowns(old, new, state.unknowns, weights)
    iteration = int(state.iteration)
    # The pins' shift comes last in the vector, and its centre moves with it.
    center = state.center.at[-3:].add(pin_change(old, new))
    # The new garment's folds are its own; the pictures say which the old one's were.
    settled = guided(new, unknowns, settle(new, unknowns, positions)).positions
    trial = try_step(
        new, unknowns, settled, np.inf, center=center, iteration=iteration, clock=clock
    )
    reached = trial.reached
    if reached is None:
        return None, trial.info
    moved = replace(
        state,
        best=reached,
        current=reached,
        center=center,
        damping=jnp.asarray(new.options.gauss_newton.damping),
        excursion=jnp.asarray(0),
        idle=jnp.asarray(0),
        reference=reached.cost,
    )
    return moved, trial.info


def cost(state: GaussNewtonState) -> float:
    """Of the best drape."""
    return float(state.best.cost)


def finished(problem: FitProblem, state: GaussNewtonState) -> bool:
    """Whether all iterations are done, or the cost does not fall any more."""
    return int(state.iteration) >= problem.options.iterations or _rests(problem, state)


def blank(problem: FitProblem) -> GaussNewtonState:
    """A state of the right structure; only its shapes mean something."""
    unknowns = initial_unknowns(problem)
    count = len(as_vector(unknowns))
    nothing = Iterate(
        unknowns=unknowns,
        positions=jnp.zeros((problem.discretization.vertex_count, 3)),
        cost=jnp.asarray(0.0),
        gradient=jnp.zeros(count),
        matrix=jnp.zeros((count, count)),
    )
    return GaussNewtonState(
        best=nothing,
        current=nothing,
        damping=jnp.asarray(0.0),
        excursion=jnp.asarray(0),
        idle=jnp.asarray(0),
        reference=jnp.asarray(0.0),
        center=jnp.zeros(count),
        recentered=jnp.asarray(0),
        iteration=jnp.asarray(0),
    )
