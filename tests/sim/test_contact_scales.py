"""Cloth whose triangles are of very different sizes: contact follows them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import Delaunay

from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Gravity, make_cloth
from dress_jax.energy.fabric import make_parameters
from dress_jax.sim import make_simulation, static_solve
from dress_jax.sim.objective import resting_objective
from dress_jax.solver import NewtonOptions
from tests.sim.scenes import SOFT, draped_sheet, level

# As in the tests of the other derivatives: fourth-order differences of a converged solve.
ADJOINT_TOLERANCE = 1e-5


def _uneven_sheet():
    """A flat sheet of 10 cm whose triangles shrink to 0.5 mm at its middle, free in space."""
    rng = np.random.default_rng(2)
    radii = 0.05 * np.geomspace(0.01, 1.0, 9)
    rings = [
        r * np.stack([np.cos(a), np.sin(a)], 1)
        for number, r in enumerate(radii)
        for a in [2.0 * np.pi * (np.arange(8) + 0.5 * (number % 2)) / 8]
    ]
    rest = np.concatenate([[[0.0, 0.0]], *rings])
    rest += 1e-5 * rng.normal(size=rest.shape)
    cloth = make_cloth(Delaunay(rest).simplices)
    simulator, parameters = make_simulation(
        cloth,
        level(rest, 1.0),
        rest,
        fabric=SOFT,
        body_vertices=np.eye(3) * 0.1,
        body_faces=np.array([[0, 1, 2]]),
        gravity=Gravity.NONE,
        newton=NewtonOptions(tolerance=1e-7),
    )
    return simulator, parameters, level(rest, 1.0)


def _strain(rest, faces, x) -> float:
    """Largest change of an edge's length."""
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ratio = np.linalg.norm(x[sides[:, 0]] - x[sides[:, 1]], axis=1)
    ratio = ratio / np.linalg.norm(rest[sides[:, 0]] - rest[sides[:, 1]], axis=1)
    return float(np.max(np.abs(ratio - 1.0)))


def test_a_sheet_with_tiny_triangles_stays_as_it_is():
    """Nothing pushes on it; with the same dhat everywhere its middle is blown up."""
    simulator, parameters, start = _uneven_sheet()
    faces, rest = np.asarray(simulator.cloth.faces).T, np.asarray(parameters.rest_positions)
    cloth_scales = simulator.contact_scales[:-3]
    assert cloth_scales.min() < 0.15 and cloth_scales.max() == 1.0
    np.testing.assert_array_equal(simulator.contact_scales[-3:], 1.0)
    assert not any(
        int(pairs.count)
        for pairs in resting_objective(simulator, parameters, start).contacts(start)
    )
    still = static_solve(simulator, parameters, start)
    assert still.report.converged and int(still.report.iterations) == 0

    same = dataclasses.replace(
        simulator,
        contact_scales=np.ones(len(start) + 3),
        newton=NewtonOptions(iteration_limit=10),
    )
    blown = static_solve(same, parameters, start)
    assert _strain(rest, faces, np.asarray(blown.positions)) > 0.2


@pytest.fixture(scope="module")
def drape():
    """A pinned sheet over a ball, with scales from 0.3 at one side to 1 at the other."""
    scales = np.linspace(0.3, 1.0, 36)
    cloth, simulator, rest, start, body = draped_sheet(contact_scales=scales)
    pins = start[np.asarray(cloth.pins)]
    parameters = make_parameters(cloth, SOFT, rest, body_vertices=body, pin_targets=pins)
    result = static_solve(simulator, parameters, start)
    assert result.report.converged and result.report.intersection_free
    return simulator, parameters, result


def test_the_drape_keeps_each_pairs_thickness(drape):
    simulator, parameters, result = drape
    x = np.asarray(result.positions)
    objective = resting_objective(simulator, parameters, x)
    scales = np.concatenate([np.asarray(p.scales)[: int(p.count)] for p in objective.contacts(x)])
    assert len(np.unique(scales)) >= 3  # contact at several lengths
    found = objective.smallest_distances(x)
    assert float(result.report.smallest_scaled_distance) == found.scaled
    assert found.plain < found.scaled
    assert found.scaled > float(simulator.settings.thickness)


@pytest.mark.parametrize(
    ("name", "size"),
    [("rest_positions", 3e-7), ("body_vertices", 3e-7), ("barrier_stiffness", 0.3)],
)
def test_adjoint_equals_finite_differences(drape, name, size):
    """The scales are constants of the simulator, in the solve and in its derivative."""
    simulator, parameters, result = drape
    weights = jnp.asarray(np.sin(np.arange(result.positions.size)).reshape(-1, 3))
    leaf = getattr(parameters, name)
    direction = jnp.asarray(np.cos(1.0 + np.arange(leaf.size)).reshape(leaf.shape))

    def loss(t):
        moved = replace(parameters, **{name: leaf + t * direction})
        return jnp.sum(weights * static_solve(simulator, moved, result.positions).positions)

    exact = float(jax.grad(loss)(0.0))
    one, two = loss(size) - loss(-size), loss(2 * size) - loss(-2 * size)
    measured = float((8 * one - two) / (12 * size))
    assert abs(exact) > 0.0
    assert abs(exact - measured) <= ADJOINT_TOLERANCE * abs(measured)


def test_scales_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="contact_scales"):
        draped_sheet(contact_scales=np.ones(35))
    with pytest.raises(ValueError, match="above 0"):
        draped_sheet(contact_scales=np.zeros(36))
