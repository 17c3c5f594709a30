"""Cameras: the generators' numbers, projections, dictionaries."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from dress_jax.core.errors import InputError
from dress_jax.render.cameras import (
    CameraKind,
    cameras_from_dict,
    cameras_to_dict,
    look_at_camera,
    orthographic_camera,
    perspective_camera,
    project,
    stack_cameras,
    unstack_cameras,
)
from dress_jax.render.rings import frame_body, magicman_cameras, pshuman_cameras

POINTS = jnp.asarray(np.random.default_rng(0).uniform(-0.5, 0.5, (7, 3)))


def test_magicman_numbers():
    """The unit frame of the published model: 20 views, 18 degrees apart, 512 pixels."""
    cameras = magicman_cameras(20, center=np.zeros(3), half_extent=1.0, size=512, distance=100.0)
    assert len(cameras) == 20
    for index, camera in enumerate(cameras):
        a = np.deg2rad(-18.0 * index)
        toward = np.array([np.sin(a), 0.0, np.cos(a)])
        right = np.array([np.cos(a), 0.0, -np.sin(a)])
        np.testing.assert_allclose(camera.position, 100 * toward, atol=1e-12)
        np.testing.assert_allclose(camera.rotation, [right, [0, 1, 0], toward], atol=1e-12)
        column, row, depth = project(camera, POINTS)
        points = np.asarray(POINTS)
        np.testing.assert_allclose(column, (1 + points @ right) * 256 - 0.5, atol=1e-9)
        np.testing.assert_allclose(row, (1 - points[:, 1]) * 256 - 0.5, atol=1e-9)
        np.testing.assert_allclose(depth, 100 - points @ toward, atol=1e-9)
    # Negative azimuth: the second camera stands at -x.
    assert cameras[1].position[0] < -1
    assert len(magicman_cameras(24, center=np.zeros(3), half_extent=1.0)) == 24


def test_pshuman_positive_azimuth_is_plus_x():
    cameras = pshuman_cameras(center=np.zeros(3), half_extent=2.0)
    assert cameras[0].height == 1024 and len(cameras) == 6
    assert cameras[1].position[0] > 1 and cameras[4].position[0] < -1


def test_frame_body_fills_the_frame():
    body = np.array([[-0.4, 0.0, -0.1], [0.4, 1.7, 0.1], [0.0, 0.9, 0.15], [0.0, 0.9, -0.15]])
    center, half_extent = frame_body(body)
    np.testing.assert_allclose(center, [0.0, 0.85, 0.0])
    assert 1.7 / (2 * half_extent) == pytest.approx(0.925)
    _, wide = frame_body(body * [10.0, 1.0, 1.0])
    for camera in magicman_cameras(8, center=center, half_extent=wide, size=100):
        column, row, _ = project(camera, jnp.asarray(body * [10.0, 1.0, 1.0]))
        assert column.min() >= -0.5 and column.max() <= 99.5
        assert row.min() >= -0.5 and row.max() <= 99.5
    with pytest.raises(InputError, match="shape"):
        frame_body(np.zeros((0, 3)))


def test_look_at_puts_the_target_in_the_middle():
    camera = look_at_camera(
        [2.0, 1.5, 2.0], [0.1, 1.0, 0.0], vertical_angle=0.6, height=40, width=60
    )
    column, row, depth = project(camera, jnp.array([[0.1, 1.0, 0.0], [0.1, 1.2, 0.0]]))
    assert column[0] == pytest.approx(29.5) and row[0] == pytest.approx(19.5)
    assert depth[0] == pytest.approx(np.linalg.norm([1.9, 0.5, 2.0]))
    assert row[1] < row[0]
    assert np.linalg.det(camera.rotation) == pytest.approx(1.0)
    with pytest.raises(InputError, match="parallel"):
        look_at_camera([0.0, 1.0, 0.0], [0.0, 0.0, 0.0], vertical_angle=0.5, height=4)


def test_pinhole_formula():
    """p = R (v - T), u = cx + f x / (-z), v = cy - f y / (-z)."""
    camera = perspective_camera(
        rotation=np.eye(3), position=[0.0, 0.0, 3.0], focal=500.0, height=64, principal=[30, 33]
    )
    column, row, depth = project(camera, POINTS)
    local = np.asarray(POINTS) - [0, 0, 3]
    np.testing.assert_allclose(column, 30 - 500 * local[:, 0] / local[:, 2])
    np.testing.assert_allclose(row, 33 + 500 * local[:, 1] / local[:, 2])
    np.testing.assert_allclose(depth, -local[:, 2])


def test_projection_derivative():
    camera = look_at_camera([0.0, 1.0, 3.0], [0.0, 0.0, 0.0], vertical_angle=0.6, height=40)
    check_grads(lambda p: project(camera, p), (POINTS,), order=1, modes=["rev"])
    check_grads(
        lambda focal: project(jax.tree.map(lambda a: a, camera), POINTS * focal)[0],
        (jnp.asarray(1.0),),
        order=1,
        modes=["rev"],
    )


def test_dictionaries_keep_everything():
    cameras = [
        *magicman_cameras(3, center=np.ones(3), half_extent=0.9, size=32),
        look_at_camera([0, 1, 2], [0, 1, 0], vertical_angle=0.7, height=8, width=9),
    ]
    back = cameras_from_dict(json.loads(json.dumps(cameras_to_dict(cameras))))
    for a, b in zip(cameras, back, strict=True):
        assert (a.kind, a.height, a.width) == (b.kind, b.height, b.width)
        for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
            np.testing.assert_array_equal(x, y)
    assert back[3].kind is CameraKind.PERSPECTIVE


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "fisheye"}, "camera 0"),
        ({"scale": [0.0, 1.0]}, "positive"),
        ({"rotation": [[2, 0, 0], [0, 1, 0], [0, 0, 1]]}, "orthonormal"),
        ({"position": [1, 2]}, "camera 0"),
    ],
)
def test_bad_dictionaries(change, message):
    data = cameras_to_dict(magicman_cameras(1, center=np.zeros(3), half_extent=1.0))
    data["cameras"][0].update(change)
    with pytest.raises(InputError, match=message):
        cameras_from_dict(data)
    with pytest.raises(InputError, match="no list"):
        cameras_from_dict({})


def test_stacks():
    cameras = magicman_cameras(3, center=np.zeros(3), half_extent=1.0, size=16)
    stack = stack_cameras(cameras)
    assert stack.rotation.shape == (3, 3, 3) and stack.near.shape == (3,)
    np.testing.assert_array_equal(unstack_cameras(stack)[2].position, cameras[2].position)
    other = orthographic_camera(
        rotation=np.eye(3), position=np.zeros(3), half_extent=1.0, height=17
    )
    for bad in ([], [cameras[0], other]):
        with pytest.raises(InputError, match="stack"):
            stack_cameras(bad)
