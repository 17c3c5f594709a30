"""The drape's derivatives against central differences of the converged solve, with contact."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core.pytree import replace
from dress_jax.energy.fabric import make_parameters
from dress_jax.sim import State, static_solve, step
from dress_jax.sim.adjoint import AdjointWarning, solve_exact
from tests.central_differences import central_difference
from tests.sim.scenes import SOFT, draped_sheet

# Fourth-order differences of a solve converged to 1e-12 m: the noise of the solve over the step.
ADJOINT_TOLERANCE = 1e-5

# A step in which inertia outweighs the sheet's buckling, so that its end is unique.
SHORT_STEP = 0.005

# Differentiated leaf and the step of its finite difference, large against the noise of the solve
# and small against the scale on which the drape bends. The folds of this drape are soft: it moves
# by up to 70 m per metre of the pattern.
LEAVES = {
    "rest_positions": 3e-7,
    "density": 6e-6,
    "stretching_stiffness": 3e-3,
    "bending_stiffness": 3e-9,
    "gravity": 3e-5,
    "pin_targets": 3e-7,
    "pin_stiffness": 0.3,
    "body_vertices": 3e-7,
    "barrier_stiffness": 0.3,
}


@pytest.fixture(scope="module")
def drape():
    cloth, simulator, rest, start, body = draped_sheet()
    parameters = make_parameters(
        cloth,
        SOFT,
        rest,
        body_vertices=body,
        pin_targets=start[np.asarray(cloth.pins)],
    )
    result = static_solve(simulator, parameters, start)
    assert result.report.converged
    assert result.report.intersection_free
    # The barrier is at work: without contact these tests would prove little.
    settings = simulator.settings
    assert float(result.report.smallest_distance) < float(settings.dhat + settings.thickness)
    weights = jnp.asarray(np.sin(np.arange(result.positions.size)).reshape(-1, 3))
    return simulator, parameters, result, weights


@pytest.fixture(scope="module")
def gradient(drape):
    simulator, parameters, result, weights = drape

    def loss(p):
        return jnp.sum(weights * static_solve(simulator, p, result.positions).positions)

    return loss, jax.grad(loss)(parameters)


@pytest.mark.parametrize("name", LEAVES)
def test_adjoint_equals_finite_differences(drape, gradient, name):
    """S2.4, S2.5, S2.7, S2.9 for every continuous parameter."""
    _, parameters, _, _ = drape
    loss, derivative = gradient
    leaf = getattr(parameters, name)
    direction = jnp.asarray(np.cos(1.0 + np.arange(leaf.size)).reshape(leaf.shape))
    exact = float(jnp.sum(getattr(derivative, name) * direction))

    def moved(t):
        return loss(replace(parameters, **{name: leaf + t * direction}))

    measured = central_difference(moved, LEAVES[name])
    assert abs(exact) > 0.0
    assert abs(exact - measured) <= ADJOINT_TOLERANCE * abs(measured)


def test_start_carries_no_derivative(drape):
    """S9.4: zero by definition."""
    simulator, parameters, result, weights = drape
    derivative = jax.grad(
        lambda x: jnp.sum(weights * static_solve(simulator, parameters, x).positions)
    )(result.positions)
    assert not np.any(np.asarray(derivative))


def test_projected_hessian_gives_a_wrong_adjoint(drape, gradient):
    """S2.8: with the projected Hessian in place of the exact one the derivative is off."""
    from dress_jax.sim.objective import resting_objective

    simulator, parameters, result, weights = drape
    objective = resting_objective(simulator, parameters, result.positions)
    x = np.asarray(result.positions)
    factorization = objective.factorize(x)
    exact = solve_exact(objective, x, np.asarray(weights), factorization)
    projected = factorization.solve(np.asarray(weights).ravel()).reshape(x.shape)
    difference = np.linalg.norm(exact - projected) / np.linalg.norm(exact)
    assert difference > 100 * ADJOINT_TOLERANCE


def test_failed_adjoint_is_not_a_number(drape, monkeypatch):
    simulator, parameters, result, weights = drape
    monkeypatch.setattr("dress_jax.sim.adjoint._ITERATION_LIMIT", 0)
    with pytest.warns(AdjointWarning, match="gradient is NaN"):
        derivative = jax.grad(
            lambda p: jnp.sum(weights * static_solve(simulator, p, result.positions).positions)
        )(parameters)
    assert np.all(np.isnan(np.asarray(derivative.rest_positions)))


def swinging_sheet(**options):
    """A sheet on its way: curved and in contact, away from the flat state's buckling."""
    cloth, simulator, rest, start, body = draped_sheet(**options)
    parameters = make_parameters(
        cloth, SOFT, rest, body_vertices=body, pin_targets=start[np.asarray(cloth.pins)]
    )
    state = State(jnp.asarray(start), jnp.zeros_like(jnp.asarray(start)))
    for _ in range(4):
        state, report = step(simulator, state, parameters, time_step=0.05)
    settings = simulator.settings
    assert float(report.smallest_distance) < float(settings.dhat + settings.thickness)
    weights = jnp.asarray(np.sin(np.arange(start.size)).reshape(-1, 3))
    return simulator, parameters, state, weights


@pytest.mark.parametrize("which", ["positions", "velocities"])
@pytest.mark.parametrize("output", ["positions", "velocities"])
def test_steps_carry_derivatives_through_time(which, output):
    """S2.6, S2.7, S2.12: a loss on the end of two steps, in the initial state."""
    simulator, parameters, initial, weights = swinging_sheet()
    direction = jnp.asarray(np.cos(np.arange(weights.size)).reshape(-1, 3))

    def loss(t):
        state = replace(initial, **{which: getattr(initial, which) + t * direction})
        for _ in range(2):
            state, _ = step(simulator, state, parameters, time_step=SHORT_STEP)
        return jnp.sum(weights * getattr(state, output))

    exact = float(jax.grad(loss)(0.0))
    measured = central_difference(loss, 2e-7 if which == "positions" else 4e-6)
    assert abs(exact) > 0.0
    assert abs(exact - measured) <= ADJOINT_TOLERANCE * abs(measured)


@pytest.mark.slow
def test_parameters_through_a_chain_of_steps():
    """S2.12 with friction: friction coefficient and density of a dynamic chain."""
    simulator, parameters, initial, weights = swinging_sheet(friction=True)

    def loss(values):
        p = replace(parameters, friction_coefficient=values[0], density=values[1])
        state = initial
        for _ in range(2):
            state, _ = step(simulator, state, p, time_step=0.05)
        return jnp.sum(weights * state.positions)

    at = jnp.asarray([0.3, 0.2])
    exact = np.asarray(jax.grad(loss)(at))
    for index, size in enumerate((1e-4, 1e-5)):
        unit = jnp.zeros(2).at[index].set(1.0)
        measured = central_difference(lambda t, unit=unit: loss(at + t * unit), size)
        assert abs(exact[index]) > 0.0
        assert abs(exact[index] - measured) <= ADJOINT_TOLERANCE * abs(measured)
