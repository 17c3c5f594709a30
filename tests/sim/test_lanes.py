"""Batches of drapes: several lanes at once, as if each were alone."""

import dataclasses
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.energy.fabric import make_parameters
from dress_jax.sim import static_solve
from dress_jax.sim.lanes import run_lanes
from dress_jax.sim.objective import StepObjective
from tests.sim.scenes import SOFT, draped_sheet

DENSITIES = jnp.asarray([0.2, 0.19, 0.21, 0.205, 0.195])
# A lane's sparsity has grown with other lanes than that of a single solve has, so its equations are
# solved in another order; Newton's method stops at 0.01 mm.
SAME_DRAPE = 1e-6  # [m]


@pytest.fixture(scope="module")
def drape():
    cloth, simulator, rest, start, body = draped_sheet()
    simulator = dataclasses.replace(simulator, workers=2)
    pins = start[np.asarray(cloth.pins)]
    parameters = make_parameters(cloth, SOFT, rest, body_vertices=body, pin_targets=pins)
    start = static_solve(simulator, parameters, start).positions
    weights = jnp.asarray(np.sin(np.arange(start.size)).reshape(-1, 3))
    return simulator, parameters, start, weights


def _solve(drape, density):
    simulator, parameters, start, _ = drape
    return static_solve(simulator, replace(parameters, density=density), start)


def _loss(drape, density):
    return jnp.sum(drape[3] * _solve(drape, density).positions)


def test_each_lane_is_what_it_would_be_alone(drape):
    """Positions, reports and derivatives; several of each in a worker."""
    batch = jax.vmap(lambda density: _solve(drape, density))(DENSITIES)
    assert batch.positions.shape == (5, *drape[2].shape)
    assert batch.report.iterations.shape == (5,)
    assert int(jnp.sum(batch.report.self_intersections + batch.report.body_intersections)) == 0
    slopes = jax.vmap(jax.grad(lambda density: _loss(drape, density)))(DENSITIES)
    for density, positions, slope in zip(DENSITIES, batch.positions, slopes, strict=True):
        assert np.allclose(positions, _solve(drape, density).positions, rtol=0.0, atol=SAME_DRAPE)
        single = float(jax.grad(lambda density: _loss(drape, density))(density))
        assert abs(single) > 0.0
        assert float(slope) == pytest.approx(single, rel=1e-5)


def test_the_gradient_of_a_batch(drape):
    """Reverse and forward mode through `vmap`, with something that all lanes share."""
    simulator, parameters, start, weights = drape

    def total(gravity):
        def loss(density):
            moved = replace(parameters, density=density, gravity=gravity)
            return jnp.sum(weights * static_solve(simulator, moved, start).positions)

        return jnp.sum(jax.vmap(loss)(DENSITIES[:3]))

    def alone(gravity):
        def loss(density):
            moved = replace(parameters, density=density, gravity=gravity)
            return jnp.sum(weights * static_solve(simulator, moved, start).positions)

        return sum(loss(density) for density in DENSITIES[:3])

    slope = np.asarray(jax.grad(total)(parameters.gravity))
    assert np.all(np.abs(slope) > 0.0)
    assert np.allclose(slope, jax.grad(alone)(parameters.gravity), rtol=1e-5)
    along = jnp.asarray([0.3, -0.5, 0.2])
    _, rate = jax.jvp(total, (parameters.gravity,), (along,))
    assert float(rate) == pytest.approx(float(np.sum(slope * np.asarray(along))), rel=1e-8)


@pytest.mark.slow
def test_a_batch_of_batches(drape):
    """Rows of lanes, and many right-hand sides in each lane that share its factorization."""
    grid = DENSITIES[:4].reshape(2, 2)
    nested = jax.vmap(jax.vmap(lambda density: _loss(drape, density)))(grid)
    flat = jax.vmap(lambda density: _loss(drape, density))(grid.ravel())
    assert np.array_equal(nested.ravel(), flat)


def test_right_hand_sides_of_a_lane_share_its_factorization(drape, monkeypatch):
    simulator, parameters, start, weights = drape
    factorized, original = [], StepObjective.factorize

    def counted(self, positions, **options):
        factorized.append(self.parameters.density)
        return original(self, positions, **options)

    def positions(density, pins):
        moved = replace(parameters, density=density, pin_targets=pins)
        return static_solve(simulator, moved, start).positions

    def pulled(density):
        _, pull = jax.vjp(lambda pins: positions(density, pins), parameters.pin_targets)
        monkeypatch.setattr(StepObjective, "factorize", counted)
        return jax.vmap(pull)(jnp.stack([weights, 2.0 * weights, weights**2]))[0]

    batch = jax.vmap(pulled)(DENSITIES[:2])
    assert batch.shape == (2, 3, *parameters.pin_targets.shape)
    assert np.allclose(batch[:, 1], 2.0 * batch[:, 0], rtol=1e-8)
    assert len(factorized) <= 2


def test_a_batch_is_repeated_bit_by_bit(drape):
    def run():
        cloth, simulator, rest, start, body = draped_sheet()
        pins = start[np.asarray(cloth.pins)]
        parameters = make_parameters(cloth, SOFT, rest, body_vertices=body, pin_targets=pins)
        fresh = dataclasses.replace(simulator, workers=2), parameters, drape[2], drape[3]
        return jax.vmap(lambda density: _solve(fresh, density).positions)(DENSITIES)

    assert np.array_equal(run(), run())


def test_lanes_run_at_once_and_in_order(drape):
    """Both workers have to be there at the same time for either to go on."""
    simulator = drape[0]
    meeting = threading.Barrier(2, timeout=60)

    def solve(twin, lane):
        if lane in (0, 2):
            meeting.wait()
        assert jax.config.jax_enable_x64
        return lane, twin

    results = run_lanes(simulator, 4, solve)
    assert [lane for lane, _ in results] == [0, 1, 2, 3]
    assert results[0][1] is results[1][1] and results[2][1] is results[3][1]
    assert results[0][1] is not results[2][1]
    assert simulator not in (results[0][1], results[2][1])


def test_a_failed_lane_raises(drape):
    with pytest.raises(InputError, match="density"):
        jax.vmap(lambda density: _solve(drape, density).positions)(jnp.asarray([0.2, -1.0]))
