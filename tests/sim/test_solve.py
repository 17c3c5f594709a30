"""Solves: physics in closed form, guarantees, and errors."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.energy.fabric import make_parameters
from dress_jax.geometry.intersection import count_intersections
from dress_jax.sim import State, make_cloth, make_simulator, static_solve, step
from dress_jax.solver import NewtonOptions
from tests.sim.scenes import SOFT, ball, draped_sheet, level, sheet

EXACT = 1e-9  # of solves whose answer is exact: the Newton tolerance


def test_free_fall_is_backward_euler():
    """S1.3, S1.12: after k steps the sheet fell g h^2 k (k + 1) / 2."""
    rest, faces = sheet(4, 0.2)
    cloth = make_cloth(faces)
    start = level(rest, 1.0)
    simulator = make_simulator(cloth, start, newton=NewtonOptions(tolerance=1e-10))
    parameters = make_parameters(cloth, SOFT, rest)
    state = State(jnp.asarray(start), jnp.zeros_like(jnp.asarray(start)))
    h = 0.01
    for _ in range(3):
        state, report = step(simulator, state, parameters, time_step=h)
        assert report.converged
    fallen = 9.81 * h**2 * 3 * 4 / 2
    assert np.allclose(np.asarray(state.positions), start - [0, fallen, 0], atol=EXACT, rtol=0)
    assert np.allclose(np.asarray(state.velocities), [0, -9.81 * 3 * h, 0], atol=1e-7, rtol=0)


def test_every_iterate_is_free_of_intersections():
    """S1.10, S1.11: the energy falls monotonically and no iterate intersects."""
    cloth, simulator, rest, start, body = draped_sheet()
    energies, counts = [], []
    faces = np.asarray(cloth.faces).T

    def watch(progress):
        energies.append(progress.energy)
        counts.append(count_intersections(progress.positions, faces, body, simulator.body_faces))

    simulator.progress = watch
    parameters = make_parameters(
        cloth, SOFT, rest, body_vertices=body, pin_targets=start[np.asarray(cloth.pins)]
    )
    result = static_solve(simulator, parameters, start)
    assert result.report.converged
    assert len(counts) == int(result.report.iterations) > 5
    assert all(count.self == 0 and count.body == 0 for count in counts)
    slack = 1e-12 * abs(energies[-1])
    assert all(late <= early + slack for early, late in itertools.pairwise(energies))
    assert float(result.report.smallest_distance) > float(simulator.settings.thickness)


def test_hanging_strip_has_the_length_of_a_bar():
    """A strip under its own weight stretches by rho g L^2 / (2 E t), whatever h is (S1.5)."""
    count, size = 9, 0.4
    rest, faces = sheet(count, size)
    top = np.arange(count) * count + count - 1
    cloth = make_cloth(faces, pins=top)
    start = np.stack([rest[:, 0], rest[:, 1], np.zeros(len(rest))], axis=1)
    simulator = make_simulator(cloth, start, newton=NewtonOptions(tolerance=1e-9))
    parameters = replace(
        make_parameters(cloth, SOFT, rest, pin_targets=start[top]), pin_stiffness=jnp.asarray(1e5)
    )
    # ARAP has no Poisson effect, so E t = 2 k_s.
    expected = 0.2 * 9.81 * size**2 / (2 * 2 * 100.0)
    for time_step in (1.0, 10.0, None):
        result = static_solve(simulator, parameters, start, time_step=time_step)
        assert result.report.converged
        bottom = np.asarray(result.positions)[np.arange(count) * count, 1]
        stretch = start[0, 1] - bottom.mean()
        # 3 %: the sum over eight rows of triangles against the integral; 1 s of inertia adds
        # the missing part of the last oscillation.
        assert stretch == pytest.approx(expected, rel=0.03)


def test_runs_are_bitwise_equal():
    cloth, simulator, rest, start, body = draped_sheet()
    parameters = make_parameters(
        cloth, SOFT, rest, body_vertices=body, pin_targets=start[np.asarray(cloth.pins)]
    )
    first = static_solve(simulator, parameters, start).positions
    second = static_solve(simulator, parameters, start).positions
    assert np.array_equal(np.asarray(first), np.asarray(second))


def test_start_in_contact_is_refused():
    rest, faces = sheet(6, 0.3)
    start = level(rest, 0.05)  # through the ball
    body, body_faces = ball(0.08)
    cloth = make_cloth(faces)
    simulator = make_simulator(cloth, start, body_vertices=body, body_faces=body_faces)
    parameters = make_parameters(cloth, SOFT, rest, body_vertices=body)
    with pytest.raises(InputError, match="intersect"):
        static_solve(simulator, parameters, start)


def test_nonfinite_parameters_are_named():
    cloth, simulator, rest, start, body = draped_sheet()
    parameters = make_parameters(
        cloth, SOFT, rest, body_vertices=body, pin_targets=start[np.asarray(cloth.pins)]
    )
    bad = replace(parameters, density=jnp.asarray(np.nan))
    with pytest.raises(InputError, match="density"):
        static_solve(simulator, bad, start)


def test_jit_is_refused_with_the_way_out():
    cloth, simulator, rest, start, body = draped_sheet()
    parameters = make_parameters(
        cloth, SOFT, rest, body_vertices=body, pin_targets=start[np.asarray(cloth.pins)]
    )
    with pytest.raises(TypeError, match="outside of them"):
        jax.jit(lambda p: static_solve(simulator, p, start).positions)(parameters)


def test_iteration_limit_is_reported():
    cloth, simulator, rest, start, body = draped_sheet()
    simulator.newton = NewtonOptions(iteration_limit=2)
    parameters = make_parameters(
        cloth, SOFT, rest, body_vertices=body, pin_targets=start[np.asarray(cloth.pins)]
    )
    report = static_solve(simulator, parameters, start).report
    assert not report.converged
    assert report.intersection_free
