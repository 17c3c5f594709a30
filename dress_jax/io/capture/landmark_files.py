"""Landmarks: OpenPose's JSON, and the arrays of DWPose and rtmlib in npz files."""

from pathlib import Path
from typing import Any

import numpy as np

from dress_jax.capture.bundle import Bundle
from dress_jax.capture.landmarks import COUNT, Landmarks, from_openpose, without_neck
from dress_jax.core.errors import InputError
from dress_jax.io.arrays import read_npz
from dress_jax.io.capture.fields import field, within
from dress_jax.io.documents import read_json

_POINTS = ("keypoints", "points")
_SCORES = ("scores", "confidence", "keypoint_scores")
_HALVES = {
    "face": "face_keypoints_2d",
    "left_hand": "hand_left_keypoints_2d",
    "right_hand": "hand_right_keypoints_2d",
}


def read_openpose(path: str | Path, *, person: int | None = None) -> Bundle:
    """Landmarks from a file that OpenPose wrote with `--write_json`.

    Triplets column, row, confidence: 25 (or 18) of the body, 70 of the face, 21 of each hand; face
    and hands may be missing. OpenPose's neck, mid-hip and pupils have no counterpart.

    Args:
        path: the JSON file; numbers in the picture's pixels (OpenPose's `--keypoint_scale 0`).
        person: which of several, from 0.

    Raises:
        InputError: the file is no such JSON, shows no person, or several while none is chosen, or
            a list has another length.
    """
    people = read_json(path, what="landmarks of OpenPose").get("people")
    if not isinstance(people, list) or not all(isinstance(entry, dict) for entry in people):
        raise InputError(
            "has no list 'people'", where=str(path), mend="give a file of OpenPose's --write_json"
        )
    chosen: dict[str, Any] = people[_chosen(len(people), person, where=str(path))]
    body = _triplets(field(chosen, "pose_keypoints_2d", where=path), f"{path}, pose_keypoints_2d")
    parts = {
        name: _triplets(chosen.get(key) or [], f"{path}, {key}") for name, key in _HALVES.items()
    }
    with within(path):
        landmarks = from_openpose(body, **parts)
    return Bundle(landmarks=landmarks, sources={"landmarks": "OpenPose"})


def read_wholebody(path: str | Path, *, person: int | None = None) -> Bundle:
    """Landmarks from an npz file with the arrays that DWPose or rtmlib return.

    `keypoints` [px] of shape (people, 133, 2) and `scores` (people, 133), or one person's without
    the first axis. With 134 points they are in OpenPose's order with its neck (rtmlib's
    `to_openpose=True`), which is undone.

    Args:
        path: the npz file.
        person: which of several, from 0.

    Raises:
        InputError: the file or an array is missing, or a shape is another one.
    """
    arrays = read_npz(path)
    mend = "save np.savez(path, keypoints=keypoints, scores=scores)"
    points = np.asarray(field(arrays, *_POINTS, where=path, mend=mend), float)
    scores = np.asarray(field(arrays, *_SCORES, where=path, mend=mend), float)
    if points.ndim == 2:
        points, scores = points[None], scores.reshape(1, -1)
    if points.shape != (*scores.shape, 2) or points.shape[1] not in (COUNT, COUNT + 1):
        raise InputError(
            f"keypoints and scores have shapes {points.shape} and {scores.shape}",
            where=str(path),
            mend=f"give (people, {COUNT}, 2) and (people, {COUNT})",
        )
    chosen = _chosen(len(points), person, where=str(path))
    rows = np.concatenate([points[chosen], scores[chosen][:, None]], axis=1)
    if len(rows) == COUNT + 1:
        rows = without_neck(rows)
    return Bundle(
        landmarks=Landmarks(points=rows[:, :2], confidence=rows[:, 2]),
        sources={"landmarks": "DWPose or rtmlib"},
    )


def _chosen(count: int, person: int | None, *, where: str) -> int:
    if count == 0:
        raise InputError("shows no person", where=where, mend="give a picture of one person")
    if person is None and count > 1:
        raise InputError(
            f"shows {count} people",
            where=where,
            mend=f"choose one, 0 to {count - 1}, with --person",
        )
    if person is not None and not 0 <= person < count:
        raise InputError(
            f"shows {count} people, there is no number {person}",
            where=where,
            mend=f"choose 0 to {count - 1}",
        )
    return person or 0


def _triplets(values: Any, where: str) -> np.ndarray:
    try:
        flat = np.asarray(values, float)
    except (TypeError, ValueError) as error:
        raise InputError("holds something else than numbers", where=where) from error
    if flat.ndim != 1 or flat.size % 3:
        raise InputError(
            f"holds {flat.size} numbers, not triplets of column, row, confidence", where=where
        )
    return flat.reshape(-1, 3)
