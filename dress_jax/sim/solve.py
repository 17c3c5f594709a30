"""The public solves: a static drape and one dynamic step."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from dress_jax.core.precision import as_float64, require_float64
from dress_jax.core.pytree import pytree
from dress_jax.energy.cloth import Parameters
from dress_jax.energy.elastic import TimeStep
from dress_jax.sim.equilibrium import Report
from dress_jax.sim.implicit import advance
from dress_jax.sim.inputs import StepInputs
from dress_jax.sim.simulator import Simulator


@pytree
class State:
    """Positions [m] and velocities [m/s] of the cloth, each (n, 3)."""

    positions: Float[Array, "n 3"]
    velocities: Float[Array, "n 3"]


@pytree
class Drape:
    """Result of a static solve.

    Attributes:
        positions: [m], (n, 3).
        report: how the solve went.
    """

    positions: Float[Array, "n 3"]
    report: Report


def static_solve(
    simulator: Simulator,
    parameters: Parameters,
    initial_positions: Float[Array, "n 3"],
    *,
    time_step: float | None = 1.0,
) -> Drape:
    """Drape the cloth: one implicit step of 1 s from rest, or an equilibrium (S9.2, S9.3).

    Differentiable in every leaf of `parameters`: `jax.grad`, `jax.jvp` and products with second
    derivatives by `jax.jvp` of `jax.grad`; `jax.vmap` solves several at once (`sim.lanes`). The
    derivative in `initial_positions` is zero by definition: locally, the equilibrium does not
    depend on where the search for it began (S9.4).

    Args:
        simulator: host object made by `make_simulator`.
        parameters: all continuous parameters.
        initial_positions: an intersection-free state [m].
        time_step: h [s] of the single step; None leaves inertia out (true static), which needs
            pins or contact to be well posed.

    Returns:
        Positions and report; a failed solve is reported, not raised.
    """
    require_float64("static_solve")
    start = jax.lax.stop_gradient(as_float64(initial_positions))
    parameters = as_float64(parameters)
    inverse = jnp.asarray(0.0 if time_step is None else 1.0 / time_step, jnp.float64)
    inputs = StepInputs(
        step=TimeStep(start, jnp.zeros_like(start), inverse),
        parameters=parameters,
        body_start=jax.lax.stop_gradient(parameters.body_vertices),
    )
    return Drape(*advance(simulator, inputs))


def step(
    simulator: Simulator,
    state: State,
    parameters: Parameters,
    *,
    time_step: float,
    body_start: Float[Array, "b 3"] | None = None,
) -> tuple[State, Report]:
    """One backward Euler step (S1.2, S1.12, S2.3-S2.7).

    Differentiable in the state and in every leaf of `parameters`, like `static_solve`.

    Args:
        simulator: host object made by `make_simulator`.
        state: x^n and v^n, intersection-free with the body at `parameters.body_vertices`.
        parameters: all continuous parameters; `body_vertices` is the body at the end of the step.
        time_step: h [s].
        body_start: the body at the start of the step [m], for friction; default: it rests.

    Returns:
        x^(n+1), v^(n+1) = (x^(n+1) - x^n) / h, and the report.
    """
    require_float64("step")
    inverse = jnp.asarray(1.0 / time_step, jnp.float64)
    start, velocity = as_float64(state.positions), as_float64(state.velocities)
    parameters = as_float64(parameters)
    before = parameters.body_vertices if body_start is None else as_float64(body_start)
    inputs = StepInputs(TimeStep(start, velocity, inverse), parameters, before)
    positions, report = advance(simulator, inputs)
    return State(positions, (positions - start) * inverse), report
