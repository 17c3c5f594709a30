"""Frames of 4D-Dress: a labelled scan, its SMPL-X body, and four photographs of it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dress_jax.capture.body import BodyEstimate
from dress_jax.capture.bundle import Bundle
from dress_jax.capture.checks import numbers
from dress_jax.capture.frames import opencv_camera
from dress_jax.capture.labels import convert_labels
from dress_jax.capture.surfaces import Surface
from dress_jax.capture.views import View
from dress_jax.core.errors import InputError
from dress_jax.io.capture.close_scans import eight_bit
from dress_jax.io.capture.fields import field, within
from dress_jax.io.capture.pickles import read_pickle
from dress_jax.io.capture.pictures import read_coverage, read_pixels

_SOURCE = "4D-Dress"


def read_four_d_dress(folder: str | Path, *, frame: str) -> Bundle:
    """One frame of a sequence.

    Files: `Meshes_pkl/mesh-fFRAME.pkl`, `Semantic/labels/label-fFRAME.pkl` (may be absent),
    `SMPLX/mesh-fFRAME_smplx.pkl` (may be absent), `Capture/cameras.pkl` and
    `Capture/CAMERA/images/capture-fFRAME.png`, with `masks/mask-fFRAME.png` beside them. Metres,
    +y up; cameras are OpenCV's, x_camera = R x + t. `basic_info.pkl` may hold a `rotation` that
    turns the person to the front, which is applied to everything. Hands that are given as principal
    components are left flat, because unfolding them needs the SMPL-X file.

    Pickles are read by a reader that admits numpy arrays and Python's plain values only and refuses
    every other name: a pickle that asks for anything else is not run (`io.capture.pickles`).

    Args:
        folder: the sequence (SUBJECT/OUTFIT/TAKE).
        frame: as in the files' names, such as "00011".

    Raises:
        InputError: there is no such frame, or a file is malformed, or a pickle asks for more than
            arrays.
    """
    folder = Path(folder)
    path = folder / "Meshes_pkl" / f"mesh-f{frame}.pkl"
    if not path.is_file():
        known = sorted(p.stem.removeprefix("mesh-f") for p in path.parent.glob("mesh-f*.pkl"))
        raise InputError(
            f"has no frame '{frame}'",
            where=str(folder),
            mend=f"its frames are {known[0]} to {known[-1]}" if known else "check the folder",
        )
    turn = _turn(folder)
    parts = {
        "scan": _scan(folder, path, frame, turn),
        "body": _body(folder / "SMPLX" / f"mesh-f{frame}_smplx.pkl", turn),
        "views": _views(folder / "Capture", frame, turn),
    }
    found = {part: value for part, value in parts.items() if value is not None and value != ()}
    return Bundle(**found, sources=dict.fromkeys(found, f"{_SOURCE}, frame {frame}"))


def _turn(folder: Path) -> np.ndarray:
    path = folder / "basic_info.pkl"
    turn = read_pickle(path).get("rotation") if path.is_file() else None
    return np.eye(3) if turn is None else numbers(f"{path}, rotation", turn, (3, 3))


def _scan(folder: Path, path: Path, frame: str, turn: np.ndarray) -> Surface:
    mesh = read_pickle(path)
    vertices = numbers(f"{path}, vertices", field(mesh, "vertices", where=path), (None, 3))
    labelled = folder / "Semantic" / "labels" / f"label-f{frame}.pkl"
    labels = None
    if labelled.is_file():
        ids = np.asarray(field(read_pickle(labelled), "scan_labels", where=labelled))
        if ids.shape != (len(vertices),):
            raise InputError(
                f"has shape {ids.shape} for {len(vertices)} vertices",
                where=f"{labelled}, scan_labels",
            )
        with within(labelled):
            labels = convert_labels(ids, "4d-dress")
    return Surface(
        vertices=vertices @ turn.T,
        faces=field(mesh, "faces", where=path),
        labels=labels,
        colors=eight_bit(mesh.get("colors")),
    )


def _body(path: Path, turn: np.ndarray) -> BodyEstimate | None:
    if not path.is_file():
        return None
    values = read_pickle(path)

    def rows(name: str, count: int) -> np.ndarray:
        flat = np.ravel(values.get(name, np.zeros(3 * count)))
        return numbers(f"{path}, {name}", flat, (3 * count,)).reshape(count, 3)

    return BodyEstimate(
        betas=np.ravel(field(values, "betas", where=path)),
        global_orient=rows("global_orient", 1)[0],
        body_pose=rows("body_pose", 21),
        left_hand_pose=_hand(values, "left_hand_pose", path),
        right_hand_pose=_hand(values, "right_hand_pose", path),
        jaw_pose=rows("jaw_pose", 1)[0],
        left_eye_pose=rows("leye_pose", 1)[0],
        right_eye_pose=rows("reye_pose", 1)[0],
        expression=np.ravel(values.get("expression", np.zeros(0))),
        transl=np.ravel(field(values, "transl", "trans", where=path)),
        to_world=turn,
    )


def _hand(values: Mapping[str, Any], name: str, path: Path) -> np.ndarray:
    """Finger rotations; principal components, which need the model's file, leave the hand flat."""
    flat = np.ravel(values.get(name, np.zeros(0)))
    if flat.size != 45:
        return np.zeros((15, 3))
    return numbers(f"{path}, {name}", flat, (45,)).reshape(15, 3)


def _views(folder: Path, frame: str, turn: np.ndarray) -> tuple[View, ...]:
    path = folder / "cameras.pkl"
    if not path.is_file():
        return ()
    views = []
    for name, entry in sorted(read_pickle(path).items()):
        picture = folder / name / "images" / f"capture-f{frame}.png"
        if not picture.is_file():
            continue  # cameras whose pictures were not released
        if not isinstance(entry, dict):
            raise InputError(f"holds a {type(entry).__name__}", where=f"{path}, camera {name}")
        rgb, alpha = read_pixels(picture)
        mask = folder / name / "masks" / f"mask-f{frame}.png"
        where = f"{path}, camera {name}"
        with within(where):
            camera = opencv_camera(
                field(entry, "intrinsics", where=where),
                field(entry, "extrinsics", where=where),
                height=rgb.shape[0],
                width=rgb.shape[1],
                turn=turn,
            )
        matte = read_coverage(mask) if mask.is_file() else alpha
        views.append(View(name=name, camera=camera, rgb=rgb, matte=matte))
    return tuple(views)
