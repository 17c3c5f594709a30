"""Forward mode, second derivatives and batches of the drape, with contact."""

import weakref

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core.pytree import replace
from dress_jax.energy.fabric import make_parameters
from dress_jax.sim import static_solve, step
from dress_jax.sim.adjoint import Linearization
from dress_jax.sim.objective import StepObjective
from tests.central_differences import central_difference
from tests.sim.scenes import SOFT, draped_sheet
from tests.sim.test_derivatives import LEAVES, swinging_sheet

AGREEMENT = 1e-10  # of forward and reverse mode, relative
SECOND_TOLERANCE = 1e-5  # of second derivatives against differences of the first


@pytest.fixture(scope="module")
def drape():
    """Drape again and again from its own end, until nothing moves."""
    cloth, simulator, rest, start, body = draped_sheet()
    pins = start[np.asarray(cloth.pins)]
    parameters = make_parameters(cloth, SOFT, rest, body_vertices=body, pin_targets=pins)
    result = static_solve(simulator, parameters, start)
    settings = simulator.settings
    assert result.report.converged
    assert float(result.report.smallest_distance) < float(settings.dhat + settings.thickness)
    weights = jnp.asarray(np.sin(np.arange(result.positions.size)).reshape(-1, 3))
    return simulator, parameters, result.positions, weights


def _direction(parameters, name, phase=1.0):
    leaf = getattr(parameters, name)
    return jnp.asarray(np.cos(phase + np.arange(leaf.size)).reshape(leaf.shape))


def _along(drape, name):
    """The drape as a function of a step along a direction of one parameter."""
    simulator, parameters, start, _ = drape
    leaf, direction = getattr(parameters, name), _direction(parameters, name)

    def positions(t):
        moved = replace(parameters, **{name: leaf + t * direction})
        return static_solve(simulator, moved, start).positions

    return positions


@pytest.mark.parametrize("name", LEAVES)
def test_forward_mode_equals_reverse_mode(drape, name):
    weights = drape[3]
    positions = _along(drape, name)
    _, rate = jax.jvp(positions, (0.0,), (1.0,))
    forward = float(jnp.sum(weights * rate))
    reverse = float(jax.grad(lambda t: jnp.sum(weights * positions(t)))(0.0))
    assert abs(reverse) > 0.0
    assert forward == pytest.approx(reverse, rel=AGREEMENT)


@pytest.mark.parametrize("name", ["rest_positions", "bending_stiffness", "body_vertices"])
def test_hessian_products_equal_differences_of_the_gradient(drape, name):
    """Forward over reverse, in the space of all parameters."""
    simulator, parameters, start, weights = drape
    leaf, direction = getattr(parameters, name), _direction(parameters, name)

    def loss(p):
        return jnp.sum(weights * static_solve(simulator, p, start).positions)

    moved = jax.tree.map(jnp.zeros_like, parameters)
    moved = replace(moved, **{name: direction})
    _, product = jax.jvp(jax.grad(loss), (parameters,), (moved,))
    probe = {key: _direction(parameters, key, 2.0) for key in LEAVES}

    def slopes(t):
        at = jax.grad(loss)(replace(parameters, **{name: leaf + t * direction}))
        return np.array([float(jnp.sum(getattr(at, key) * probe[key])) for key in LEAVES])

    size = LEAVES[name]
    one, two = slopes(size) - slopes(-size), slopes(2 * size) - slopes(-2 * size)
    measured = (8 * one - two) / (12 * size)
    exact = np.array([float(jnp.sum(getattr(product, key) * probe[key])) for key in LEAVES])
    assert np.all(np.abs(exact) > 0.0)
    assert np.allclose(exact, measured, rtol=SECOND_TOLERANCE, atol=0.0)


@pytest.mark.slow
def test_forward_over_forward_equals_forward_over_reverse(drape):
    weights = drape[3]
    positions = _along(drape, "rest_positions")

    def rate(t):
        return jax.jvp(positions, (t,), (1.0,))[1]

    twice = float(jnp.sum(weights * jax.jvp(rate, (0.0,), (1.0,))[1]))
    slope = jax.grad(lambda t: jnp.sum(weights * positions(t)))
    mixed = float(jax.jvp(slope, (0.0,), (1.0,))[1])
    assert abs(mixed) > 0.0
    assert twice == pytest.approx(mixed, rel=1e-8)


def test_reverse_over_reverse_says_what_to_do(drape):
    positions = _along(drape, "density")
    slope = jax.grad(lambda t: jnp.sum(positions(t)))
    with pytest.raises(TypeError, match="forward over reverse"):
        jax.grad(slope)(0.0)


def test_many_right_hand_sides_share_one_factorization(drape, monkeypatch):
    simulator, parameters, start, weights = drape
    factorized, original = [], StepObjective.factorize

    def counted(self, positions, **options):
        factorized.append(options)
        return original(self, positions, **options)

    def positions(pins):
        return static_solve(simulator, replace(parameters, pin_targets=pins), start).positions

    end, pull = jax.vjp(positions, parameters.pin_targets)
    monkeypatch.setattr(StepObjective, "factorize", counted)
    cotangents = jnp.stack([weights, 2.0 * weights, weights**2, jnp.ones_like(weights)])
    (together,) = jax.vmap(pull)(cotangents)
    assert len(factorized) == 1
    assert together.shape == (4, *parameters.pin_targets.shape)
    assert np.allclose(together[1], 2.0 * together[0], rtol=1e-9)
    assert end.shape == start.shape


@pytest.mark.slow
def test_a_chain_keeps_no_factorizations():
    """Of a chain of steps only the states are kept; the rest is made anew on the way back."""
    simulator, parameters, state, weights = swinging_sheet(friction=True)
    alive = []
    original = Linearization.__init__

    def counted(self, *arguments, **options):
        alive.append(weakref.ref(self))
        original(self, *arguments, **options)

    def loss(density):
        at = state
        for _ in range(6):
            at, _ = step(simulator, at, replace(parameters, density=density), time_step=0.02)
        return jnp.sum(weights * at.positions)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Linearization, "__init__", counted)
        _, pull = jax.vjp(loss, jnp.asarray(0.2))
        assert len(alive) == 6
        assert sum(reference() is not None for reference in alive) == 1
        (slope,) = pull(1.0)
    measured = central_difference(lambda t: loss(0.2 + t), 1e-5)
    assert abs(float(slope)) > 0.0
    assert float(slope) == pytest.approx(measured, rel=SECOND_TOLERANCE)
