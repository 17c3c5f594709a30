"""Whole solves against closed forms of mechanics."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.contact.barrier import contact_settings
from dress_jax.core.pytree import replace
from dress_jax.energy.elastic import TimeStep
from dress_jax.energy.fabric import Fabric, make_parameters
from dress_jax.sim import (
    State,
    make_cloth,
    make_simulation,
    make_simulator,
    static_solve,
    step,
)
from dress_jax.sim.inputs import StepInputs
from dress_jax.sim.objective import StepObjective
from dress_jax.solver import NewtonOptions
from tests.sim.scenes import SOFT, draped_sheet, level, sheet

WEIGHT = 9.81
# Friction on an incline.
MU, STEP, STEPS = 0.3, 0.02, 20
CARD = Fabric(density=0.2, stretching_stiffness=1000.0, bending_stiffness=1e-3, friction=MU)


def _at_rest(positions) -> State:
    return State(jnp.asarray(positions), jnp.zeros_like(jnp.asarray(positions)))


@pytest.fixture(scope="module")
def lying():
    """A small card at rest on one large triangle: simulator, parameters, positions."""
    rest, faces = sheet(4, 0.1)
    cloth = make_cloth(faces)
    start = level(rest, 0.0025)
    ground = np.array([[-3.0, 0.0, -2.0], [0.0, 0.0, 4.0], [3.0, 0.0, -2.0]])
    simulator = make_simulator(
        cloth,
        start,
        body_vertices=ground,
        body_faces=np.array([[0, 1, 2]]),
        newton=NewtonOptions(tolerance=1e-9),
        friction=True,
    )
    parameters = make_parameters(cloth, CARD, rest, body_vertices=ground)
    state = _at_rest(start)
    for _ in range(10):
        state, report = step(simulator, state, parameters, time_step=0.1)
        state = _at_rest(state.positions)
    assert report.converged and float(report.residual) < 1e-7
    return simulator, parameters, state.positions


def _slid(lying, tangent: float) -> float:
    """How far the card has slid along x when gravity is tilted by an angle of that tangent [m].

    The weight across the ground stays what it is, so the normal forces do too.
    """
    simulator, parameters, start = lying
    tilted = replace(parameters, gravity=jnp.asarray([WEIGHT * tangent, -WEIGHT, 0.0]))
    state = _at_rest(start)
    for _ in range(STEPS):
        state, report = step(simulator, state, tilted, time_step=STEP)
        assert report.converged and report.intersection_free
    moved = np.asarray(state.positions - start)
    assert np.ptp(moved[:, 0]) < 1e-4  # as a whole
    return float(moved[:, 0].mean())


def test_a_card_sticks_below_the_angle_of_friction(lying):
    """S1.16: it creeps, slower than the speed below which friction is smoothed."""
    slip_speed = float(lying[0].settings.slip_speed)
    slid = _slid(lying, 0.98 * MU)
    assert 0.0 < slid < slip_speed * STEPS * STEP


@pytest.mark.parametrize("excess", [1.05, pytest.param(1.5, marks=pytest.mark.slow)])
def test_a_card_slides_above_the_angle_of_friction(lying, excess):
    """S1.16: with the acceleration g (tan - mu), summed as backward Euler does."""
    acceleration = WEIGHT * MU * (excess - 1.0)
    expected = acceleration * STEP**2 * STEPS * (STEPS + 1) / 2
    # Until it is faster than the slip speed, it is held back by less than mu.
    slack = float(lying[0].settings.slip_speed) * STEPS * STEP
    slid = _slid(lying, excess * MU)
    assert slid == pytest.approx(expected, rel=0.02, abs=slack)
    assert slid > 5.0 * slack


def _strip(columns: int, edge: float):
    """Rest positions (n, 2) and faces: nine rows of equilateral triangles, clamped up to 0."""
    index, rest, faces = {}, [], []
    for row in range(9):
        for column in range(-2, columns + 1):
            index[column, row] = len(rest)
            rest.append(((column + 0.5 * (row % 2)) * edge, row * edge * 0.75**0.5))
    for row in range(8):
        for column in range(-2, columns):
            a, b = index[column, row], index[column + 1, row]
            c, d = index[column, row + 1], index[column + 1, row + 1]
            faces += [[a, b, c], [b, d, c]] if row % 2 == 0 else [[a, b, d], [a, d, c]]
    return np.array(rest), np.array(faces)


def _tip(columns: int, length: float, fabric: Fabric) -> float:
    """Deflection of the free end of a horizontal strip that is clamped at the other [m]."""
    edge = length / columns
    rest, faces = _strip(columns, edge)
    start = level(rest, 0.5)
    clamped = np.nonzero(rest[:, 0] < 0.01 * edge)[0]
    cloth = make_cloth(faces, pins=clamped)
    simulator = make_simulator(
        cloth,
        start,
        settings=contact_settings(dhat=0.1 * edge, thickness=0.01 * edge),
        newton=NewtonOptions(tolerance=1e-9),
    )
    parameters = replace(
        make_parameters(cloth, fabric, rest, pin_targets=start[clamped]),
        pin_stiffness=jnp.asarray(1e6),
    )
    result = static_solve(simulator, parameters, start, time_step=None)
    assert result.report.converged
    end = np.abs(rest[:, 0] - length) < 0.3 * edge
    return 0.5 - float(np.asarray(result.positions)[end, 1].mean())


@pytest.mark.slow
def test_a_cantilever_bends_as_a_beam_and_converges():
    """The tip sinks by rho g L^4 / (8 B (1 - nu^2)) for small deflections (S1.8).

    Hinges in three directions make a plate with a Poisson ratio of a third.
    """
    length, rigidity = 0.05, 1e-3
    fabric = Fabric(density=0.2, stretching_stiffness=1000.0, bending_stiffness=rigidity)
    expected = 0.2 * WEIGHT * length**4 / (8.0 * rigidity * (1.0 - 1.0 / 9.0))
    assert expected < 0.05 * length
    errors = [abs(_tip(columns, length, fabric) / expected - 1.0) for columns in (10, 20, 40)]
    assert errors[2] < 0.03
    assert errors[0] > 2.0 * errors[1] > 4.0 * errors[2]


def test_energy_decays():
    """Backward Euler only ever takes energy out, through contact too."""
    cloth, simulator, rest, start, body = draped_sheet(tolerance=1e-8)
    pins = start[np.asarray(cloth.pins)]
    parameters = make_parameters(cloth, SOFT, rest, body_vertices=body, pin_targets=pins)
    still = jnp.zeros_like(jnp.asarray(start))
    resting = TimeStep(jnp.asarray(start), still, jnp.asarray(0.0))

    def total(state: State) -> float:
        objective = StepObjective(
            simulator, StepInputs(resting, parameters, parameters.body_vertices)
        )
        speeds = np.sum(np.asarray(state.velocities) ** 2, axis=1)
        kinetic = 0.5 * float(np.sum(objective.masses * speeds))
        return kinetic + objective.value(np.asarray(state.positions))

    state, energies, nearest = _at_rest(start), [], np.inf
    for _ in range(15):
        energies.append(total(state))
        state, report = step(simulator, state, parameters, time_step=0.01)
        assert report.converged and report.intersection_free
        nearest = min(nearest, float(report.smallest_distance))
    energies.append(total(state))
    assert nearest < float(simulator.settings.dhat + simulator.settings.thickness)
    assert energies[0] - energies[-1] > 1e-4
    assert all(late < early + 1e-9 for early, late in itertools.pairwise(energies))


@pytest.mark.parametrize(("edge", "expected"), [(0.02, 3e-3), (0.0025, 1.25e-3)])
def test_the_barrier_does_not_reach_the_next_vertex(edge, expected):
    """Or it would push on every triangle's neighbours, and a fine cloth would be a board."""
    rest, faces = sheet(5, 4 * edge)
    cloth = make_cloth(faces)
    simulator, _ = make_simulation(
        cloth,
        level(rest, 1.0),
        rest,
        fabric=CARD,
        body_vertices=np.eye(3),
        body_faces=np.array([[0, 1, 2]]),
    )
    settings = simulator.settings
    assert float(settings.dhat) == pytest.approx(expected)
    assert float(settings.thickness) == pytest.approx(0.1 * expected)
