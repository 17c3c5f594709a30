"""Landmarks: the way from BlazePose's points to ours, and faults."""

import numpy as np
import pytest
from mannequin import POINTS, mannequin

from dress_jax.capture.landmarks import BODY_NAMES
from dress_jax.core.errors import InputError
from dress_jax.io.networks import load_landmark_network
from dress_jax.vision.body_landmarks import (
    BLAZEPOSE,
    find_landmarks,
    from_blazepose,
    helper_side,
    matte_square,
)
from dress_jax.vision.resampling import square_window

# Names of BlazePose's points in its own order, as its model card lists them.
# fmt: off
THEIRS = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye",
    "right_eye_outer", "left_ear", "right_ear", "mouth_left", "mouth_right", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_pinky",
    "right_pinky", "left_index", "right_index", "left_thumb", "right_thumb", "left_hip",
    "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle", "left_heel", "right_heel",
    "left_foot_index", "right_foot_index",
)
# fmt: on
HEIGHT_SHARE = 0.04


def test_points_go_to_their_namesakes():
    for ours, theirs in BLAZEPOSE.items():
        name = BODY_NAMES[ours].replace("big_toe", "foot_index")
        assert THEIRS[theirs] == name
    assert set(range(23)) - set(BLAZEPOSE) == {18, 21}  # small toes


def test_confidence_is_the_smaller_probability_and_zero_without_a_point():
    rows = np.zeros((39, 5))
    rows[:, 0] = np.arange(39)
    rows[:, 3:] = (2.0, -1.0)
    found = from_blazepose(rows)
    seen = found.confidence > 0.0
    assert set(np.flatnonzero(seen)) == set(BLAZEPOSE)
    np.testing.assert_allclose(found.confidence[seen], 1.0 / (1.0 + np.e))
    assert found.points[5, 0] == 11 and found.points[22, 0] == 30


def test_squares_hold_the_person():
    mask = np.zeros((100, 80), bool)
    mask[20:81, 30:41] = True
    centre, side = matte_square(mask)
    np.testing.assert_allclose(centre, [35, 50])
    assert side == pytest.approx(1.25 * 61)
    rows = np.zeros((39, 5))
    rows[34, :2] = (3.0, 4.0)
    assert helper_side(rows) == pytest.approx(2 * 1.25 * 5)


@pytest.mark.parametrize("side", [20.0, 60.0])
def test_a_window_shows_its_place(side):
    """A ramp is resampled to itself, at a finer as well as at a coarser scale."""
    rows, columns = np.mgrid[:80, :90].astype(float)
    picture = np.stack([rows, columns, rows + columns], axis=-1)
    window = square_window(picture, np.array([40.0, 30.0]), side, 30)
    step = side / 30
    expected = step * (np.arange(30) - 14.5)
    np.testing.assert_allclose(window[:, 7, 0], 30 + expected, atol=0.02 * side)
    np.testing.assert_allclose(window[5, :, 1], 40 + expected, atol=0.02 * side)


def test_a_drawn_person_is_found_and_an_empty_wall_is_not():
    image, mask, _, _ = mannequin()
    network = load_landmark_network()
    matte = 255 * mask.astype(np.uint8)
    person = find_landmarks(image, matte, network)
    for index in (0, 5, 6, 7, 8, 11, 12, 13, 14, 15, 16):
        gap = np.linalg.norm(person.landmarks.points[index] - POINTS[index])
        assert gap < HEIGHT_SHARE * len(image), BODY_NAMES[index]
    wall = np.full_like(image, 180)
    with pytest.raises(InputError, match="shows no person"):
        find_landmarks(wall, matte, network)
    with pytest.raises(InputError, match="shows nobody"):
        find_landmarks(image, np.zeros_like(matte), network)


def test_what_lies_beyond_the_picture_was_not_found():
    image, mask, _, _ = mannequin()
    cut = np.s_[:432]  # through the feet
    person = find_landmarks(image[cut], 255 * mask[cut].astype(np.uint8), load_landmark_network())
    outside = person.landmarks.points[:23, 1] > 431.5
    assert outside.any() and (person.landmarks.confidence[:23][outside] == 0.0).all()
