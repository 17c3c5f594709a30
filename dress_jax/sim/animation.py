"""Cloth on a body that moves: implicit steps, moving boundary and friction (S15.1, S15.4).

In a step the body goes from one shape to the next. The cloth starts the step where it would be if
it went along: x_c = x^n + u, on the body exactly as the body beneath it. Inertia is that of the
true start, because with v_c = v^n - u / h

    |(x - x^n) / h - v^n|^2 = |(x - x_c) / h - v_c|^2,

and slip, which friction resists, is the motion against the body, x - x_c. The common motion of
cloth and body is tested by continuous collision detection before the step, so that it starts
without intersections, and no iterate of the step has any. Where the motion is not free, or Newton's
method does not converge, the step is halved; steps grow again afterwards.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Parameters
from dress_jax.energy.strain_limit import strain_step_bound
from dress_jax.energy.stretching import stretching_rest
from dress_jax.geometry.intersection import IntersectionCounts
from dress_jax.sim.dressing.motion import MotionOptions, follow_body, motion_bound
from dress_jax.sim.riding import Carrier, Riders
from dress_jax.sim.simulator import Simulator
from dress_jax.sim.solve import State, step
from dress_jax.sim.sparsity import elastic_slots
from dress_jax.solver import NewtonOptions
from dress_jax.solver.linear import make_solver

NEWTON = NewtonOptions(tolerance=5e-4, iteration_limit=40)
"""Of a step in motion: an error of half a millimetre does not show, and does not add up."""


@dataclasses.dataclass(frozen=True)
class AnimationOptions:
    """How a frame is divided.

    Attributes:
        steps: of a frame where nothing stands in the way.
        halvings: how often a step may be halved.
    """

    steps: int = 1
    halvings: int = 5

    def __post_init__(self) -> None:
        if self.steps < 1 or self.halvings < 0:
            raise InputError(
                f"{self.steps} steps a frame, {self.halvings} halvings",
                where="animation",
                mend="give at least one step, and none or more halvings",
            )


@dataclasses.dataclass(frozen=True)
class FrameRecord:
    """How a frame went.

    Attributes:
        steps: that were made.
        blocked: steps that were halved because the way of the body was not free.
        halved: steps that were halved because Newton's method did not converge.
        unconverged: steps of the shortest length that ended before they met the stopping rule.
        squeezed: steps of the shortest length that the cloth could make only at rest, giving way to
            the body little by little.
        newton_iterations: of all steps that count.
        tried_iterations: of all steps, also those that were thrown away.
        self_intersections, body_intersections: by the exact test, at the end of the frame.
        smallest_distance: of all pairs within reach, at the end [m].
    """

    steps: int = 0
    blocked: int = 0
    halved: int = 0
    unconverged: int = 0
    squeezed: int = 0
    newton_iterations: int = 0
    tried_iterations: int = 0
    self_intersections: int = 0
    body_intersections: int = 0
    smallest_distance: float = np.inf

    @property
    def intersection_free(self) -> bool:
        """Whether the exact test found nothing."""
        return not (self.self_intersections or self.body_intersections)


def renewed(simulator: Simulator) -> Simulator:
    """The simulator without what it has learned from earlier solves.

    The sparsity of past contacts orders the sums of a factorization. A run that begins every frame
    with a renewed simulator depends on the state alone, and can be resumed exactly.
    """
    pattern, slots = elastic_slots(simulator.vertex_count, simulator.padding.cloth)
    solver = make_solver(simulator.linear_solver.name)
    return dataclasses.replace(simulator, pattern=pattern, slots=slots, linear_solver=solver)


def advance_frame(
    simulator: Simulator,
    parameters: Parameters,
    state: State,
    before: Float[np.ndarray, "b 3"],
    after: Float[np.ndarray, "b 3"],
    *,
    seconds: float,
    carrier: Carrier,
    riders: Riders,
    options: AnimationOptions | None = None,
) -> tuple[State, FrameRecord]:
    """The cloth one frame later; between the two shapes the body moves along straight lines.

    Args:
        simulator: with friction as it is to act.
        parameters: their body and pin targets are replaced.
        state: free of intersections with the body `before`.
        before, after: the body [m].
        seconds: of the frame.
        carrier: of this cloth and body.
        riders: the pins on the body.
        options: see `AnimationOptions`.

    Returns:
        The state with the body `after`, free of intersections, and what happened on the way.

    Raises:
        InputError: the body cannot move on; the message names the panels.
    """
    options = AnimationOptions() if options is None else options
    ticks = options.steps << options.halvings
    longest = 1 << options.halvings
    done, length = 0, longest
    record = FrameRecord()

    def body_at(tick: int) -> np.ndarray:
        return after if tick == ticks else before + (tick / ticks) * (after - before)

    while done < ticks:
        start, end = body_at(done), body_at(done + length)
        moved = replace(
            parameters,
            body_vertices=jnp.asarray(end),
            pin_targets=jnp.asarray(riders.places(end)),
        )
        h = seconds * length / ticks
        carried = carrier.motion(np.asarray(state.positions), start, end)
        attempt = None
        if _free(simulator, moved, np.asarray(state.positions), carried, start, end - start):
            attempt = _step(simulator, moved, state, carried, h)
            iterations = int(attempt[1].iterations)
            record = _more(record, tried_iterations=iterations)
            converged = attempt[1].converged
            if not converged and length > 1:
                record, length = _more(record, halved=1), length // 2
                continue
            record = _more(
                record, newton_iterations=iterations, unconverged=int(not converged), steps=1
            )
        elif length > 1:
            record, length = _more(record, blocked=1), length // 2
            continue
        if attempt is None:
            state, distance, crossings = _squeezed(simulator, moved, state, start, end, h)
            record = _more(record, squeezed=1, steps=1)
        else:
            state, report = attempt
            distance = float(report.smallest_distance)
            crossings = IntersectionCounts(
                int(report.self_intersections), int(report.body_intersections)
            )
        record = dataclasses.replace(
            record,
            smallest_distance=distance,
            self_intersections=crossings.self,
            body_intersections=crossings.body,
        )
        if not record.intersection_free:
            raise RuntimeError(
                "the cloth passed through itself or the body in a step "
                f"({crossings.self} and {crossings.body} crossings)"
            )
        done += length
        # A longer step again, where it begins at a multiple of its own length.
        if length < longest and done % (2 * length) == 0:
            length *= 2
    return state, record


def _more(record: FrameRecord, **counts: int) -> FrameRecord:
    return dataclasses.replace(
        record, **{name: getattr(record, name) + count for name, count in counts.items()}
    )


def _free(
    simulator: Simulator,
    parameters: Parameters,
    positions: np.ndarray,
    carried: np.ndarray,
    body: np.ndarray,
    body_motion: np.ndarray,
) -> bool:
    """Whether cloth and body can make a motion together without touching or tearing anything."""
    if motion_bound(simulator, positions, carried, body, body_motion) < 1.0:
        return False
    if parameters.strain_limit is None:
        return True
    cloth = simulator.cloth
    bound = strain_step_bound(
        jnp.asarray(positions),
        jnp.asarray(carried),
        cloth.faces,
        stretching_rest(parameters, cloth),
        parameters.strain_limit,
    )
    return float(bound) >= 1.0


def _step(simulator: Simulator, moved: Parameters, state: State, carried: np.ndarray, h: float):
    """One implicit step from where the cloth went along; velocities are those of the true start."""
    shift = jnp.asarray(carried / h)
    along = State(state.positions + jnp.asarray(carried), state.velocities - shift)
    end, report = step(simulator, along, moved, time_step=h)
    return State(end.positions, end.velocities + shift), report


def _squeezed(
    simulator: Simulator,
    moved: Parameters,
    state: State,
    start: np.ndarray,
    end: np.ndarray,
    h: float,
) -> tuple[State, float, IntersectionCounts]:
    """The cloth gives way to the body from rest, as when it is put on."""
    before = replace(moved, body_vertices=jnp.asarray(start))
    options = MotionOptions(relaxation_step=h)
    positions = follow_body(
        simulator, before, np.asarray(state.positions), end[None], options=options
    )
    crossings = simulator.clean_state.count(
        positions,
        np.asarray(simulator.cloth.faces).T,
        end,
        simulator.body_faces,
        weld_map=simulator.weld_map,
    )
    velocity = (jnp.asarray(positions) - state.positions) / h
    return State(jnp.asarray(positions), velocity), float("nan"), crossings
