"""Derivatives against differences: to 1e-6 where nothing buckles, to 1e-4 over a hundred steps."""

import gc
import weakref

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core.pytree import replace
from dress_jax.energy.fabric import make_parameters
from dress_jax.sim import State, make_cloth, make_simulator, static_solve, step
from dress_jax.sim.adjoint import Linearization
from dress_jax.solver import NewtonOptions
from tests.central_differences import central_difference
from tests.sim.scenes import SOFT, draped_sheet, sheet

WITHOUT_CONTACT = 1e-6
CHAIN = 1e-4
STEPS, TIME_STEP = 100, 0.02
# Steps of the differences; the hanging sheet is stiff, so they may be larger than those of a fold.
LEAVES = {
    "rest_positions": 1e-5,
    "density": 1e-3,
    "stretching_stiffness": 0.3,
    "bending_stiffness": 1e-7,
    "gravity": 1e-2,
    "pin_targets": 1e-5,
    "pin_stiffness": 30.0,
}


@pytest.fixture(scope="module")
def hanging():
    """A sheet that hangs from one edge, held at an angle, touched by nothing."""
    rest, faces = sheet(6, 0.3)
    pins = np.arange(0, 36, 6)
    start = np.stack([rest[:, 0], rest[:, 1], 0.02 * np.sin(9.0 * rest[:, 0] * rest[:, 1])], axis=1)
    cloth = make_cloth(faces, pins=pins)
    simulator = make_simulator(
        cloth, start, newton=NewtonOptions(tolerance=1e-13, iteration_limit=300)
    )
    parameters = make_parameters(
        cloth, SOFT, jnp.asarray(rest), pin_targets=jnp.asarray(start[pins])
    )
    drape = static_solve(simulator, parameters, jnp.asarray(start))
    assert drape.report.converged
    assert not np.isfinite(float(drape.report.smallest_distance))
    weights = jnp.asarray(np.sin(np.arange(start.size)).reshape(-1, 3))

    def loss(p):
        return jnp.sum(weights * static_solve(simulator, p, drape.positions).positions)

    return parameters, loss, jax.grad(loss)(parameters)


@pytest.mark.parametrize("name", LEAVES)
def test_adjoint_without_contact(hanging, name):
    """S2.4, S2.5, S2.9: nothing but rounding is between the adjoint and the differences."""
    parameters, loss, derivative = hanging
    leaf = getattr(parameters, name)
    direction = jnp.asarray(np.cos(1.0 + np.arange(leaf.size)).reshape(leaf.shape))
    exact = float(jnp.sum(getattr(derivative, name) * direction))
    measured = central_difference(
        lambda t: loss(replace(parameters, **{name: leaf + t * direction})), LEAVES[name]
    )
    assert abs(exact) > 0.0
    assert abs(exact - measured) <= WITHOUT_CONTACT * abs(measured)


@pytest.fixture(scope="module")
def chain():
    """A sheet that falls onto a ball, slides on it with friction and comes to rest in 2 s."""
    cloth, simulator, rest, start, body = draped_sheet(friction=True)
    pins = jnp.asarray(start[np.asarray(cloth.pins)])
    parameters = make_parameters(cloth, SOFT, rest, body_vertices=body, pin_targets=pins)
    weights = jnp.asarray(np.sin(np.arange(start.size)).reshape(-1, 3))
    touched = []

    def loss(p):
        state = State(jnp.asarray(start), jnp.zeros_like(jnp.asarray(start)))
        for _ in range(STEPS):
            state, report = step(simulator, state, p, time_step=TIME_STEP)
        touched.append(report.smallest_distance)
        return jnp.sum(weights * state.positions)

    return simulator, parameters, loss, touched


@pytest.mark.slow
def test_a_chain_of_a_hundred_steps(chain, monkeypatch):
    """S2.6, S2.12: back through 100 steps with contact and friction; only states are kept."""
    simulator, parameters, loss, touched = chain
    alive = weakref.WeakSet()
    most, original = [0], Linearization.__init__

    def counted(self, *arguments, **options):
        original(self, *arguments, **options)
        alive.add(self)
        gc.collect()
        most[0] = max(most[0], len(alive))

    with monkeypatch.context() as patch:
        patch.setattr(Linearization, "__init__", counted)
        derivative = jax.grad(loss)(parameters)
    assert most[0] <= 3
    settings = simulator.settings
    assert float(touched[-1]) < float(settings.dhat + settings.thickness)
    for name, size in (
        ("density", 1e-5),
        ("gravity", 1e-4),
        ("friction_coefficient", 2e-6),
        ("rest_positions", 1e-7),
    ):
        leaf = getattr(parameters, name)
        direction = jnp.asarray(np.cos(1.0 + np.arange(leaf.size)).reshape(leaf.shape))
        exact = float(jnp.sum(getattr(derivative, name) * direction))
        measured = central_difference(
            lambda t, name=name, leaf=leaf, direction=direction: loss(
                replace(parameters, **{name: leaf + t * direction})
            ),
            size,
        )
        assert abs(exact) > 0.0
        assert abs(exact - measured) <= CHAIN * abs(measured), name
