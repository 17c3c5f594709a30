"""Files of views with landmarks, and of bodies."""

import json

import numpy as np
import pytest

from dress_jax.core.errors import InputError
from dress_jax.io.person import (
    SavedBody,
    read_body,
    read_landmarks,
    write_body,
)


def test_a_body_is_read_as_it_was_written(tmp_path):
    rng = np.random.default_rng(0)
    body = SavedBody(
        pose=rng.normal(size=(55, 3)),
        shape=rng.normal(size=16),
        scale=1.1,
        translation=rng.normal(size=3),
    )
    write_body(tmp_path / "body.npz", body, smplx=True)
    again = read_body(tmp_path / "body.npz")
    for name in ("pose", "shape", "translation"):
        np.testing.assert_array_equal(getattr(again, name), getattr(body, name))
    assert again.scale == body.scale
    with np.load(tmp_path / "body.npz") as data:
        np.testing.assert_array_equal(data["betas"], body.shape)


def test_a_pose_alone_is_a_body(tmp_path):
    np.savez(tmp_path / "pose.npz", pose=np.ones(165))
    body = read_body(tmp_path / "pose.npz")
    assert body.pose.shape == (55, 3) and body.shape.size == 0
    assert body.scale == 1.0 and np.all(body.translation == 0.0)


@pytest.mark.parametrize("suffix", [".npz", ".json"])
def test_landmarks_come_in_both_forms(tmp_path, suffix):
    points = np.arange(12.0).reshape(2, 3, 2)
    arrays = {"landmarks": points, "confidence": np.ones((2, 3)), "ids": np.array([0, 5, 6])}
    path = tmp_path / f"landmarks{suffix}"
    if suffix == ".npz":
        np.savez(path, allow_pickle=False, **arrays)
    else:
        path.write_text(json.dumps({name: array.tolist() for name, array in arrays.items()}))
    landmarks, confidence, ids = read_landmarks(path)
    np.testing.assert_array_equal(landmarks, points)
    np.testing.assert_array_equal(confidence, np.ones((2, 3)))
    assert ids is not None and ids.tolist() == [0, 5, 6]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.json", '{"landmarks": []}', "holds no 'confidence'"),
        ("a.json", '{"landmarks": [[1, 2], [3]], "confidence": [1]}', "no regular array"),
        ("a.json", "[]", "instead of an object"),
        ("a.npz", "text", "not a valid npz"),
    ],
)
def test_broken_landmark_files_are_refused(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(InputError, match=message) as caught:
        read_landmarks(path)
    assert name in str(caught.value)


def test_broken_body_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="check the path"):
        read_body(tmp_path / "none.npz")
    np.savez(tmp_path / "short.npz", pose=np.zeros(72))
    with pytest.raises(InputError, match="55 rotation vectors"):
        read_body(tmp_path / "short.npz")
    np.savez(tmp_path / "objects.npz", pose=np.array([{}], dtype=object))
    with pytest.raises(InputError, match="plain arrays"):
        read_body(tmp_path / "objects.npz")
