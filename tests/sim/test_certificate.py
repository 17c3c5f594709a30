"""The slowest mode of a state against a dense eigenvalue problem."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from dress_jax.core.pytree import replace
from dress_jax.energy.fabric import make_parameters
from dress_jax.sim import static_solve
from dress_jax.sim.certificate import certify
from dress_jax.sim.objective import resting_objective
from dress_jax.solver.linear import LinearSolveError
from tests.sim.scenes import SOFT, draped_sheet

EIGENVALUE = 1e-5  # of the Lanczos iterations, relative to the shift


@pytest.fixture(scope="module")
def scene():
    cloth, simulator, rest, start, body = draped_sheet()
    pins = start[np.asarray(cloth.pins)]
    parameters = make_parameters(cloth, SOFT, rest, body_vertices=body, pin_targets=pins)
    return simulator, parameters, start


def _dense(simulator, parameters, x) -> float:
    """The smallest eigenvalue of the exact Hessian without inertia, relative to the masses."""
    objective = resting_objective(simulator, parameters, x)
    eye = np.eye(x.size).reshape(-1, *x.shape)
    hessian = np.array([objective.hessian_product(x, row).ravel() for row in eye])
    masses = np.diag(np.repeat(objective.masses, 3))
    hessian = 0.5 * (hessian + hessian.T) - masses  # a step of 1 s
    return float(scipy.linalg.eigh(hessian, masses, eigvals_only=True, subset_by_index=[0, 0])[0])


def test_a_drape_is_an_equilibrium_and_stable(scene):
    simulator, parameters, start = scene
    result = static_solve(simulator, parameters, start)
    for _ in range(10):  # of 1 s each, until inertia has nothing to add
        result = static_solve(simulator, parameters, result.positions)
    x = np.asarray(result.positions)
    certificate = certify(simulator, parameters, x)
    expected = _dense(simulator, parameters, x)
    assert certificate.stable and expected > 0.0
    assert certificate.smallest_eigenvalue == pytest.approx(expected, abs=EIGENVALUE)
    # Against a weight of about 5 mN a vertex.
    assert certificate.residual < 1e-9


def test_a_flat_compressed_sheet_is_a_saddle(scene):
    """It would buckle: the exact Hessian is indefinite, and Cholesky needs a shift."""
    simulator, parameters, start = scene
    compressed = replace(parameters, rest_positions=1.02 * parameters.rest_positions)
    certificate = certify(simulator, compressed, start)
    expected = _dense(simulator, compressed, start)
    assert not certificate.stable and expected < -10.0
    assert certificate.smallest_eigenvalue == pytest.approx(expected, rel=1e-4)


def test_the_residual_is_the_largest_force(scene):
    """Far above the ball and at rest, only gravity acts."""
    simulator, parameters, start = scene
    flat = np.asarray(start) + np.array([0.0, 1.0, 0.0])
    lifted = replace(parameters, pin_targets=jnp.asarray(flat[np.asarray(simulator.cloth.pins)]))
    objective = resting_objective(simulator, lifted, flat)
    weight = objective.masses.max() * float(np.linalg.norm(np.asarray(lifted.gravity)))
    assert certify(simulator, lifted, flat).residual == pytest.approx(weight, rel=1e-9)


def test_a_hessian_that_is_not_finite_has_no_certificate(scene):
    simulator, parameters, start = scene
    endless = replace(parameters, bending_stiffness=jnp.asarray(np.inf))
    with pytest.raises(LinearSolveError):
        certify(simulator, endless, start)
