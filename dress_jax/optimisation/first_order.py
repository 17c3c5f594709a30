"""The paper's optimisation: Adam on the gradient through the drape (S9).

A step proposes new unknowns, drapes the garment with them and keeps them only if the drape is
sound; otherwise the state stays as it was and the learning rates shrink. So the state always holds
an intersection-free drape and the gradient there, and a step can be repeated bit by bit.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from dress_jax.core.pytree import replace
from dress_jax.optimisation.draping import Clock, does_not_drape, initial_unknowns, settle
from dress_jax.optimisation.flip_guard import guard_flips
from dress_jax.optimisation.optimizer import corner_links, init_optimizer, propose, rates
from dress_jax.optimisation.problem import FitProblem, corner_panels
from dress_jax.optimisation.remeshing import at_new_vertices, carried_unknowns, transfer_weights
from dress_jax.optimisation.report import FitInfo
from dress_jax.optimisation.rules import follow_rules
from dress_jax.optimisation.state import FitState
from dress_jax.optimisation.trial import try_unknowns
from dress_jax.pattern import pattern_parameters


def init(
    problem: FitProblem, positions: Float[np.ndarray, "n 3"], *, clock: Clock | None = None
) -> FitState:
    """Drape the initial pattern and find the gradient there.

    Args:
        problem: made by `make_problem`.
        positions: an intersection-free state to start from (`DressedGarment.positions`) [m].
        clock: for the timings of later reports; not needed.

    Raises:
        InputError: the initial pattern does not drape.
    """
    unknowns = initial_unknowns(problem)
    settled = settle(problem, unknowns, positions)
    trial = try_unknowns(problem, unknowns, settled, iteration=0, clock=clock)
    if trial.gradient is None or trial.positions is None:
        raise does_not_drape(problem, trial.info)
    return FitState(
        unknowns=unknowns,
        gradient=trial.gradient,
        positions=trial.positions,
        loss=jnp.asarray(trial.info.loss),
        optimizer=init_optimizer(unknowns, problem.options),
        iteration=jnp.asarray(0),
        rate_scale=jnp.asarray(1.0),
    )


def step(
    problem: FitProblem, state: FitState, *, clock: Clock | None = None
) -> tuple[FitState, FitInfo]:
    """Propose, drape, and keep what is sound (S9.2-S9.12).

    Accepted are drapes without intersections whose solve converged, or stopped with a last Newton
    step of at most `options.largest_remaining_step`; with finite loss and gradient; of a pattern
    whose rest triangles keep their orientation and `options.smallest_area` of their area (S12.4).
    The loss itself may rise, as it does along the way of any method with momentum.

    Args:
        problem: made by `make_problem`.
        state: from `init` or an earlier step.
        clock: seconds since any fixed time; without one, `FitInfo.seconds` stays empty.
    """
    options = problem.options
    iteration, scale = int(state.iteration), float(state.rate_scale)
    unknowns, optimizer = propose(
        state.unknowns,
        state.gradient,
        state.optimizer,
        options,
        rates(options, iteration, scale),
        corner_panels(problem.pattern),
        corner_links(
            np.asarray(pattern_parameters(problem.pattern).vertices),
            np.asarray(problem.discretization.edges.vertices),
        ),
    )
    unknowns = follow_rules(problem, guard_flips(problem, unknowns).unknowns)
    trial = try_unknowns(problem, unknowns, state.positions, iteration=iteration, clock=clock)
    info = dataclasses.replace(trial.info, rate_scale=scale)
    following = jnp.asarray(iteration + 1)
    if trial.gradient is None or trial.positions is None:
        shrunk = jnp.asarray(scale * options.shrink)
        return replace(state, iteration=following, rate_scale=shrunk), info
    return (
        FitState(
            unknowns=unknowns,
            gradient=trial.gradient,
            positions=trial.positions,
            loss=jnp.asarray(info.loss),
            optimizer=optimizer,
            iteration=following,
            rate_scale=jnp.asarray(min(1.0, scale * options.grow)),
        ),
        info,
    )


def carry_over(
    old: FitProblem,
    state: FitState,
    new: FitProblem,
    positions: Float[np.ndarray, "n 3"],
    *,
    clock: Clock | None = None,
) -> tuple[FitState | None, FitInfo]:
    """The state on another mesh: see `loop.carry_over`."""
    weights = transfer_weights(old, new, state.unknowns.pattern)
    unknowns = carried_unknowns(old, new, state.unknowns, weights)
    iteration = int(state.iteration)
    settled = settle(new, unknowns, positions)
    trial = try_unknowns(new, unknowns, settled, iteration=iteration, clock=clock)
    if trial.gradient is None or trial.positions is None:
        return None, trial.info
    moved = FitState(
        unknowns=unknowns,
        gradient=trial.gradient,
        positions=trial.positions,
        loss=jnp.asarray(trial.info.loss),
        optimizer={
            **state.optimizer,
            "colors": at_new_vertices(state.optimizer["colors"], weights),
        },
        iteration=state.iteration,
        rate_scale=jnp.asarray(1.0),
    )
    return moved, trial.info


def cost(state: FitState) -> float:
    """The loss of the drape."""
    return float(state.loss)


def finished(problem: FitProblem, state: FitState) -> bool:
    """Whether all iterations are done, or rejections have brought the fit to a halt."""
    options = problem.options
    halted = float(state.rate_scale) < options.smallest_scale
    return int(state.iteration) >= options.iterations or halted


def blank(problem: FitProblem) -> FitState:
    """A state of the right structure; only its shapes mean something."""
    unknowns = initial_unknowns(problem)
    return FitState(
        unknowns=unknowns,
        gradient=unknowns,
        positions=jnp.zeros((problem.discretization.vertex_count, 3)),
        loss=jnp.asarray(0.0),
        optimizer=init_optimizer(unknowns, problem.options),
        iteration=jnp.asarray(0),
        rate_scale=jnp.asarray(1.0),
    )
