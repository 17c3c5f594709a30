"""Exact Hessians of hinges in closed form against automatic differentiation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core import components as c
from dress_jax.energy.bending import HINGE_PAIRS, bending_energy
from dress_jax.energy.hinge_hessian import curvature_blocks, hinge_blocks

HINGE = jnp.arange(4)[:, None]
WEIGHT, STIFFNESS = jnp.asarray([1.7]), jnp.asarray(0.6)


def _energy(x):
    return bending_energy(c.split(x), HINGE, WEIGHT, STIFFNESS)


@pytest.mark.parametrize("fold", [0.0, 0.3, -0.8, 1.5, -2.5, 3.0])
def test_closed_form_is_the_second_derivative(fold):
    rng = np.random.default_rng(3)
    away = 0.8 * np.array([0.0, -np.cos(fold), np.sin(fold)])
    flat = np.array([[0.0, 0, 0], [1.0, 0, 0], [0.3, 0.9, 0], np.add([0.6, 0, 0], away)])
    x = jnp.asarray(flat + 0.02 * rng.normal(size=(4, 3)))
    expected = np.asarray(jax.hessian(_energy)(x))
    blocks = hinge_blocks(c.split(x), HINGE, WEIGHT, STIFFNESS)
    gradient = np.asarray(blocks.gradient)[..., 0]
    added = np.asarray(curvature_blocks(blocks))[..., 0].reshape(-1, 3, 3)
    scale = np.abs(expected).max()
    assert scale > 0.1 and np.abs(added).max() > 1e-3
    for (p, q), curved in zip(HINGE_PAIRS, added, strict=True):
        found = float(blocks.stiffness[0]) * np.outer(gradient[p], gradient[q]) + curved
        np.testing.assert_allclose(found, expected[p, :, q], rtol=0, atol=1e-11 * scale)
