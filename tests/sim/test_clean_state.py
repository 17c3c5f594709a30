"""A state found free of intersections is not tested again, and every other state is."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.energy.fabric import make_parameters
from dress_jax.sim import clean_state, static_solve
from dress_jax.sim.clean_state import CleanState
from dress_jax.solver import NewtonOptions
from tests.sim.scenes import SOFT, ball, draped_sheet, level, sheet


@pytest.fixture
def tested(monkeypatch):
    """The cloth positions of every exact test, in turn."""
    seen = []
    original = clean_state.count_intersections

    def counted(positions, *arguments, **options):
        seen.append(np.array(positions))
        return original(positions, *arguments, **options)

    monkeypatch.setattr(clean_state, "count_intersections", counted)
    return seen


def _arrays():
    """A sheet above a ball, as the test takes it."""
    rest, faces = sheet(4, 0.3)
    return level(rest, 0.1), faces, *ball(0.08, 1)


NUDGE = np.array([[0.0, 1e-15, 0.0]])
# Each makes another scene of the same shapes, where the shapes matter at all.
CHANGES = {
    "positions": lambda x, f, b, g, w: (x + NUDGE, f, b, g, w),
    "faces": lambda x, f, b, g, w: (x, f[::-1], b, g, w),
    "fewer faces": lambda x, f, b, g, w: (x, f[:-1], b, g, w),
    "body": lambda x, f, b, g, w: (x, f, b + NUDGE, g, w),
    "body faces": lambda x, f, b, g, w: (x, f, b, g[::-1], w),
    "weld map": lambda x, f, b, g, w: (x, f, b, g, np.arange(len(x))),
}


def test_the_same_arrays_are_tested_once(tested):
    state, arrays = CleanState(), _arrays()
    for _ in range(3):
        assert state.count(*arrays) == state.count(*(np.array(a) for a in arrays))
    assert len(tested) == 1


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_other_arrays_are_tested(tested, change):
    state, arrays = CleanState(), _arrays()
    state.count(*arrays)
    *others, weld_map = change(*arrays, None)
    state.count(*others, weld_map=weld_map)
    assert len(tested) == 2


def test_arrays_written_into_are_tested(tested):
    """Through the body, in place: the state remembered is a copy."""
    state, (x, *others) = CleanState(), _arrays()
    assert state.count(x, *others).body == 0
    x -= np.array([0.0, 0.1, 0.0])
    assert state.count(x, *others).body > 0
    assert len(tested) == 2


def test_what_intersects_is_not_remembered(tested):
    state, (x, *others) = CleanState(), _arrays()
    low = x - np.array([0.0, 0.1, 0.0])
    assert state.count(low, *others) == state.count(low, *others) != state.count(x, *others)
    assert len(tested) == 3


@pytest.fixture(scope="module")
def drape():
    """Simulator, parameters and the drape, of a solve that ends before it converges."""
    cloth, simulator, rest, start, body = draped_sheet()
    simulator.newton = NewtonOptions(iteration_limit=3)
    pins = start[np.asarray(cloth.pins)]
    parameters = make_parameters(cloth, SOFT, rest, body_vertices=body, pin_targets=pins)
    return simulator, parameters, static_solve(simulator, parameters, start).positions


def test_a_warm_start_is_not_tested_again(drape, tested):
    """Neither by the simulator nor by a copy of it, such as a fit makes for every drape."""
    simulator, parameters, x = drape
    heavier = replace(parameters, density=1.01 * parameters.density)
    for copy in (simulator, dataclasses.replace(simulator, newton=simulator.newton)):
        before = len(tested)
        end = static_solve(copy, heavier, x).positions
        assert len(tested) == before + 1  # the end
        np.testing.assert_array_equal(tested[-1], end)
        assert not np.array_equal(x, end)
        x = end


def test_a_start_near_another_body_is_tested(drape, tested):
    """The cloth of the clean state, with the body moved: a little, and into the cloth."""
    simulator, parameters, x = drape
    x = static_solve(simulator, parameters, x).positions
    body = parameters.body_vertices
    tested.clear()
    lower = replace(parameters, body_vertices=body - jnp.asarray([[0.0, 1e-3, 0.0]]))
    static_solve(simulator, lower, x)
    assert len(tested) == 2
    np.testing.assert_array_equal(tested[0], x)
    x = static_solve(simulator, parameters, x).positions
    higher = replace(parameters, body_vertices=body + jnp.asarray([[0.0, 0.03, 0.0]]))
    with pytest.raises(InputError, match="intersect"):
        static_solve(simulator, higher, x)
