"""Bodies that run through themselves or close in on the cloth: a body is a one-way collider."""

import dataclasses
import time

import ipctk
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dress_jax.body.model import forward, named_shape
from dress_jax.body.poses import a_pose
from dress_jax.body.skeleton import joint_index
from dress_jax.core.errors import InputError
from dress_jax.energy.cloth import Gravity, make_cloth
from dress_jax.energy.fabric import make_parameters
from dress_jax.energy.panels import FacePanels
from dress_jax.geometry.intersection import (
    count_intersections,
    edge_face_intersections,
    minimum_distance,
)
from dress_jax.geometry.topology import unique_edges
from dress_jax.io.bodies import load_default_body
from dress_jax.sim import make_simulator, static_solve
from dress_jax.sim.dressing.motion import follow_body
from dress_jax.solver import NewtonOptions
from tests.sim.scenes import SOFT, ball, level, sheet

# Compilation included, on a machine that is busy with other things; a hang takes for ever.
PATIENCE = 240.0
RIGHT, UP = np.array([0.035, 0.0, 0.0]), np.array([0.0, 0.03, 0.0])


def _oracle_is_clean(x, faces, body, body_faces) -> bool:
    """Whether ipctk finds no intersection but those of the body with itself."""
    everything = np.concatenate([x, body])
    triangles = np.concatenate([faces, body_faces + len(x)]).astype(np.int32)
    mesh = ipctk.CollisionMesh(everything, ipctk.edges(triangles), triangles)
    mesh.can_collide = ipctk.make_static_obstacle_filter(len(x))
    return not ipctk.has_intersections(mesh, everything)


def _drape(rest, faces, start, body, body_faces, pins):
    cloth = make_cloth(faces, pins=pins)
    simulator = make_simulator(
        cloth,
        start,
        body_vertices=body,
        body_faces=body_faces,
        newton=NewtonOptions(tolerance=1e-5, iteration_limit=300),
    )
    parameters = make_parameters(cloth, SOFT, rest, body_vertices=body, pin_targets=start[pins])
    return simulator, static_solve(simulator, parameters, jnp.asarray(start))


def _assert_draped(faces, result, simulator, body, body_faces) -> None:
    """Converged, in contact with the body, and clean although the body is not."""
    assert len(edge_face_intersections(body, unique_edges(body_faces), body_faces)) > 0
    report, settings = result.report, simulator.settings
    assert report.converged and report.intersection_free
    assert float(report.smallest_distance) < float(settings.dhat + settings.thickness)
    x = np.asarray(result.positions)
    counts = count_intersections(x, faces, body, body_faces)
    assert (counts.self, counts.body) == (0, 0)
    assert _oracle_is_clean(x, faces, body, body_faces)


@pytest.mark.slow
def test_cloth_over_two_overlapping_spheres():
    vertices, triangles = ball(0.06)
    body = np.concatenate([vertices - RIGHT, vertices + RIGHT])
    body_faces = np.concatenate([triangles, triangles + len(vertices)])
    rest, faces = sheet(9, 0.24)
    start = level(rest, 0.08)
    pins = np.array([0, 8, 72, 80])
    simulator, result = _drape(rest, faces, start, body, body_faces, pins)
    _assert_draped(faces, result, simulator, body, body_faces)
    # It lies on both.
    x, settings = np.asarray(result.positions), simulator.settings
    for own in (vertices - RIGHT, vertices + RIGHT):
        distance = minimum_distance(x, faces, own, triangles)
        assert distance < float(settings.dhat + settings.thickness)


def test_cloth_over_crossing_thighs():
    """The default body on its back, with its thighs through each other."""
    model = load_default_body()
    pose = a_pose()
    for side, sign in (("left", -1.0), ("right", 1.0)):
        pose[joint_index(f"{side}_hip"), 2] = sign * np.radians(18.0)
    shape = jnp.asarray(named_shape(model, "average"))
    standing = np.array(forward(model, jnp.asarray(pose), shape, jnp.zeros(3)).vertices)
    body, body_faces = (
        Rotation.from_euler("x", -90.0, degrees=True).apply(standing),
        np.asarray(model.faces),
    )
    # From head to feet is now along z; the thighs are a third of the way up from the feet.
    along = body[:, 2]
    thighs = along.max() - 0.38 * np.ptp(along)
    near = body[(np.abs(along - thighs) < 0.12) & (np.abs(body[:, 0]) < 0.12)]
    rest, faces = sheet(9, 0.24)
    start = level(rest, near[:, 1].max() + 0.01) + np.array([0.0, 0.0, thighs])
    pins = np.array([0, 8, 72, 80])
    simulator, result = _drape(rest, faces, start, body, body_faces, pins)
    _assert_draped(faces, result, simulator, body, body_faces)


