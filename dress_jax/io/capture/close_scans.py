"""Scans of CloSe: points with normals, colours and clothes labels, and an SMPL body."""

from pathlib import Path

import numpy as np

from dress_jax.capture.body import BodyFamily, body_estimate
from dress_jax.capture.bundle import Bundle
from dress_jax.capture.checks import numbers
from dress_jax.capture.labels import convert_labels
from dress_jax.capture.surfaces import Surface
from dress_jax.core.errors import InputError
from dress_jax.io.arrays import read_npz
from dress_jax.io.capture.fields import field, within

_SOURCE = "CloSe"


def read_close(path: str | Path) -> Bundle:
    """The labelled scan, and its SMPL registration where it is there.

    Fields: `points` (n, 3), `faces` (f, 3), `colors` (n, 3), `labels` (n,), `pose` (72,), `betas`
    (10,), `trans` (3,). Points and body share a frame with +y up and metres; `scale`, by which
    the scan was brought to it, is not applied again.

    Raises:
        InputError: the file, its points or labels are missing, a shape is another one, or a label
            is unknown.
    """
    arrays = read_npz(path)
    points = numbers(f"{path}, points", field(arrays, "points", where=path), (None, 3))
    labels = np.asarray(field(arrays, "labels", where=path))
    if labels.shape != (len(points),):
        raise InputError(
            f"has shape {labels.shape} for {len(points)} points", where=f"{path}, labels"
        )
    if labels.dtype.kind == "f" and (labels == np.round(labels)).all():
        labels = labels.astype(np.int64)
    with within(path):
        own = convert_labels(labels, "close")
    faces = arrays.get("faces", np.zeros((0, 3), np.int64))
    scan = Surface(
        vertices=points,
        faces=faces.reshape(-1, 3),
        labels=own,
        colors=eight_bit(arrays.get("colors")),
    )
    body = None
    if all(name in arrays for name in ("pose", "betas", "trans")):
        body = body_estimate(
            numbers(f"{path}, pose", np.ravel(arrays["pose"]), (72,)).reshape(24, 3),
            np.ravel(arrays["betas"]),
            np.ravel(arrays["trans"]),
            family=BodyFamily.SMPL,
        )
    sources = {"scan": _SOURCE} | ({} if body is None else {"body": _SOURCE})
    return Bundle(scan=scan, body=body, sources=sources)


def eight_bit(colors: np.ndarray | None) -> np.ndarray | None:
    """Colours as 8-bit RGB, from 8 bits or from numbers in [0, 1] or [0, 255]; alpha is dropped."""
    if colors is None:
        return None
    colors = np.asarray(colors)[:, :3]
    if colors.dtype == np.uint8:
        return np.ascontiguousarray(colors)
    factor = 255.0 if colors.max(initial=0.0) <= 1.0 else 1.0
    return np.round(np.clip(factor * colors, 0.0, 255.0)).astype(np.uint8)
