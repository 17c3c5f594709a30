"""A contact sheet of a bundle: image, labels, landmarks, views, on one picture."""

from collections.abc import Callable

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw

from dress_jax.capture.bundle import Bundle
from dress_jax.capture.labels import LABEL_COLORS
from dress_jax.capture.landmarks import LIMBS, USUAL_THRESHOLD, Landmarks
from dress_jax.capture.views import View

TILE = 192
"""Longest side of a picture on the sheet [px]."""
_CAPTION = 14
_COLUMNS = 8
_FADED = 0.35
_TINT = np.array([200, 70, 110], np.float64)


def contact_sheet(bundle: Bundle) -> UInt8[np.ndarray, "h w 3"]:
    """Small pictures with captions: those of the photograph first, then one row per kind of view.

    Parts that are no pictures (body, scan, pattern) are named in a caption.
    """
    rows = [_photograph(bundle)]
    kinds: dict[str, Callable[[View], np.ndarray | None]] = {
        "rgb": lambda view: view.rgb,
        "mask": _masked,
        "normal": _normals,
    }
    for kind, picture in kinds.items():
        found = [(f"{kind} {view.name}", picture(view)) for view in bundle.views]
        tiles = [(caption, pixels) for caption, pixels in found if pixels is not None]
        rows += [tiles[i : i + _COLUMNS] for i in range(0, len(tiles), _COLUMNS)]
    rows = [row for row in rows if row]
    others = [part for part in bundle.present if part not in ("image", "matte", "labels", "views")]
    width = TILE * max([len(row) for row in rows], default=1)
    height = (TILE + _CAPTION) * len(rows) + _CAPTION
    sheet = Image.new("RGB", (width, height), "white")
    draw = ImageDraw.Draw(sheet)
    for line, row in enumerate(rows):
        top = line * (TILE + _CAPTION)
        for column, (caption, pixels) in enumerate(row):
            draw.text((column * TILE + 2, top + 1), caption, fill="black")
            tile = Image.fromarray(pixels)
            tile.thumbnail((TILE - 2, TILE - 2))
            sheet.paste(tile, (column * TILE + 1, top + _CAPTION))
    draw.text((2, height - _CAPTION + 1), f"also: {', '.join(others) or 'nothing'}", fill="black")
    return np.array(sheet)


def _photograph(bundle: Bundle) -> list[tuple[str, np.ndarray]]:
    tiles: list[tuple[str, np.ndarray]] = []
    if bundle.image is not None:
        tiles.append(("image", bundle.image))
    if bundle.matte is not None:
        tiles.append(("matte", bundle.matte))
    if bundle.labels is not None:
        tiles.append(("labels", LABEL_COLORS[bundle.labels]))
    if bundle.landmarks is not None:
        tiles.append(("landmarks", _landmarks(bundle.landmarks, bundle.image)))
    return tiles


def _landmarks(landmarks: Landmarks, image: np.ndarray | None) -> np.ndarray:
    """Limbs and points over the paled image, or over white of their own extent."""
    found = landmarks.confidence >= USUAL_THRESHOLD
    if image is None:
        extent = landmarks.points[found].max(axis=0, initial=1.0)
        width, height = np.maximum(np.ceil(1.05 * extent), 16).astype(int)
        image = np.full((height, width, 3), 255, np.uint8)
    pale = 255.0 - _FADED * (255.0 - image.astype(np.float64))
    canvas = Image.fromarray(np.round(pale).astype(np.uint8))
    draw = ImageDraw.Draw(canvas)
    radius = max(canvas.size) / 150
    for a, b in LIMBS:
        if found[a] and found[b]:
            ends = [tuple(landmarks.points[a]), tuple(landmarks.points[b])]
            draw.line(ends, fill="navy", width=max(1, round(radius)))
    for x, y in landmarks.points[found]:
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill="crimson")
    return np.array(canvas)


def _masked(view: View) -> np.ndarray | None:
    """Clothes tinted on the view's colours; the matte where there is no mask."""
    if view.mask is None:
        return view.matte
    base = np.full((*view.mask.shape, 3), 255.0) if view.rgb is None else view.rgb.astype(float)
    weight = 0.6 * view.mask[..., None] / 255.0
    return np.round(base * (1.0 - weight) + _TINT * weight).astype(np.uint8)


def _normals(view: View) -> np.ndarray | None:
    if view.normal is None:
        return None
    covered = np.linalg.norm(view.normal, axis=-1, keepdims=True) > 0.0
    encoded = np.where(covered, 0.5 * (view.normal + 1.0), 1.0)
    return np.round(255.0 * np.clip(encoded, 0.0, 1.0)).astype(np.uint8)
