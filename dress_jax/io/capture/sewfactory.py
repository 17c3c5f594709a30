"""Scenes of SewFactory: a dressed person from twelve sides, the true garment and its pattern."""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dress_jax.capture.body import BodyEstimate, BodyFamily, body_estimate
from dress_jax.capture.bundle import Bundle
from dress_jax.capture.checks import numbers
from dress_jax.capture.frames import about_y, sewfactory_camera, view_azimuth
from dress_jax.capture.labels import ClothesLabel
from dress_jax.capture.surfaces import Surface
from dress_jax.capture.views import View, matte_from_white
from dress_jax.core.errors import InputError
from dress_jax.io.capture.fields import field, files_named, within
from dress_jax.io.capture.pictures import read_pixels
from dress_jax.io.documents import read_json
from dress_jax.io.obj import read_obj
from dress_jax.io.patterns import load_pattern

STATIC = "static"
_CAMERA = "cam_pos.json"
_SOURCE = "SewFactory"
_CENTIMETRE = 0.01
_KINDS = {
    "one_piece": ClothesLabel.DRESS,
    "top": ClothesLabel.TOP,
    "bottom": ClothesLabel.BOTTOM,
}


def read_sewfactory(folder: str | Path, *, pose: str = STATIC) -> Bundle:
    """The views of one pose, the posed garment as the scan, the body and the pattern.

    Files: `renders/POSE_VIEW.png` with `POSE_VIEWcam_pos.json` (static: in `static/`),
    `objects/*_FRAME.obj`, `poses/POSE__body_info.json`, `static/*_specification.json`,
    `static/spec_config.json`. Lengths are centimetres, +y up. The animated person faces +x and is
    turned by -90 degrees about y into our world; the static one faces +z already. The origin stays
    where the scene has it, so soles are not at y = 0.

    Pictures have neither alpha nor masks: the matte is what is not white, and `mask` stays empty
    until it is drawn from the scan (`application.bundle.draw_masks`).

    Args:
        folder: the scene.
        pose: "static", or the prefix of the pose's files, such as "0000".

    Raises:
        InputError: there is no such pose, files are missing or malformed, or pictures show nobody.
    """
    folder = Path(folder)
    place = folder / (STATIC if pose == STATIC else "renders")
    if not place.is_dir():
        raise InputError(
            f"holds no {place.name}/", where=str(folder), mend="give a scene of SewFactory"
        )
    turn = 0.0 if pose == STATIC else -0.5 * np.pi
    cameras = sorted(place.glob(f"{pose}_*{_CAMERA}"))
    if not cameras:
        known = sorted({path.name.split("_")[0] for path in place.glob(f"*{_CAMERA}")})
        raise InputError(
            f"has no pose '{pose}'", where=str(place), mend=f"its poses are {', '.join(known)}"
        )
    views = [_view(path, pose, turn) for path in cameras]
    views.sort(key=lambda view: view_azimuth(view.camera))
    pattern = files_named(folder / STATIC, "*_specification.json", what="pattern")[0]
    parts = {
        "body": _body(folder, pose, turn),
        "scan": _garment(folder, pose, turn),
        "views": tuple(views),
        "pattern": load_pattern(pattern),
    }
    return Bundle(**parts, sources=dict.fromkeys(parts, f"{_SOURCE}, pose {pose}"))


def _view(path: Path, pose: str, turn: float) -> View:
    name = path.name.removeprefix(f"{pose}_").removesuffix(_CAMERA)
    picture = path.with_name(f"{pose}_{name}.png")
    rgb, alpha = read_pixels(picture)
    document = read_json(path, what="a camera of SewFactory")
    with within(path):
        camera = sewfactory_camera(
            field(document, "cam_K", where=path),
            field(document, "cam_R", where=path),
            field(document, "cam_T", where=path),
            height=rgb.shape[0],
            width=rgb.shape[1],
            turn=turn,
        )
    matte = matte_from_white(rgb) if alpha is None else alpha
    if not matte.any():
        raise InputError("shows nobody", where=str(picture), mend="copy it again")
    return View(name=name, camera=camera, rgb=rgb, matte=matte)


def _garment(folder: Path, pose: str, turn: float) -> Surface:
    if pose == STATIC:
        path = files_named(folder / STATIC, "*.obj", what="garment")[0]
    else:
        path = files_named(folder / "objects", f"*_{_frame(pose)}.obj", what="garment")[0]
    contents = read_obj(path)
    vertices = contents.vertices @ about_y(turn).T * _CENTIMETRE
    kinds = set(_configuration(folder)) & set(_KINDS)
    # A scene of two garments does not say which vertex is whose.
    kind = _KINDS[kinds.pop()] if len(kinds) == 1 else None
    return Surface(
        vertices=vertices,
        faces=contents.faces,
        labels=None if kind is None else np.full(len(vertices), kind, np.uint8),
    )


def _body(folder: Path, pose: str, turn: float) -> BodyEstimate:
    """SMPL-H with joint angles of Maya: degrees about x, y, z in the order Rz Ry Rx.

    `trans` is where the pelvis is, which a body model's translation is not: the difference, the
    pelvis in the model's own frame, is known from the static pose, whose model origin lies at
    `delta`.
    """
    still = folder / STATIC / f"{STATIC}__body_info.json"
    path = still if pose == STATIC else folder / "poses" / f"{pose}__body_info.json"
    document = read_json(path, what="a body of SewFactory")
    angles = numbers(f"{path}, pose", field(document, "pose", where=path), (52, 3))
    first = read_json(still, what="a body of SewFactory")
    pelvis, rest = (
        numbers(f"{where}, trans", field(source, "trans", where=where), (3,))
        for where, source in ((path, document), (still, first))
    )
    delta = next(iter(_configuration(folder).values())).get("delta")
    origin = numbers(f"{folder / STATIC / 'spec_config.json'}, delta", delta, (3,))
    return body_estimate(
        Rotation.from_euler("xyz", angles, degrees=True).as_rotvec(),
        field(document, "shape", where=path),
        (pelvis - rest + origin) * _CENTIMETRE,
        family=BodyFamily.SMPLH,
        to_world=about_y(turn),
    )


def _configuration(folder: Path) -> dict[str, Any]:
    """Garments of the scene by kind, with their file and the place of the body's origin."""
    path = folder / STATIC / "spec_config.json"
    entries = read_json(path, what="the garments of a SewFactory scene")
    if not entries or not all(isinstance(entry, dict) for entry in entries.values()):
        raise InputError("names no garment", where=str(path), mend="copy the scene again")
    return entries


def _frame(pose: str) -> int:
    """The frame in an object's name: 0 for "0000", -50 for "-0050"."""
    try:
        return int(pose)
    except ValueError as error:
        raise InputError(
            f"'{pose}' is no number of a frame", where="pose", mend='give "static" or "0000"'
        ) from error
