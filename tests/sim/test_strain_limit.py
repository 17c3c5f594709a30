"""Whole solves with a strain limit: every iterate keeps it, and the adjoint sees it."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.energy.fabric import make_parameters
from dress_jax.energy.membrane import MembraneModel, principal_stretches
from dress_jax.energy.panels import FacePanels
from dress_jax.energy.rest import rest_triangles
from dress_jax.sim import make_cloth, make_simulator, static_solve
from dress_jax.solver import NewtonOptions
from tests.central_differences import central_difference
from tests.sim.scenes import SOFT, draped_sheet, level, sheet

LIMIT = 1.05
HEAVY = dataclasses.replace(SOFT, density=2.0)
# As in `test_derivatives`: the noise of the solve over the step of the difference.
ADJOINT_TOLERANCE = 1e-5


def hung(membrane: MembraneModel, *, strain_limit: float | None):
    """Heavy cloth held at two corners: simulator, parameters, start."""
    count = 8
    rest, faces = sheet(count, 0.3)
    start = level(rest, 1.0)
    cloth = make_cloth(faces, pins=np.array([0, count - 1]), membrane=membrane)
    simulator = make_simulator(
        cloth, start, newton=NewtonOptions(tolerance=1e-7, iteration_limit=500)
    )
    parameters = make_parameters(
        cloth, HEAVY, rest, pin_targets=start[[0, count - 1]], strain_limit=strain_limit
    )
    return simulator, parameters, start


def stretches(simulator, parameters, positions) -> np.ndarray:
    rest = rest_triangles(parameters.rest_positions, simulator.cloth.rest_faces)
    found = principal_stretches(jnp.asarray(positions), simulator.cloth.faces, rest)[0]
    return np.asarray(found)


@pytest.mark.parametrize(
    "membrane",
    [MembraneModel.ARAP, pytest.param(MembraneModel.ORTHOTROPIC, marks=pytest.mark.slow)],
)
def test_every_iterate_of_a_heavy_cloth_keeps_the_limit(membrane):
    """Without it, the same cloth stretches more than twice as far."""
    free = static_solve(*hung(membrane, strain_limit=None))
    simulator, parameters, start = hung(membrane, strain_limit=LIMIT)
    assert stretches(simulator, parameters, free.positions).max() > 1.0 + 2.0 * (LIMIT - 1.0)
    seen = []
    simulator.progress = lambda p: seen.append(stretches(simulator, parameters, p.positions).max())
    result = static_solve(simulator, parameters, start)
    assert result.report.converged and result.report.intersection_free
    assert len(seen) == int(result.report.iterations) > 5
    assert max(seen) < LIMIT
    assert seen[-1] > 1.0 + 0.5 * (LIMIT - 1.0)  # the barrier carries the cloth


def test_a_start_beyond_the_limit_names_the_triangle():
    simulator, parameters, start = hung(MembraneModel.ARAP, strain_limit=LIMIT)
    owner = np.zeros(simulator.cloth.faces.shape[1], np.int32)
    simulator.panels = FacePanels(("front",), owner)
    pulled = start.copy()
    pulled[-1] += [0.05, 0.0, -0.05]
    with pytest.raises(InputError, match=r"panel 'front', triangle \d+.*raise it"):
        static_solve(simulator, parameters, pulled)
    simulator.panels = None
    with pytest.raises(InputError, match=r"^triangle \d+"):
        static_solve(simulator, parameters, pulled)


@pytest.fixture(scope="module")
def drape():
    cloth, simulator, rest, start, body = draped_sheet()
    parameters = make_parameters(
        cloth,
        HEAVY,
        rest,
        body_vertices=body,
        pin_targets=start[np.asarray(cloth.pins)],
        strain_limit=LIMIT,
    )
    result = static_solve(simulator, parameters, start)
    assert result.report.converged and result.report.intersection_free
    settings = simulator.settings
    assert float(result.report.smallest_distance) < float(settings.dhat + settings.thickness)
    # The barrier is at work.
    largest = stretches(simulator, parameters, result.positions).max()
    assert 1.0 + 0.5 * (LIMIT - 1.0) < largest < LIMIT
    weights = jnp.asarray(np.sin(np.arange(result.positions.size)).reshape(-1, 3))

    def loss(p):
        return jnp.sum(weights * static_solve(simulator, p, result.positions).positions)

    return parameters, loss, jax.grad(loss)(parameters)


@pytest.mark.parametrize(
    ("name", "size"),
    [("rest_positions", 3e-7), ("density", 1e-5), ("stretching_stiffness", 3e-3)],
)
def test_adjoint_with_an_active_limit(drape, name, size):
    parameters, loss, derivative = drape
    leaf = getattr(parameters, name)
    direction = jnp.asarray(np.cos(1.0 + np.arange(leaf.size)).reshape(leaf.shape))
    exact = float(jnp.sum(getattr(derivative, name) * direction))
    measured = central_difference(
        lambda t: loss(replace(parameters, **{name: leaf + t * direction})), size
    )
    assert abs(exact) > 0.0
    assert abs(exact - measured) <= ADJOINT_TOLERANCE * abs(measured)


@pytest.mark.parametrize(("name", "size"), [("stretch", 1e-6), ("stiffness", 1e-3)])
def test_adjoint_in_the_limit_itself(drape, name, size):
    parameters, loss, derivative = drape
    limit = parameters.strain_limit
    exact = float(getattr(derivative.strain_limit, name))

    def moved(t):
        changed = replace(limit, **{name: getattr(limit, name) + t})
        return loss(replace(parameters, strain_limit=changed))

    measured = central_difference(moved, size)
    assert abs(exact) > 0.0
    assert abs(exact - measured) <= ADJOINT_TOLERANCE * abs(measured)
