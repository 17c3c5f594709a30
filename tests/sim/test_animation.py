"""Cloth on a moving body: inertia, friction, adaptive steps, and exactness (S15.1, S15.4)."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dress_jax.core.errors import InputError
from dress_jax.geometry.intersection import count_intersections
from dress_jax.sim import State, make_cloth, make_simulation, static_solve
from dress_jax.sim.animation import AnimationOptions, advance_frame, renewed
from dress_jax.sim.riding import Carrier, make_riders
from dress_jax.solver import NewtonOptions
from tests.sim.scenes import SOFT, ball, level, sheet

FPS = 30.0
TIGHT = NewtonOptions(tolerance=1e-6, iteration_limit=100)


class Scene:
    """A sheet on a ball, draped, that the ball takes along by friction."""

    def __init__(self, *, friction: float, newton: NewtonOptions = TIGHT, count: int = 9):
        rest, faces = sheet(count, 0.16)
        self.faces, self.edge = faces, 0.16 / (count - 1)
        self.body, self.body_faces = ball(0.08, subdivisions=3)
        fabric = dataclasses.replace(SOFT, friction=friction)
        cloth = make_cloth(faces)
        self.simulator, self.parameters = make_simulation(
            cloth,
            level(rest, 0.083),
            rest,
            fabric=fabric,
            body_vertices=self.body,
            body_faces=self.body_faces,
            friction=friction > 0.0,
            newton=newton,
        )
        start = level(rest, 0.083)
        for _ in range(3):  # three falls from rest
            start = np.asarray(
                static_solve(
                    dataclasses.replace(self.simulator, friction=True),
                    self.parameters,
                    jnp.asarray(start),
                    time_step=0.05,
                ).positions
            )
        self.state = State(jnp.asarray(start), jnp.zeros(start.shape))
        self.carrier = Carrier(faces, self.body_faces, self.edge)
        self.riders = make_riders(np.zeros((0, 3)), self.body, self.body_faces)

    def frame(self, state, before, after, **options):
        return advance_frame(
            renewed(self.simulator),
            self.parameters,
            state,
            before,
            after,
            seconds=1.0 / FPS,
            carrier=self.carrier,
            riders=self.riders,
            options=AnimationOptions(**options),
        )

    def crossings(self, state, body):
        return count_intersections(np.asarray(state.positions), self.faces, body, self.body_faces)


@pytest.fixture(scope="module")
def rough():
    return Scene(friction=0.6)


def test_free_fall_beside_a_moving_body_is_backward_euler(rough):
    """Away from the body the carried start changes nothing: x = x0 + h v, v = v0 + h g."""
    after = rough.body + np.array([0.05, 0.0, 0.0])
    # Flat, so that elasticity has no part in it.
    rest, _ = sheet(9, 0.16)
    flat = level(rest, 1.0)
    state = State(jnp.asarray(flat), jnp.tile(jnp.asarray([[0.3, 0.0, -0.2]]), (len(flat), 1)))
    moved, record = rough.frame(state, rough.body, after)
    h = 1.0 / FPS
    velocity = np.array([0.3, -9.81 * h, -0.2])
    np.testing.assert_allclose(moved.velocities, np.tile(velocity, (len(flat), 1)), atol=1e-3)
    np.testing.assert_allclose(moved.positions, flat + h * velocity, atol=1e-4)
    assert (record.steps, record.blocked, record.unconverged) == (1, 0, 0)


def test_friction_takes_the_cloth_along_and_nothing_else_does(rough):
    """The ball moves off sideways, slowly enough to stick; a smooth one leaves the cloth behind."""
    smooth = Scene(friction=0.0)
    ways = {}
    for name, scene in (("rough", rough), ("smooth", smooth)):
        state, body = scene.state, scene.body
        for number in range(1, 9):
            # 0.5 m/s^2, against mu g = 5.9 m/s^2.
            after = scene.body + np.array([0.25 * (number / FPS) ** 2, 0.0, 0.0])
            state, record = scene.frame(state, body, after)
            body = after
            assert scene.crossings(state, body) == record_counts(record) == ZERO
        ways[name] = np.asarray(state.positions - scene.state.positions)[:, 0].mean()
    ball_way = 0.25 * (8 / FPS) ** 2
    assert ways["rough"] == pytest.approx(ball_way, rel=0.1)
    assert ways["smooth"] < 0.5 * ways["rough"]


ZERO = count_intersections(np.zeros((0, 3)), np.zeros((0, 3), int))


def record_counts(record):
    return dataclasses.replace(ZERO, self=record.self_intersections, body=record.body_intersections)


def test_a_ball_that_spins_under_the_cloth_turns_it(rough):
    state, body = rough.state, rough.body
    for number in range(1, 5):
        turn = Rotation.from_rotvec([0.0, 0.02 * number, 0.0])
        after = turn.apply(rough.body)
        state, _ = rough.frame(state, body, after)
        body = after
    # About +y, which takes +z to +x.
    start, end = np.asarray(rough.state.positions), np.asarray(state.positions)
    sine = np.sum(start[:, 2] * end[:, 0] - start[:, 0] * end[:, 2])
    angle = np.arctan2(sine, np.sum(start[:, [0, 2]] * end[:, [0, 2]]))
    assert angle == pytest.approx(0.08, rel=0.25)


class StandStill:
    """Carries nothing."""

    def motion(self, cloth, before, after):
        return np.zeros_like(cloth)


def test_a_body_that_comes_through_pushes_the_cloth_ahead(rough):
    """Nothing carried, a fast rise: the way is blocked, steps are halved, the cloth is squeezed.

    Every state on the way is tested, not only the last one.
    """
    scene, seen = rough, []
    simulator = dataclasses.replace(
        scene.simulator, observer=lambda x, b: seen.append((np.array(x), np.array(b)))
    )
    after = scene.body + np.array([0.0, 0.08, 0.0])
    state, record = advance_frame(
        renewed(simulator),
        scene.parameters,
        scene.state,
        scene.body,
        after,
        seconds=1.0 / FPS,
        carrier=StandStill(),
        riders=scene.riders,
        options=AnimationOptions(halvings=2),
    )
    assert record.blocked >= 2
    assert record.squeezed >= 1
    assert scene.crossings(state, after) == ZERO
    assert np.asarray(state.positions)[:, 1].max() > 0.15
    assert len(seen) > 10
    for x, body in seen:
        assert count_intersections(x, scene.faces, body, scene.body_faces) == ZERO


def test_a_step_that_does_not_converge_is_halved_and_counted():
    scene = Scene(friction=0.3, newton=NewtonOptions(tolerance=1e-12, iteration_limit=2))
    after = scene.body + np.array([0.01, 0.01, 0.0])
    state, record = scene.frame(scene.state, scene.body, after, halvings=2)
    assert record.halved >= 1
    assert record.unconverged >= 1
    assert record.tried_iterations > record.newton_iterations > 0
    assert scene.crossings(state, after) == ZERO


def test_a_frame_depends_on_the_state_alone(rough):
    """What a simulator has learned from other frames does not enter: the basis of exact resume."""
    after = rough.body + np.array([0.02, 0.01, 0.0])
    fresh, _ = rough.frame(rough.state, rough.body, after)
    used, _ = rough.frame(rough.state, rough.body, rough.body + np.array([0.0, 0.02, 0.03]))
    again, _ = rough.frame(rough.state, rough.body, after)
    assert not np.array_equal(fresh.positions, used.positions)
    np.testing.assert_array_equal(fresh.positions, again.positions)
    np.testing.assert_array_equal(fresh.velocities, again.velocities)


def test_riders_keep_their_place_on_a_body_that_turns():
    body, faces = ball(0.5, subdivisions=3)
    rng = np.random.default_rng(0)
    points = rng.normal(size=(20, 3))
    points *= (0.55 / np.linalg.norm(points, axis=1))[:, None]
    riders = make_riders(points, body, faces)
    np.testing.assert_allclose(riders.places(body), points, atol=1e-12)
    turn = Rotation.from_rotvec([0.3, -0.5, 0.9])
    moved = turn.apply(body) + np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(
        riders.places(moved), turn.apply(points) + np.array([1, 2, 3]), atol=1e-12
    )


def test_cloth_is_carried_rigidly_by_a_rigid_motion():
    """Near the body by its triangles, far from it by its motion as a whole."""
    body, body_faces = ball(0.2, subdivisions=3)
    rest, faces = sheet(15, 0.8)
    cloth = level(rest, 0.204)
    turn = Rotation.from_rotvec([0.02, 0.1, -0.05])
    after = turn.apply(body) + np.array([0.03, 0.0, 0.02])
    u = Carrier(faces, body_faces, 0.8 / 14).motion(cloth, body, after)
    expected = turn.apply(cloth) + np.array([0.03, 0.0, 0.02]) - cloth
    # Below a vertex is a point of the surface, a few millimetres closer to the axis.
    np.testing.assert_allclose(u, expected, atol=1.5e-3)


def test_bad_options_are_refused():
    with pytest.raises(InputError, match="at least one step"):
        AnimationOptions(steps=0)