def _closing(parts, gap):
    """A sheet between two body parts, one at each side, and the body once they have closed."""
    vertices, triangles = parts
    rest, faces = sheet(6, 0.1)
    body = np.concatenate([vertices + UP, vertices * [1.0, -1.0, 1.0] - UP])
    body_faces = np.concatenate([triangles, triangles[:, ::-1] + len(vertices)])
    closed = body.copy()
    closed[: len(vertices), 1] -= UP[1] - gap / 2
    closed[len(vertices) :, 1] += UP[1] - gap / 2
    cloth = make_cloth(faces)
    simulator = make_simulator(
        cloth,
        level(rest, 0.0),
        body_vertices=body,
        body_faces=body_faces,
        panels=FacePanels(("pocket",), np.zeros(len(faces), int)),
    )
    parameters = make_parameters(cloth, SOFT, rest, body_vertices=body, gravity=Gravity.NONE)
    return simulator, parameters, level(rest, 0.0), closed


def _half_ball():
    """A ball whose lowest point is the origin."""
    vertices, triangles = ball(0.05)
    return vertices + np.array([0.0, 0.05, 0.0]), triangles


def _plate():
    """A large triangle in the plane y = 0."""
    return np.array([[-0.3, 0.0, -0.2], [0.3, 0.0, -0.2], [0.0, 0.0, 0.4]]), np.array([[0, 1, 2]])


@pytest.mark.parametrize("parts", [_half_ball, pytest.param(_plate, marks=pytest.mark.slow)])
@pytest.mark.parametrize("gap", [pytest.param(2e-4, marks=pytest.mark.slow), -0.01])
def test_pinched_cloth_ends_in_a_report(parts, gap):
    """Parts that close to less than the thickness on each side, or through each other."""
    simulator, parameters, start, closed = _closing(parts(), gap)
    seen = []

    def look(x, body):
        faces = np.asarray(simulator.cloth.faces).T
        seen.append(_oracle_is_clean(x, faces, body, simulator.body_faces))

    simulator.observer = look
    began = time.perf_counter()
    with pytest.raises(InputError, match=r"cannot move on|less than the thickness") as caught:
        follow_body(simulator, parameters, start, closed[None])
    assert time.perf_counter() - began < PATIENCE
    assert "['pocket']" in caught.value.where and "near (" in caught.value.where
    assert len(seen) > 5 and all(seen)


def test_cloth_between_parts_that_leave_it_room_is_no_fault():
    simulator, parameters, start, closed = _closing(_half_ball(), 4e-3)
    x = follow_body(simulator, parameters, start, closed[None])
    counts = count_intersections(
        x, np.asarray(simulator.cloth.faces).T, closed, simulator.body_faces
    )
    assert (counts.self, counts.body) == (0, 0)


def test_only_contacts_with_the_cloth_count():
    """A body that crosses itself far from the cloth is no fault of the start."""
    vertices, triangles = ball(0.05)
    body = np.concatenate([vertices, vertices + RIGHT])
    body_faces = np.concatenate([triangles, triangles + len(vertices)])
    rest, faces = sheet(3, 0.1)
    cloth = make_cloth(faces)
    simulator = make_simulator(cloth, level(rest, 1.0), body_vertices=body, body_faces=body_faces)
    simulator = dataclasses.replace(simulator, newton=NewtonOptions(iteration_limit=1))
    parameters = make_parameters(cloth, SOFT, rest, body_vertices=body)
    report = static_solve(simulator, parameters, level(rest, 1.0)).report
    assert int(report.body_intersections) == 0 and int(report.iterations) == 1
