"""Forward-mode derivatives of a drape, and the assembled exact Hessian behind them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core.pytree import replace
from dress_jax.energy.elastic import TimeStep
from dress_jax.energy.fabric import make_parameters
from dress_jax.sim import static_solve
from dress_jax.sim.inputs import StepInputs
from dress_jax.sim.objective import StepObjective
from dress_jax.sim.sensitivity import predicted_start, static_sensitivity
from dress_jax.solver.linear import LinearSolveError, make_solver
from tests.sim.scenes import SOFT, draped_sheet


class _Recorder:
    """A linear solver that keeps the last matrix it was given."""

    name = "recorder"

    def __init__(self, solver):
        self._solver, self.upper = solver, None

    def factorize(self, upper, positions=None):
        self.upper = upper.copy()
        return self._solver.factorize(upper, positions)


@pytest.fixture(scope="module")
def drape():
    cloth, simulator, rest, start, body = draped_sheet()
    parameters = make_parameters(
        cloth, SOFT, rest, body_vertices=body, pin_targets=start[np.asarray(cloth.pins)]
    )
    # Until a step of 1 s ends where it began: the sensitivity is that of such a step.
    for _ in range(20):
        result = static_solve(simulator, parameters, start)
        moved, start = np.abs(result.positions - start).max(), result.positions
        if moved < 1e-10:
            break
    assert result.report.converged and moved < 1e-10
    settings = simulator.settings
    assert float(result.report.smallest_distance) < float(settings.dhat + settings.thickness)
    return simulator, parameters, result.positions


def _objective(simulator, parameters, positions, *, velocity=0.0, body_shift=0.0):
    step = TimeStep(positions, jnp.full_like(positions, velocity), jnp.asarray(2.0))
    body_start = parameters.body_vertices + body_shift
    return StepObjective(simulator, StepInputs(step, parameters, body_start))


@pytest.mark.parametrize("friction", [pytest.param(False, marks=pytest.mark.slow), True])
def test_assembled_exact_hessian_equals_its_product(drape, friction):
    simulator, parameters, positions = drape
    recorder = _Recorder(make_solver())
    simulator = dataclasses.replace(simulator, linear_solver=recorder, friction=friction)
    objective = _objective(simulator, parameters, positions)
    x = np.asarray(positions)
    if friction:  # slid against where the step began, so that the sliding part is not zero
        x = x + 1e-5 * np.sin(np.arange(x.size)).reshape(x.shape)
    try:
        objective.factorize(x, exact=True)
    except LinearSolveError:
        assert friction  # the displaced state need not be stable; its matrix was assembled
    upper = recorder.upper
    full = upper + upper.T
    full.setdiag(upper.diagonal())
    direction = np.cos(np.arange(x.size)).reshape(x.shape)
    product = objective.derivative_product(x, direction)
    error = np.abs(full @ direction.ravel() - product.ravel()).max()
    assert error <= 1e-12 * np.abs(product).max()
    again = objective.hessian_product(x, direction)
    assert np.abs(again - product).max() <= 1e-12 * np.abs(product).max()
    objective.factorize(x)
    assert np.abs((recorder.upper - upper).data).max() > 1e-4 * np.abs(upper.data).max()


DIRECTIONS = {"rest_positions": 3e-7, "bending_stiffness": 3e-9, "pin_targets": 3e-7}


@pytest.fixture(scope="module")
def sensitivity(drape):
    """One direction per leaf, all in one call."""
    simulator, parameters, positions = drape
    leaves = {name: getattr(parameters, name) for name in DIRECTIONS}
    along = {
        name: jnp.asarray(np.cos(1.0 + np.arange(leaf.size)).reshape(leaf.shape))
        for name, leaf in leaves.items()
    }
    stacked = {
        name: jnp.stack([along[name] if k == name else jnp.zeros_like(leaves[name]) for k in along])
        for name in along
    }
    columns = static_sensitivity(simulator, parameters, np.asarray(positions), stacked)
    return along, dict(zip(along, np.moveaxis(columns, -1, 0), strict=True))


@pytest.mark.parametrize("name", DIRECTIONS)
def test_against_differences_of_the_solve(drape, sensitivity, name):
    simulator, parameters, positions = drape
    along, exact = sensitivity
    leaf, size = getattr(parameters, name), DIRECTIONS[name]

    def moved(t):
        changed = replace(parameters, **{name: leaf + t * along[name]})
        return np.asarray(static_solve(simulator, changed, positions).positions)

    one, two = moved(size) - moved(-size), moved(2 * size) - moved(-2 * size)
    measured = (8 * one - two) / (12 * size)
    assert np.abs(measured).max() > 0.0
    assert np.abs(exact[name] - measured).max() <= 1e-5 * np.abs(measured).max()


@pytest.mark.parametrize("name", DIRECTIONS)
def test_agrees_with_the_adjoint(drape, sensitivity, name):
    simulator, parameters, positions = drape
    along, exact = sensitivity
    weights = np.sin(np.arange(positions.size)).reshape(-1, 3)

    def loss(leaf):
        changed = replace(parameters, **{name: leaf})
        return jnp.sum(weights * static_solve(simulator, changed, positions).positions)

    pulled = float(jnp.sum(jax.grad(loss)(getattr(parameters, name)) * along[name]))
    pushed = float(np.sum(weights * exact[name]))
    assert pushed == pytest.approx(pulled, rel=1e-6)
    assert pushed != 0.0


def test_an_unstable_state_has_no_sensitivity(drape):
    """A flat sheet under compression in its plane."""
    simulator, parameters, _ = drape
    flat = np.asarray(parameters.rest_positions) @ np.array([[0.8, 0.0, 0.0], [0.0, 0.0, 0.8]])
    flat = flat + np.array([0.0, 1.0, 0.0])
    directions = {"bending_stiffness": jnp.ones(1)}
    with pytest.raises(LinearSolveError):
        static_sensitivity(simulator, parameters, flat, directions)


def test_a_predicted_start_is_nearer_and_touches_nothing(drape):
    simulator, parameters, positions = drape
    x = np.asarray(positions)
    change = 0.002 * parameters.rest_positions
    directions = {"rest_positions": change[None]}
    displacement = static_sensitivity(simulator, parameters, x, directions)[..., 0]
    changed = replace(parameters, rest_positions=parameters.rest_positions + change)
    start = predicted_start(simulator, changed, x, displacement)
    end = static_solve(simulator, changed, start)
    assert end.report.converged and end.report.intersection_free
    way = np.abs(np.asarray(end.positions) - x).max()
    assert np.abs(np.asarray(end.positions) - start).max() < 0.5 * way
    into_body = np.zeros_like(x)
    into_body[:, 1] = -10.0
    stopped = predicted_start(simulator, changed, x, into_body)
    settings = simulator.settings
    distance = _objective(simulator, changed, jnp.asarray(x)).smallest_distances(stopped).plain
    assert distance > float(settings.thickness)
