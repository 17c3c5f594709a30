"""Estimates of SMPL-X bodies: SMPLer-X's npz, MagicMan's JSON, OSX's mesh (S7.1)."""

from pathlib import Path
from typing import Any

import numpy as np

from dress_jax.capture.body import (
    BODY_JOINTS,
    CAMERA_TO_WORLD,
    HAND_JOINTS,
    BodyEstimate,
    to_axis_angle,
)
from dress_jax.capture.bundle import Bundle
from dress_jax.capture.checks import numbers
from dress_jax.capture.surfaces import Surface
from dress_jax.core.errors import InputError
from dress_jax.io.arrays import read_npz
from dress_jax.io.body_meshes import read_surface
from dress_jax.io.capture.fields import field
from dress_jax.io.documents import read_json

SMPLX_VERTICES = 10475


def read_smpler_x(path: str | Path) -> Bundle:
    """The parameters that SMPLer-X writes per person and frame, from the camera's frame into ours.

    Axis times angle: `global_orient` (1, 3), `body_pose` (21, 3), `left/right_hand_pose` (15, 3),
    `jaw_pose`, `leye_pose`, `reye_pose` (1, 3), `betas` (1, 10), `expression` (1, 10), `transl`
    (1, 3). The camera has x right, y down, z away; the view is taken for the front.

    Raises:
        InputError: the file or a field is missing, or a field has another size.
    """
    arrays = read_npz(path)
    return Bundle(body=_smpler_x(arrays, path), sources={"body": "SMPLer-X"})


def _smpler_x(arrays: dict[str, np.ndarray], path: str | Path) -> BodyEstimate:
    mend = "give the npz file of one person from SMPLer-X's smplx folder"

    def vector(name: str, *others: str, size: int | None = None) -> np.ndarray:
        values = np.ravel(field(arrays, name, *others, where=path, mend=mend))
        return numbers(f"{path}, {name}", values, (size,))

    def joints(name: str, count: int, *others: str) -> np.ndarray:
        return vector(name, *others, size=3 * count).reshape(count, 3)

    return BodyEstimate(
        betas=vector("betas"),
        global_orient=vector("global_orient", size=3),
        body_pose=joints("body_pose", BODY_JOINTS),
        left_hand_pose=joints("left_hand_pose", HAND_JOINTS),
        right_hand_pose=joints("right_hand_pose", HAND_JOINTS),
        jaw_pose=vector("jaw_pose", size=3),
        left_eye_pose=vector("leye_pose", "left_eye_pose", size=3),
        right_eye_pose=vector("reye_pose", "right_eye_pose", size=3),
        expression=vector("expression"),
        transl=vector("transl", size=3),
        to_world=CAMERA_TO_WORLD,
    )


def read_magicman_body(path: str | Path, *, unit: float = 1.0, floor: float = 0.0) -> BodyEstimate:
    """The body that MagicMan fits to its views, `smplx_refined.json`.

    vertices = (v + trans) scale diag(1, -1, -1), in the generator's units. Rotations are two
    columns of their matrices (6 numbers), or matrices; each is recognised by its size.

    Args:
        path: the JSON file.
        unit: metres in one of the generator's units.
        floor: height of the generator's origin above the soles [m].

    Raises:
        InputError: the file or a field is missing, or a field has another size.
    """
    document = read_json(path, what="MagicMan's body")

    def values(name: str, *others: str) -> Any:
        return field(document, name, *others, where=path)

    def rotations(name: str, count: int) -> np.ndarray:
        return to_axis_angle(values(name), count, where=f"{path}, {name}")

    scale = numbers(f"{path}, scale", np.ravel(values("scale")), (1,))[0]
    return BodyEstimate(
        betas=np.ravel(values("betas")),
        global_orient=rotations("global_orient", 1)[0],
        body_pose=rotations("body_pose", BODY_JOINTS),
        left_hand_pose=rotations("left_hand_pose", HAND_JOINTS),
        right_hand_pose=rotations("right_hand_pose", HAND_JOINTS),
        jaw_pose=rotations("jaw_pose", 1)[0],
        left_eye_pose=np.zeros(3),
        right_eye_pose=np.zeros(3),
        expression=np.ravel(values("exp", "expression")),
        transl=np.ravel(values("trans", "transl")),
        scale=float(scale) * unit,
        to_world=CAMERA_TO_WORLD,
        origin=np.array([0.0, floor, 0.0]),
    )


def magicman_scale(path: str | Path) -> float:
    """Units of the generator in one metre, according to the fitted body.

    Raises:
        InputError: the file or the field is missing, or the scale is not positive.
    """
    document = read_json(path, what="MagicMan's body")
    where = f"{path}, scale"
    scale = float(numbers(where, np.ravel(field(document, "scale", where=path)), (1,))[0])
    if scale <= 0.0:
        raise InputError(f"is {scale}; it has to be positive", where=where)
    return scale


def read_osx(path: str | Path) -> Bundle:
    """The body mesh that OSX's demo writes in place of parameters, from the camera's frame.

    Raises:
        InputError: the file is no mesh of SMPL-X's 10,475 vertices.
    """
    vertices, faces = read_surface(path)
    if len(vertices) != SMPLX_VERTICES:
        raise InputError(
            f"has {len(vertices)} vertices, SMPL-X has {SMPLX_VERTICES}",
            where=str(path),
            mend="give the OBJ file of OSX's demo",
        )
    return Bundle(
        body_mesh=Surface(vertices=vertices @ CAMERA_TO_WORLD.T, faces=faces),
        sources={"body_mesh": "OSX"},
    )
