"""Landmarks of the table on a body, and their loss (S7.4, S7.5)."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reconstruction_scenes import person, pinhole_ring, seen_landmarks

from dress_jax.core.pytree import replace
from dress_jax.reconstruction import body_in_world, make_body_views
from dress_jax.reconstruction.landmarks import HIP_TRUST, TABLE, landmark_points
from dress_jax.reconstruction.losses import landmark_loss
from dress_jax.reconstruction.parameters import (
    make_parameters,
    model_translation,
    pack,
    unpack,
    wrap_rotations,
)
from tests.central_differences import UNOPTIMIZED, central_difference

# Smooth functions, differences of fourth order in double precision.
TOLERANCE = 1e-6
# The halves of the embedded mesh mirror each other up to its quantization.
MIRROR = 2e-3  # [m]


def test_the_table_names_each_landmark_once_and_both_sides():
    numbers = [target.index for target in TABLE]
    assert len(set(numbers)) == len(TABLE) == 65
    names = {target.name for target in TABLE}
    assert {name.replace("left", "right") for name in names if "left" in name} == {
        name for name in names if "right" in name
    }
    by_name = {target.name: target.index for target in TABLE}
    # As COCO-WholeBody numbers them.
    assert by_name["nose"] == 0 and by_name["right_ankle"] == 16
    assert by_name["left_big_toe"] == 17 and by_name["right_heel"] == 22
    assert by_name["left_hand_root"] == 91 and by_name["left_thumb_tip"] == 95
    assert by_name["left_pinky_tip"] == 111 and by_name["right_hand_root"] == 112
    assert by_name["right_index1"] == 117 and by_name["right_pinky_tip"] == 132


def test_landmarks_mirror_each_other_on_the_mean_body(body, mapping):
    points = np.asarray(landmark_points(mapping, make_parameters(body)))
    at = {target.name: points[k] for k, target in enumerate(TABLE)}
    for name, point in at.items():
        if name.startswith("left"):
            twin = at[name.replace("left", "right")]
            np.testing.assert_allclose(point * [-1.0, 1.0, 1.0], twin, atol=MIRROR, err_msg=name)


def test_rules_find_nose_ears_feet_and_finger_tips(body, mapping):
    points = np.asarray(landmark_points(mapping, make_parameters(body)))
    at = {target.name: points[k] for k, target in enumerate(TABLE)}
    assert abs(at["nose"][0]) < 0.01  # [m], as all of the following
    assert at["nose"][2] > at["left_eye"][2]
    assert at["left_ear"][0] > 0.06
    assert at["left_big_toe"][0] < at["left_small_toe"][0] - 0.03
    assert at["left_big_toe"][2] > at["left_heel"][2] + 0.2
    for finger in ("thumb", "index", "middle", "ring", "pinky"):
        length = np.linalg.norm(at[f"left_{finger}_tip"] - at[f"left_{finger}3"])
        assert 0.01 < length < 0.04


def test_landmarks_are_joints_and_vertices_of_the_posed_body(body, mapping, truth):
    state = body_in_world(body, truth)
    both = np.concatenate([state.joints, state.vertices])
    points = np.asarray(landmark_points(mapping, truth))
    distance = np.linalg.norm(points[:, None] - both[None], axis=2).min(axis=1)
    np.testing.assert_allclose(distance, 0.0, atol=1e-12)


def test_the_body_in_the_world_is_the_scaled_and_moved_model(body, truth):
    from dress_jax.body.model import forward

    moved = forward(body, truth.pose, truth.shape, jnp.asarray(model_translation(body, truth)))
    state = body_in_world(body, truth)
    np.testing.assert_allclose(state.vertices, truth.scale * moved.vertices, atol=1e-12)
    np.testing.assert_allclose(state.joints[0], truth.translation, atol=1e-14)


def test_packing_is_undone_and_long_rotations_are_wrapped(body, truth):
    again = unpack(pack(truth), 55)
    np.testing.assert_array_equal(pack(again), pack(truth))
    from scipy.spatial.transform import Rotation

    long = np.array([[4.0, 0.0, 0.0], [0.0, -7.0, 1.0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
    short = wrap_rotations(long)
    assert np.linalg.norm(short, axis=1).max() <= np.pi
    np.testing.assert_allclose(
        Rotation.from_rotvec(short).as_matrix(), Rotation.from_rotvec(long).as_matrix(), atol=1e-14
    )
    np.testing.assert_array_equal(short[2:], long[2:])


def test_the_loss_is_the_mean_square_weighted_by_confidence(body, mapping, truth, views):
    """S7.4, written out."""
    other = person(body, seed=3)
    confidence = np.random.default_rng(1).random(views.confidence.shape)
    seen = replace(views, confidence=jnp.asarray(confidence))
    _, projected, _ = seen_landmarks(mapping, other)
    trust = np.array([HIP_TRUST if "hip" in target.name else 1.0 for target in TABLE])
    weighted = (confidence * trust)[..., None] * (projected - np.asarray(views.landmarks)) / 128
    expected = np.mean(np.sum(weighted**2, axis=2))
    np.testing.assert_allclose(landmark_loss(mapping, seen, other), expected, rtol=1e-12)
    assert landmark_loss(mapping, views, truth) < 1e-20


@functools.partial(jax.jit, compiler_options=UNOPTIMIZED)
def value_and_slopes(parameters, mapping, views):
    return jax.value_and_grad(lambda p: landmark_loss(mapping, views, p))(parameters)


@pytest.mark.parametrize(
    "kind", ["orthographic", pytest.param("perspective", marks=pytest.mark.slow)]
)
def test_the_loss_has_the_derivative_of_its_differences(body, mapping, truth, kind):
    cameras = pinhole_ring() if kind == "perspective" else None
    cameras, landmarks, ids = seen_landmarks(mapping, truth, cameras=cameras)
    views = make_body_views(cameras, landmarks, np.ones(landmarks.shape[:2]), landmark_ids=ids)
    other = person(body, seed=3)
    _, slopes = value_and_slopes(other, mapping, views)
    rng = np.random.default_rng(2)
    for name in ("log_scale", "translation", "pose", "shape"):
        start, slope = np.asarray(getattr(other, name)), np.asarray(getattr(slopes, name))
        assert np.linalg.norm(slope) > 1e-6, name
        direction = rng.normal(size=start.shape)

        def along(length, name=name, start=start, direction=direction):
            moved = replace(other, **{name: jnp.asarray(start + length * direction)})
            return value_and_slopes(moved, mapping, views)[0]

        difference = central_difference(along, 1e-3)
        np.testing.assert_allclose(np.sum(slope * direction), difference, rtol=TOLERANCE)


def test_landmarks_of_no_confidence_have_no_influence(body, mapping, truth):
    """S7.4; what a detector writes for a landmark that it has not found may be anything."""
    cameras, landmarks, ids = seen_landmarks(mapping, truth)
    confidence = np.ones(landmarks.shape[:2])
    confidence[1, ::2] = 0.0
    other = person(body, seed=3)
    found = []
    for lie in (0.0, 1e6, np.nan):
        lies = landmarks.copy()
        lies[1, ::2] = lie
        views = make_body_views(cameras, lies, confidence, landmark_ids=ids)
        found.append(value_and_slopes(other, mapping, views))
    for value, slopes in found[1:]:
        assert value == found[0][0]
        np.testing.assert_array_equal(pack(slopes), pack(found[0][1]))
        assert np.all(np.isfinite(pack(slopes)))
