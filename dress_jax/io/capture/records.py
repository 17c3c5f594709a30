"""A bundle as one plain document and named arrays, which both saved forms share.

The document holds what is short (names, cameras, parameters of a body, the pattern), the arrays
what is long. JSON keeps every digit of a double, so both directions are exact, but for the pattern,
which is written in its own file format and rounds to about 1e-15 m in its centimetres.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from dress_jax.capture.body import BodyEstimate, BodyFamily
from dress_jax.capture.bundle import Bundle
from dress_jax.capture.landmarks import Landmarks
from dress_jax.capture.surfaces import Surface
from dress_jax.capture.views import View
from dress_jax.core.errors import InputError
from dress_jax.io.documents import to_plain
from dress_jax.pattern.specification import parse_specification
from dress_jax.pattern.specification_writer import to_specification
from dress_jax.render.cameras import cameras_from_dict, cameras_to_dict

FORMAT = 1
_VIEW_PICTURES = ("rgb", "matte", "mask", "hidden")
_SURFACE = ("vertices", "faces", "labels", "colors")
_BODY = (
    "betas",
    "global_orient",
    "body_pose",
    "left_hand_pose",
    "right_hand_pose",
    "jaw_pose",
    "left_eye_pose",
    "right_eye_pose",
    "expression",
    "transl",
    "to_world",
    "origin",
)


def to_record(bundle: Bundle) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The document and the arrays of a bundle; names of arrays are paths with slashes."""
    arrays: dict[str, np.ndarray] = {}
    for part in ("image", "matte", "labels"):
        if getattr(bundle, part) is not None:
            arrays[part] = getattr(bundle, part)
    if bundle.landmarks is not None:
        arrays["landmarks/points"] = bundle.landmarks.points
        arrays["landmarks/confidence"] = bundle.landmarks.confidence
    for part in ("body_mesh", "scan"):
        surface = getattr(bundle, part)
        if surface is not None:
            found = {name: getattr(surface, name) for name in _SURFACE}
            arrays |= {f"{part}/{name}": a for name, a in found.items() if a is not None}
    for view in bundle.views:
        place = f"views/{view.name}"
        for name in (*_VIEW_PICTURES, "normal"):
            if getattr(view, name) is not None:
                arrays[f"{place}/{name}"] = getattr(view, name)
        arrays |= {f"{place}/part-{name}": mask for name, mask in view.parts.items()}
        if view.landmarks is not None:
            arrays[f"{place}/landmark-points"] = view.landmarks.points
            arrays[f"{place}/landmark-confidence"] = view.landmarks.confidence
    document = {
        "format": FORMAT,
        "sources": dict(bundle.sources),
        "views": [
            {"name": view.name, "parts": list(view.parts), **cameras_to_dict([view.camera])}
            for view in bundle.views
        ],
        "body": None if bundle.body is None else _body_record(bundle.body),
        "pattern": None if bundle.pattern is None else to_specification(bundle.pattern),
    }
    return to_plain(document), arrays


def from_record(
    document: Mapping[str, Any], arrays: Mapping[str, np.ndarray], *, source: str
) -> Bundle:
    """The bundle of a document and arrays.

    Args:
        document, arrays: from `to_record`.
        source: the file, for messages.

    Raises:
        InputError: another format, something is missing, or the content is malformed.
    """
    if not isinstance(document, Mapping) or document.get("format") != FORMAT:
        raise InputError(
            f"is not of format {FORMAT}, which this version reads",
            where=source,
            mend="make the bundle again",
        )
    pattern, body = document.get("pattern"), document.get("body")
    try:
        views = tuple(_view(entry, arrays) for entry in document["views"])
        landmarks = None
        if "landmarks/points" in arrays:
            landmarks = Landmarks(arrays["landmarks/points"], arrays["landmarks/confidence"])
        return Bundle(
            image=arrays.get("image"),
            matte=arrays.get("matte"),
            labels=arrays.get("labels"),
            landmarks=landmarks,
            body=None if body is None else _body(body),
            body_mesh=_surface("body_mesh", arrays),
            scan=_surface("scan", arrays),
            views=views,
            pattern=None if pattern is None else parse_specification(pattern, source=source),
            sources=document["sources"],
        )
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"lacks something ({error!r})", where=source, mend="make the bundle again"
        ) from error


def _body_record(body: BodyEstimate) -> dict[str, Any]:
    record = {name: getattr(body, name) for name in _BODY}
    return {**record, "scale": body.scale, "family": body.family.value}


def _body(record: Mapping[str, Any]) -> BodyEstimate:
    try:
        family = BodyFamily(record["family"])
    except ValueError as error:
        raise InputError(f"is {record['family']!r}", where="body, family") from error
    return BodyEstimate(
        **{name: record[name] for name in _BODY}, scale=record["scale"], family=family
    )


def _surface(part: str, arrays: Mapping[str, np.ndarray]) -> Surface | None:
    if f"{part}/vertices" not in arrays:
        return None
    return Surface(
        vertices=arrays[f"{part}/vertices"],
        faces=arrays[f"{part}/faces"],
        labels=arrays.get(f"{part}/labels"),
        colors=arrays.get(f"{part}/colors"),
    )


def _view(entry: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> View:
    name = entry["name"]
    place = f"views/{name}"
    landmarks = None
    if f"{place}/landmark-points" in arrays:
        landmarks = Landmarks(
            arrays[f"{place}/landmark-points"], arrays[f"{place}/landmark-confidence"]
        )
    return View(
        name=name,
        camera=cameras_from_dict(entry)[0],
        parts={part: arrays[f"{place}/part-{part}"] for part in entry["parts"]},
        normal=arrays.get(f"{place}/normal"),
        landmarks=landmarks,
        **{kind: arrays.get(f"{place}/{kind}") for kind in _VIEW_PICTURES},
    )
