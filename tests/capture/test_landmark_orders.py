"""Orders of landmarks."""

import numpy as np
import pytest
from capture_scenes import write

from dress_jax.capture.landmarks import BODY_NAMES, LEFT_HAND, RIGHT_HAND, without_neck
from dress_jax.core.errors import InputError
from dress_jax.io.capture.landmark_files import read_openpose, read_wholebody

RNG = np.random.default_rng(1)
OPENPOSE_25 = (
    *("nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder"),
    *("left_elbow", "left_wrist", "mid_hip", "right_hip", "right_knee", "right_ankle"),
    *("left_hip", "left_knee", "left_ankle", "right_eye", "left_eye", "right_ear", "left_ear"),
    *("left_big_toe", "left_small_toe", "left_heel"),
    *("right_big_toe", "right_small_toe", "right_heel"),
)


def with_neck(rows):
    """What OpenPose mode does to 133 rows: a neck goes in at 17, and the body is sorted."""
    rows = np.insert(rows, 17, rows[[5, 6]].mean(axis=0), axis=0)
    moved = rows.copy()
    places = [1, 2, 3, 4, 6, 7, 8, 9, 10, 12, 13, 14, 15, 16, 17]
    moved[places] = rows[[17, 6, 8, 10, 7, 9, 12, 14, 16, 13, 15, 2, 1, 4, 3]]
    return moved


def test_the_neck_is_taken_out_and_the_order_restored(tmp_path):
    rows = RNG.random((133, 3))
    np.testing.assert_array_equal(without_neck(with_neck(rows)), rows)
    both = np.stack([RNG.random((134, 3)), with_neck(rows)])
    np.savez(tmp_path / "neck.npz", keypoints=both[..., :2], scores=both[..., 2])
    found = read_wholebody(tmp_path / "neck.npz", person=1).landmarks
    assert found is not None
    np.testing.assert_array_equal(found.points, rows[:, :2])
    np.testing.assert_array_equal(found.confidence, rows[:, 2])
    with pytest.raises(InputError, match="134"):
        without_neck(rows)


def test_one_persons_arrays_need_no_axis_of_people(tmp_path):
    rows = RNG.random((133, 3))
    np.savez(tmp_path / "one.npz", keypoints=rows[:, :2], scores=rows[:, 2])
    found = read_wholebody(tmp_path / "one.npz").landmarks
    assert found is not None
    np.testing.assert_array_equal(found.points, rows[:, :2])


def person(body=25):
    """OpenPose's lists, in which every number tells its place."""
    rows = {"pose": np.arange(body), "face": 100 + np.arange(70), "hand_left": 200 + np.arange(21)}
    rows["hand_right"] = 300 + np.arange(21)
    return {
        f"{name}_keypoints_2d": np.stack([r, r + 0.5, np.full(len(r), 0.9)], 1).ravel().tolist()
        for name, r in rows.items()
    }


def test_openpose_points_go_where_their_names_say(tmp_path):
    path = write(tmp_path / "p.json", {"people": [person()]})
    found = read_openpose(path).landmarks
    assert found is not None
    for place, name in enumerate(BODY_NAMES):
        assert found.points[place, 0] == OPENPOSE_25.index(name), name
        assert found.points[place, 1] == OPENPOSE_25.index(name) + 0.5
    np.testing.assert_array_equal(found.points[23:91, 0], 100 + np.arange(68))
    np.testing.assert_array_equal(found.points[LEFT_HAND, 0], 200 + np.arange(21))
    np.testing.assert_array_equal(found.points[RIGHT_HAND, 0], 300 + np.arange(21))


def test_eighteen_points_have_no_feet(tmp_path):
    path = write(tmp_path / "p.json", {"people": [{**person(18), "face_keypoints_2d": []}]})
    found = read_openpose(path).landmarks
    assert found is not None
    # In this order the right hip is 8 and the left ankle 13.
    assert found.points[12, 0] == 8 and found.points[15, 0] == 13
    assert (found.confidence[17:91] == 0.0).all() and (found.confidence[91:] == 0.9).all()


def test_people_have_to_be_told_apart(tmp_path):
    other = {**person(), "hand_left_keypoints_2d": []}
    path = write(tmp_path / "p.json", {"people": [person(), other]})
    with pytest.raises(InputError, match=r"p\.json: shows 2 people.*0 to 1"):
        read_openpose(path)
    with pytest.raises(InputError, match="no number 2"):
        read_openpose(path, person=2)
    found = read_openpose(path, person=1).landmarks
    assert found is not None and not found.confidence[LEFT_HAND].any()


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({"people": []}, "shows no person"),
        ({}, "no list 'people'"),
        ({"people": [{}]}, "holds no 'pose_keypoints_2d'"),
        ({"people": [{"pose_keypoints_2d": [1.0, 2.0]}]}, "pose_keypoints_2d: holds 2 numbers"),
        ({"people": [{"pose_keypoints_2d": ["a"] * 75}]}, "something else than numbers"),
        ({"people": [{"pose_keypoints_2d": [0.0] * 51}]}, "the body has 17 points"),
        ({"people": [{**person(), "face_keypoints_2d": [0.0] * 9}]}, "the face has 3 points"),
    ],
)
def test_bad_files_of_openpose_are_named(tmp_path, document, message):
    path = write(tmp_path / "bad.json", document)
    with pytest.raises(InputError, match=message) as caught:
        read_openpose(path)
    assert "bad.json" in str(caught.value)


def test_bad_arrays_are_named(tmp_path):
    np.savez(tmp_path / "none.npz", scores=np.zeros((1, 133)))
    with pytest.raises(InputError, match=r"none\.npz: holds no 'keypoints', only scores"):
        read_wholebody(tmp_path / "none.npz")
    np.savez(tmp_path / "few.npz", keypoints=np.zeros((1, 17, 2)), scores=np.zeros((1, 17)))
    with pytest.raises(InputError, match=r"few\.npz: keypoints and scores have shapes"):
        read_wholebody(tmp_path / "few.npz")
