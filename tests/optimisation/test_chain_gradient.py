"""Derivatives of the whole chain, pattern to image, against central differences."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from fit_scenes import HALF_EXTENT, SIZE, with_options

from dress_jax.optimisation.state import from_groups, groups
from dress_jax.optimisation.trial import try_unknowns

PIXEL = 2.0 * HALF_EXTENT / SIZE

GEOMETRIC = 1e-5
"""Relative; limited by differences of drapes that are solved to rounding."""

STEP = 3e-6
"""Of the geometric differences: short against the reach of the barrier, 3 mm."""

SILHOUETTE = 0.08
"""Relative; the renderer samples a contour once per row or column and holds areas to 0.05, and a
difference over pixels also sees curvature."""


def value_and_slope(problem, state, name, direction=None):
    """The derivative along a direction of one group, and the loss as a function of the step."""

    def at(change):
        moved = groups(state.unknowns)
        moved[name] = moved[name] + change
        trial = try_unknowns(problem, from_groups(moved), state.positions, iteration=0)
        assert trial.gradient is not None, trial.info
        return trial

    gradient = groups(at(0.0).gradient)[name]
    if direction is None:  # noise, turned uphill so that it does not cancel
        noise = np.random.default_rng(5).uniform(0.5, 1.5, size=gradient.shape)
        direction = jnp.asarray(noise) * jnp.sign(gradient)
    return float(jnp.sum(gradient * direction)), lambda step: at(step * direction).info.loss


def direction_of(state, name, rows, axis):
    """Unit steps of some rows."""
    direction = np.zeros(groups(state.unknowns)[name].shape)
    direction[rows, axis] = 1.0
    return jnp.asarray(direction)


@pytest.mark.parametrize("name", ["vertices", "controls", "log_stiffness"])
def test_strain_to_pattern_and_stiffness(problem, state, name):
    """Comfort, area ratio and seam length through drape, contact, mass and rest shape (S9.7)."""
    newton = dataclasses.replace(problem.simulator.newton, tolerance=1e-12)
    simulator = dataclasses.replace(problem.simulator, newton=newton)
    weights = {"comfort": 1.0, "area_ratio": 0.1, "seam_length": 0.1}
    geometric = dataclasses.replace(with_options(problem, weights=weights), simulator=simulator)
    slope, loss = value_and_slope(geometric, state, name)
    expected = (loss(STEP) - loss(-STEP)) / (2.0 * STEP)
    assert abs(expected) > 1e-6
    assert slope == pytest.approx(expected, rel=GEOMETRIC)


@pytest.mark.parametrize(
    ("name", "rows", "axis", "pixels"),
    [
        ("vertices", [0, 1, 4, 5], 1, 2.0),  # the hem of both panels up
        ("controls", [0, 4], 1, 2.0),  # the hem curve of both panels
    ],
)
def test_silhouette_to_pattern(problem, state, name, rows, axis, pixels):
    """The mask loss in corners and in control points."""
    masks = with_options(problem, weights={"mask": 1.0})
    slope, loss = value_and_slope(masks, state, name, direction_of(state, name, rows, axis))
    chord = 0.4 if name == "controls" else 1.0  # [m]; controls are relative to it
    step = pixels * PIXEL / chord
    expected = (loss(step) - loss(-step)) / (2.0 * step)
    assert abs(expected) > 0.05
    assert slope == pytest.approx(expected, rel=SILHOUETTE)


def test_colors(problem, state):
    """An absolute difference is linear in the colours while none of them meets its target."""
    colored = with_options(problem, weights={"color": 1.0})
    slope, loss = value_and_slope(colored, state, "colors", jnp.ones_like(state.unknowns.colors))
    step = 0.02
    expected = (loss(step) - loss(-step)) / (2.0 * step)
    assert abs(expected) > 0.05
    assert slope == pytest.approx(expected, rel=1e-3)  # float32 images
