"""Whole solves of woven cloth: a strip along warp and weft, compression, derivatives."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core.pytree import replace
from dress_jax.energy.fabric import make_parameters
from dress_jax.energy.membrane import MembraneModel
from dress_jax.sim import make_cloth, make_simulator, static_solve
from dress_jax.solver import NewtonOptions
from tests.central_differences import central_difference
from tests.sim.scenes import SOFT, draped_sheet, sheet

WOVEN = dataclasses.replace(
    SOFT, poisson_ratio=0.2, warp_stiffness=300.0, weft_stiffness=150.0, shear_stiffness=30.0
)
# As in `test_derivatives`: the noise of the solve over the step of the difference.
ADJOINT_TOLERANCE = 1e-5
LEAVES = {
    "warp_stiffness": 3e-3,
    "weft_stiffness": 3e-3,
    "shear_stiffness": 3e-4,
    "poisson_ratio": 1e-5,
    "grain_angle": 1e-5,
    "rest_positions": 3e-7,
}


@pytest.mark.parametrize(("grain", "modulus"), [(0.0, 300.0), (np.pi / 2, 150.0)])
def test_a_hanging_strip_has_the_modulus_of_its_yarns(grain, modulus):
    """It stretches by rho g L^2 / (2 Y) under its own weight, whatever the mesh."""
    size = 0.4
    uncoupled = dataclasses.replace(WOVEN, poisson_ratio=0.0)
    expected = SOFT.density * 9.81 * size**2 / (2.0 * modulus)
    errors = []
    for count in (5, 9):
        rest, faces = sheet(count, size)
        top = np.arange(count) * count + count - 1
        cloth = make_cloth(faces, pins=top, membrane=MembraneModel.ORTHOTROPIC)
        start = np.stack([rest[:, 0], rest[:, 1], np.zeros(len(rest))], axis=1)
        simulator = make_simulator(cloth, start, newton=NewtonOptions(tolerance=1e-9))
        parameters = replace(
            make_parameters(cloth, uncoupled, rest, pin_targets=start[top]),
            pin_stiffness=jnp.asarray(1e6),
            grain_angle=jnp.asarray(grain),
        )
        result = static_solve(simulator, parameters, start, time_step=None)
        assert result.report.converged
        bottom = np.asarray(result.positions)[np.arange(count) * count, 1]
        errors.append(abs((start[0, 1] - bottom.mean()) / expected - 1.0))
    # Constant strain on triangles: the error falls with the mesh, to 3 % at eight rows.
    assert errors[1] < 0.03
    assert errors[1] < 0.75 * errors[0] or errors[0] < 1e-3


def test_strong_compression_is_undone():
    """A sheet squeezed to a fifth, without gravity, finds its shape again."""
    rest, faces = sheet(7, 0.3)
    cloth = make_cloth(faces, membrane=MembraneModel.ORTHOTROPIC)
    rng = np.random.default_rng(0)
    start = np.c_[0.2 * rest, 1e-3 * rng.normal(size=len(rest))]
    simulator = make_simulator(cloth, start, newton=NewtonOptions(tolerance=1e-8))
    parameters = make_parameters(cloth, WOVEN, rest)
    parameters = replace(parameters, gravity=jnp.zeros(3))
    result = static_solve(simulator, parameters, start)
    assert result.report.converged and result.report.intersection_free
    x = np.asarray(result.positions)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    lengths = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1)
    expected = np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    # The inertia of a step of 1 s is what is left: 0.2 kg/m^2 against 30 N/m.
    np.testing.assert_allclose(lengths, expected, rtol=1e-3)


@pytest.fixture(scope="module")
def drape():
    cloth, simulator, rest, start, body = draped_sheet(membrane=MembraneModel.ORTHOTROPIC)
    parameters = make_parameters(
        cloth, WOVEN, rest, body_vertices=body, pin_targets=start[np.asarray(cloth.pins)]
    )
    parameters = replace(parameters, grain_angle=jnp.asarray(0.3))
    result = static_solve(simulator, parameters, start)
    assert result.report.converged and result.report.intersection_free
    settings = simulator.settings
    assert float(result.report.smallest_distance) < float(settings.dhat + settings.thickness)
    weights = jnp.asarray(np.sin(np.arange(result.positions.size)).reshape(-1, 3))

    def loss(p):
        return jnp.sum(weights * static_solve(simulator, p, result.positions).positions)

    return parameters, loss, jax.grad(loss)(parameters)


@pytest.mark.parametrize("name", LEAVES)
def test_adjoint_equals_finite_differences(drape, name):
    """With contact active, for every leaf that the orthotropic membrane takes."""
    parameters, loss, derivative = drape
    leaf = getattr(parameters, name)
    direction = jnp.asarray(np.cos(1.0 + np.arange(leaf.size)).reshape(leaf.shape))
    exact = float(jnp.sum(getattr(derivative, name) * direction))
    measured = central_difference(
        lambda t: loss(replace(parameters, **{name: leaf + t * direction})), LEAVES[name]
    )
    assert abs(exact) > 0.0
    assert abs(exact - measured) <= ADJOINT_TOLERANCE * abs(measured)
