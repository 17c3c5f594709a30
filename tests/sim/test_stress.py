"""Stress scenes: every state is free of intersections by ipctk, and every run is the same."""

import dataclasses
import functools

import ipctk
import numpy as np
import pytest

from benchmarks.stress_scenes import SCENES, play
from benchmarks.stress_scenes.scene import make_scene
from benchmarks.stress_scenes.shapes import ball, copies, graded, level, sheet


class Oracle:
    """ipctk's test of one scene; the body may intersect itself."""

    def __init__(self) -> None:
        self._mesh: ipctk.CollisionMesh | None = None

    def __call__(self, positions, faces, body, body_faces) -> bool:
        everything = np.concatenate([positions, body])
        if self._mesh is None:
            triangles = np.concatenate([faces, body_faces + len(positions)]).astype(np.int32)
            self._mesh = ipctk.CollisionMesh(everything, ipctk.edges(triangles), triangles)
            self._mesh.can_collide = ipctk.make_static_obstacle_filter(len(positions))
        return not ipctk.has_intersections(self._mesh, everything)


def _run(name: str, *, fine: int, runs: int) -> None:
    outcomes = [play(functools.partial(SCENES[name], fine), Oracle()) for _ in range(runs)]
    for outcome in outcomes:
        assert outcome.intersecting == 0
        assert outcome.states > 15 and outcome.moved > 0.005  # something went on
    assert len({outcome.digest for outcome in outcomes}) == 1


# Those that take longest, most of it to compile, are left to the slow tests.
LONG = (
    *("ten_layers", "arm_to_torso", "slivers", "through_a_ring", "between_plates", "many_sizes"),
    *("coincident", "twisted_cylinder"),
)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in SCENES]
)
def test_small_scenes(name):
    _run(name, fine=1, runs=2)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_full_scenes(name):
    _run(name, fine=4, runs=3)


def test_the_player_sees_intersections():
    """Of the three states that it is shown, the start among them, one intersects."""
    rest, faces = sheet(3, 0.1)
    start = np.concatenate([level(rest, 0.1), level(rest, 0.2)])

    def act(simulator, parameters, positions):
        body = np.asarray(parameters.body_vertices)
        crossing = positions.copy()
        crossing[:9, 1] += 0.1 + 2.0 * crossing[:9, 0]
        simulator.observer(crossing, body)
        simulator.observer(positions, body)
        return positions

    def make():
        return make_scene(*copies(rest, faces, 2), start, act)

    outcome = play(make, Oracle())
    assert (outcome.states, outcome.intersecting) == (3, 1)
    # One bit is enough for another digest.
    moved = start.copy()
    moved[0, 0] = np.nextafter(moved[0, 0], 1.0)

    def other():
        return dataclasses.replace(make(), positions=moved)

    assert play(other, Oracle()).digest != outcome.digest == play(make, Oracle()).digest


def test_scenes_hold_what_they_promise():
    """Sizes from 1 to 50, slivers, and a body that is closed."""
    rest, faces = graded(10, 50.0, 0.3)
    corners = rest[faces]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    assert lengths.max() > 50.0 * lengths.min()
    rest, faces = graded(8, 30.0, 0.15, slivers=True)
    corners = rest[faces]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    heights = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / lengths
    assert np.sum(lengths > 50.0 * heights) >= 5
    assert lengths.min() < 0.005
    assert len(ball(0.1)[1]) == 320
