"""A start state that will not do is refused, and the message says which panels are at fault."""

import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core.errors import InputError
from dress_jax.energy.cloth import make_cloth
from dress_jax.energy.fabric import make_parameters
from dress_jax.energy.panels import FacePanels
from dress_jax.sim import make_simulator, static_solve
from tests.sim.scenes import SOFT, level, sheet

REST, FACES = sheet(3, 0.2)
PANELS = FacePanels(("sleeve", "front", "back"), np.repeat(np.arange(3), len(FACES)))
FLOOR = np.array([[-2.0, -0.1, -1.0], [0.0, -0.1, 2.0], [2.0, -0.1, -1.0]])
# The vertices of the floor far away, and the third sheet always far above the others.
APART = (0.0, 0.05, 1.0)


def _three_sheets(*, panels: FacePanels | None = PANELS, heights=APART, tilt=0.0):
    """Sleeve, front and back above each other; the front tilted about its middle."""
    cloth = make_cloth(np.concatenate([FACES + len(REST) * k for k in range(3)]))
    layers = [level(REST, height) for height in heights]
    layers[1][:, 1] += tilt * layers[1][:, 0]
    layers[1] += [0.013, 0.0, 0.007]
    start = np.concatenate(layers)
    simulator = make_simulator(
        cloth,
        start,
        body_vertices=FLOOR,
        body_faces=np.array([[0, 1, 2]]),
        panels=panels,
    )
    rest = np.concatenate([REST + np.array([k, 0.0]) for k in range(3)])
    return simulator, make_parameters(cloth, SOFT, rest, body_vertices=FLOOR), jnp.asarray(start)


def _refusal(**options) -> InputError:
    with pytest.raises(InputError) as caught:
        static_solve(*_three_sheets(**options))
    return caught.value


def test_crossing_panels_are_named():
    error = _refusal(heights=(0.0, 0.0, 1.0), tilt=0.5)
    assert "['front', 'sleeve']" in error.where and "back" not in error.where
    assert "near (" in error.where and "intersections" in error.problem


def test_a_panel_that_crosses_the_body_is_named():
    error = _refusal(heights=(0.0, -0.1, 1.0), tilt=0.5)
    assert "['front']" in error.where
    assert "with the body" in error.problem
    # Where: at the floor, which is crossed near the middle of the sheet.
    assert ", -0.1" in error.where


def test_panels_that_are_too_close_are_named():
    error = _refusal(heights=(0.0, 1e-4, 1.0))
    assert "['front', 'sleeve']" in error.where and "back" not in error.where
    assert "0.3333 times its thickness" in error.problem


def test_without_names_the_place_is_given():
    error = _refusal(panels=None, heights=(0.0, 0.0, 1.0), tilt=0.5)
    assert error.where.startswith("near (")


def test_a_clean_start_passes():
    simulator, parameters, start = _three_sheets()
    simulator.newton = type(simulator.newton)(iteration_limit=1)
    assert static_solve(simulator, parameters, start).report.intersection_free


def test_names_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match="panels of 1 triangles"):
        _three_sheets(panels=FacePanels(("front",), np.zeros(1, int)))
