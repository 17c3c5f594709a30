"""A solve with pairs found and selected on the device is that with pairs found on the host."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.contact.device_search import columns, search
from dress_jax.contact.device_trees import fit
from dress_jax.contact.potential import PairKind, Pairs
from dress_jax.core.errors import InputError
from dress_jax.energy.fabric import make_parameters
from dress_jax.sim import State, make_cloth, make_simulator, selection, static_solve, step
from dress_jax.sim.dressing.motion import motion_bound
from tests.sim.scenes import SOFT, ball, draped_sheet, level, sheet


def _scene(broad_phase, **options):
    cloth, simulator, rest, start, body = draped_sheet(14, broad_phase=broad_phase, **options)
    return simulator, _parameters(cloth, rest, start, body), start


def _parameters(cloth, rest, start, body):
    pins = jnp.asarray(start[np.asarray(cloth.pins)])
    return make_parameters(
        cloth, SOFT, jnp.asarray(rest), body_vertices=jnp.asarray(body), pin_targets=pins
    )


@pytest.mark.slow
def test_a_drape_is_the_same():
    """Bit by bit: the lists hold the same pairs in the same order."""
    found, slopes = [], []
    for name in ("trees", "device"):
        simulator, parameters, start = _scene(name)
        assert simulator.broad_phase.name == name

        def height(p, simulator=simulator, start=start):
            solution = static_solve(simulator, p, jnp.asarray(start))
            return jnp.sum(solution.positions[:, 1]), solution

        (_, solution), slope = jax.value_and_grad(height, has_aux=True)(parameters)
        assert solution.report.intersection_free
        reach = float(simulator.settings.dhat + simulator.settings.thickness)
        assert float(solution.report.smallest_distance) < reach  # in contact
        found.append(solution)
        slopes.append(slope)
    np.testing.assert_array_equal(found[0].positions, found[1].positions)
    assert int(found[0].report.iterations) == int(found[1].report.iterations)
    for one, other in zip(*map(jax.tree.leaves, slopes), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_a_step_with_friction_is_the_same():
    found = []
    for name in ("trees", "device"):
        simulator, parameters, start = _scene(name, friction=True, tolerance=1e-6)
        state = State(jnp.asarray(start), jnp.zeros(start.shape))
        for _ in range(2):
            state, report = step(simulator, state, parameters, time_step=0.05)
        assert report.intersection_free
        found.append(np.asarray(state.positions))
    np.testing.assert_array_equal(*found)


def test_a_motion_of_the_body_has_the_same_bound():
    found = []
    for name in ("trees", "device"):
        simulator, parameters, start = _scene(name)
        body = np.asarray(parameters.body_vertices)
        up = np.zeros_like(body)
        up[:, 1] = 0.05
        found.append(motion_bound(simulator, start, np.zeros_like(start), body, up))
    assert 0.0 < found[0] < 1.0
    assert found[0] == found[1]


@pytest.mark.slow
def test_another_garment_of_similar_size_compiles_nothing():
    body, body_faces = ball(0.08)

    def drape(count: int):
        rest, faces = sheet(count, 0.3)
        cloth = make_cloth(faces, pins=np.array([0, count - 1]))
        start = level(rest, 0.085)
        simulator = make_simulator(
            cloth, start, body_vertices=body, body_faces=body_faces, broad_phase="device"
        )
        parameters = _parameters(cloth, rest, start, body)
        solution = static_solve(simulator, parameters, jnp.asarray(start))
        assert solution.report.intersection_free

    programs = (fit, search, columns, selection._compacted, selection._parted)
    drape(15)
    before = [program._cache_size() for program in programs]
    assert all(before)
    drape(14)
    assert [program._cache_size() for program in programs] == before


@pytest.mark.parametrize("kept", [0, 5, 300])
def test_pairs_are_selected_alike_on_host_and_device(kept):
    rng = np.random.default_rng(0)
    capacity, count = 512, 400
    indices = np.zeros((4, capacity), np.int32)
    indices[:, :count] = rng.integers(0, 99, (4, count))
    pairs = Pairs(
        jnp.asarray(indices),
        jnp.asarray(count, jnp.int32),
        jnp.asarray(rng.uniform(size=capacity)),
        PairKind.EDGE_EDGE,
    )
    mask = np.zeros(capacity, bool)
    mask[rng.choice(count, kept, replace=False)] = True
    one, other = (
        selection.selected(pairs, jnp.asarray(mask), on_device=on_device, smallest=16)
        for on_device in (False, True)
    )
    assert int(one.count) == kept
    np.testing.assert_array_equal(np.asarray(one.indices)[:, :kept], indices[:, mask])
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
    # Where the list is padded, a mask may say anything.
    anything = jnp.asarray(mask).at[count:].set(True)
    for on_device in (False, True):
        outside, inside = selection.separated(pairs, anything, on_device=on_device, smallest=16)
        assert (int(outside.count), int(inside.count)) == (count - kept, kept)
        np.testing.assert_array_equal(inside.indices, one.indices)


def test_an_unknown_name_is_refused():
    with pytest.raises(InputError, match="there is no broad phase 'boxes'"):
        _scene("boxes")
