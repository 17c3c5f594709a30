"""Drapes of a fit: from unknowns to positions, and whether what came out can be used."""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.core.results import Result
from dress_jax.energy.cloth import Parameters
from dress_jax.optimisation.fabric_freedom import initial_values, with_fabric
from dress_jax.optimisation.problem import FitProblem, rest_shape, validated_pattern
from dress_jax.optimisation.report import FitInfo, StepOutcome
from dress_jax.optimisation.rules import check_rules, follow_rules
from dress_jax.optimisation.state import Unknowns
from dress_jax.pattern import pattern_parameters, rest_positions
from dress_jax.pattern.parameters import PatternParameters
from dress_jax.sim import Simulator, static_solve
from dress_jax.sim.equilibrium import Report

Clock = Callable[[], float]
"""Seconds since any fixed time."""


def initial_unknowns(problem: FitProblem) -> Unknowns:
    """Where a fit begins: at the initial pattern, or the nearest one that keeps its rules.

    Raises:
        InputError: the rules contradict each other.
    """
    unknowns = Unknowns(
        pattern=pattern_parameters(problem.pattern),
        log_stiffness=jnp.asarray(
            initial_values(problem.tables.fabric, problem.options.initial_stiffness)
        ),
        pin_shift=jnp.zeros(3),
        colors=jnp.asarray(problem.colors),
    )
    unknowns = follow_rules(problem, unknowns)
    check_rules(problem, unknowns.pattern)
    return unknowns


def settle(problem: FitProblem, unknowns: Unknowns, positions: Float[np.ndarray, "n 3"]) -> Array:
    """The garment of some unknowns, draped for the first second [m].

    The step of 1 s damps a long way to the equilibrium; the next drape starts close to it.
    """
    simulator = dataclasses.replace(problem.simulator)
    rest = rest_shape(problem, unknowns.pattern)
    parameters = fitted_parameters(problem, rest, unknowns.log_stiffness, unknowns.pin_shift)
    return static_solve(simulator, parameters, jnp.asarray(positions, float)).positions


def does_not_drape(problem: FitProblem, info: FitInfo) -> InputError:
    """The error for an initial pattern without a usable drape."""
    result = info.solve_result
    return InputError(
        f"the initial pattern does not drape: {info.outcome.value}"
        + ("" if result is None else f" (solver: {result.message})"),
        where=problem.pattern.source,
        mend="drape it on its own first, with more Newton iterations or a finer mesh",
    )


def simulate(
    problem: FitProblem,
    simulator: Simulator,
    pattern: PatternParameters,
    log_stiffness: Float[Array, " s"],
    pin_shift: Float[Array, "3"],
    start: Float[Array, "n 3"],
) -> tuple[tuple[Array, Array, PatternParameters], Report]:
    """Drape, rest shape and validated pattern, differentiable in pattern and stiffness (S9.7).

    One implicit step of 1 s from rest (S9.3, S9.8); the start carries no gradient (S9.4).

    Returns:
        (draped positions [m], rest positions [m], pattern), and how the solve went.
    """
    pattern = validated_pattern(problem, pattern)
    rest = rest_positions(pattern, problem.discretization)
    parameters = fitted_parameters(problem, rest, log_stiffness, pin_shift)
    drape = static_solve(simulator, parameters, start)
    return (drape.positions, rest, pattern), drape.report


def fitted_parameters(
    problem: FitProblem,
    rest: Float[Array, "p 2"],
    log_stiffness: Float[Array, " s"],
    pin_shift: Float[Array, "3"],
) -> Parameters:
    """The problem's parameters with a rest shape, other stiffnesses, moved pins."""
    base = with_fabric(problem.parameters, log_stiffness, problem.tables.fabric)
    return replace(base, rest_positions=rest, pin_targets=base.pin_targets + pin_shift[None, :])


def relative_areas(problem: FitProblem, rest: Float[np.ndarray, "p 2"]) -> Float[np.ndarray, " f"]:
    """Signed area of every rest triangle over the one it was meshed with."""
    corners = np.asarray(problem.discretization.rest_faces)

    def doubled(points: np.ndarray) -> np.ndarray:
        a, b, c = (points[corners[:, k]] for k in range(3))
        u, v = b - a, c - a
        return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]

    meshed = np.asarray(problem.discretization.meshed_positions)
    return doubled(np.asarray(rest)) / doubled(meshed)


def smallest_relative_area(problem: FitProblem, rest: Float[np.ndarray, "p 2"]) -> float:
    """Least of `relative_areas`; negative where a triangle has flipped."""
    return float(np.min(relative_areas(problem, rest)))


def drape_info(problem: FitProblem, report: Report, positions: Array, iteration: int) -> FitInfo:
    """What a drape's report says, and whether it can be used."""
    return FitInfo(
        iteration,
        _judge(report, positions, problem.options.largest_remaining_step),
        newton_iterations=int(report.iterations),
        solve_result=Result(int(report.result)),
        remaining_step=float(report.step_size),
        intersections=int(report.self_intersections) + int(report.body_intersections),
    )


def _judge(report: Report, positions: Array, largest_remaining_step: float) -> StepOutcome:
    if not bool(jnp.all(jnp.isfinite(positions))):
        return StepOutcome.NON_FINITE
    if not report.intersection_free:
        return StepOutcome.INTERSECTS
    close = float(report.step_size) <= largest_remaining_step
    return StepOutcome.ACCEPTED if report.converged or close else StepOutcome.SOLVE_FAILED
