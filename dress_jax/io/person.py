"""Files of a person in pictures: views with landmarks, and the parameters of a body (S7).

Views are a target folder (`io.images`), with `occluded/` beside `mask/` where clothes hide the
body.
Landmarks are an `.npz` or JSON file with `landmarks`, (views, m, 2) [px, pixel centres at whole
numbers], `confidence`, (views, m), and `ids`, (m,), their numbers in COCO-WholeBody, which may be
missing where they are 0, 1, ... A body is an `.npz` file with `pose` (55, 3) [rad], `shape` (or
`betas`), `scale` and `transl`: its vertices are scale * (model(pose, shape) + transl).
"""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from dress_jax.core.errors import InputError
from dress_jax.io.arrays import read_npz
from dress_jax.io.atomic import atomic_path
from dress_jax.io.documents import read_json
from dress_jax.io.images import Targets, load_targets, read_mask


@dataclasses.dataclass(frozen=True)
class Person:
    """Views of a person.

    Args:
        targets: cameras, colours and masks.
        occluded: where the body is hidden, (v, h, w), or None.
        landmarks: [px], (v, m, 2).
        confidence: in [0, 1], (v, m).
        landmark_ids: numbers in COCO-WholeBody, (m,), or None for 0, 1, ...
    """

    targets: Targets
    occluded: Float[np.ndarray, "v h w"] | None
    landmarks: Float[np.ndarray, "v m 2"]
    confidence: Float[np.ndarray, "v m"]
    landmark_ids: Int[np.ndarray, " m"] | None


@dataclasses.dataclass(frozen=True)
class SavedBody:
    """Parameters of a body: vertices are scale * (model(pose, shape) + translation).

    Args:
        pose: rotation vectors [rad], (55, 3).
        shape: coefficients, (b,).
        scale: factor.
        translation: [m] before scaling, (3,).
    """

    pose: Float[np.ndarray, "55 3"]
    shape: Float[np.ndarray, " b"]
    scale: float
    translation: Float[np.ndarray, "3"]


def load_person(folder: str | Path, landmarks: str | Path) -> Person:
    """Read views and landmarks.

    Raises:
        InputError: a file is missing or malformed.
    """
    folder = Path(folder)
    targets = load_targets(folder)
    occluded = None
    if (folder / "occluded").is_dir():
        paths = [folder / "occluded" / f"{azimuth:03d}.png" for azimuth in targets.azimuths]
        pictures = [read_mask(path) for path in paths]
        if len({picture.shape for picture in pictures}) != 1:
            raise InputError(
                "the pictures differ in size",
                where=str(folder / "occluded"),
                mend="give all views the same size",
            )
        occluded = np.stack(pictures)
    points, confidence, ids = read_landmarks(landmarks)
    if len(points) != len(targets.azimuths):
        raise InputError(
            f"holds landmarks of {len(points)} views, {folder} has {len(targets.azimuths)}",
            where=str(landmarks),
            mend="give one row per view, in the order of cameras.json",
        )
    return Person(targets, occluded, points, confidence, ids)


def read_landmarks(
    path: str | Path,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Positions [px], confidences and numbers (or None) of a landmark file.

    Raises:
        InputError: the file is missing or malformed.
    """
    path = Path(path)
    if path.suffix.lower() == ".npz":
        arrays: dict[str, Any] = read_npz(path)
    else:
        arrays = read_json(path, what="landmarks")
    points = _numbers(path, arrays, "landmarks")
    confidence = _numbers(path, arrays, "confidence")
    ids = _numbers(path, arrays, "ids") if "ids" in arrays else None
    return points, confidence, None if ids is None else ids.astype(np.int64)


def write_body(
    path: str | Path,
    body: SavedBody,
    *,
    joints: Float[np.ndarray, "55 3"] | None = None,
    colors: Float[np.ndarray, "n 3"] | None = None,
    smplx: bool = False,
) -> None:
    """Write a body atomically, with its joints [m] and vertex colours where they are given.

    Args:
        path: the `.npz` file.
        body: the parameters.
        joints: in the world [m].
        colors: RGB of the vertices.
        smplx: whether the shape is SMPL-X's, and may be called `betas`.

    Raises:
        InputError: the place cannot be written to.
    """
    arrays = {
        "pose": body.pose,
        "shape": body.shape,
        "scale": np.asarray(body.scale),
        "transl": body.translation,
    }
    if smplx:
        arrays["betas"] = body.shape
    if joints is not None:
        arrays["joints"] = joints
    if colors is not None:
        arrays["colors"] = colors
    with atomic_path(path) as temporary:
        np.savez(temporary, allow_pickle=False, **arrays)


def read_body(path: str | Path) -> SavedBody:
    """Read a body; shape, scale and translation may be missing (zeros, 1, zeros).

    Raises:
        InputError: the file is missing or malformed, or lacks the pose.
    """
    path = Path(path)
    arrays = read_npz(path)
    pose = _numbers(path, arrays, "pose")
    if pose.size != 165:
        raise InputError(
            f"'pose' has shape {pose.shape}",
            where=str(path),
            mend="give 55 rotation vectors [rad], shape (55, 3)",
        )
    key = "shape" if "shape" in arrays else "betas"
    return SavedBody(
        pose=pose.reshape(55, 3),
        shape=_numbers(path, arrays, key).ravel() if key in arrays else np.zeros(0),
        scale=float(_numbers(path, arrays, "scale").ravel()[0]) if "scale" in arrays else 1.0,
        translation=_numbers(path, arrays, "transl").reshape(-1)[:3]
        if "transl" in arrays
        else np.zeros(3),
    )


def _numbers(path: Path, arrays: dict[str, Any], key: str) -> np.ndarray:
    if key not in arrays:
        raise InputError(
            f"holds no '{key}' among its plain arrays",
            where=str(path),
            mend="see docs/reconstruction.md",
        )
    try:
        # JSON writes a landmark that was not found as null.
        return np.asarray(arrays[key], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"'{key}' is no regular array of numbers", where=str(path), mend="write it again"
        ) from error
