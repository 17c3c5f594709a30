"""Folders of MagicMan: a photograph and its views from a ring around the person (S6.1, S6.2)."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from dress_jax.capture.bundle import Bundle
from dress_jax.capture.frames import generator_frame
from dress_jax.capture.views import View, matte_from_normals, matte_from_white, unit_normals
from dress_jax.core.errors import InputError
from dress_jax.io.capture.body_files import magicman_scale, read_magicman_body
from dress_jax.io.capture.pictures import read_coverage, read_pixels
from dress_jax.render.rings import magicman_cameras

BODY = "smplx_refined.json"
HALF_EXTENT = 1.0
"""Of the orthographic views, in MagicMan's units."""
_SOURCE = "MagicMan"


def read_magicman(folder: str | Path, *, height: float | None = None) -> Bundle:
    """The photograph, its matte, the ring of views, and the fitted body where it is there.

    Files: `ref_rgb.png`, `ref_mask.png`, `rgb/` and `normal/` with one picture per view named by
    azimuth (`000.png`, `018.png` ...), `smplx_refined.json`. Cameras are orthographic, the picture
    spans +-1 unit, view i stands i (360 // N) degrees towards -x; normals are in the frame of the
    front view, which is our world's. No mask is saved: the matte is the largest region of normals
    with unit length, or of what is not white where there are no normals.

    Args:
        folder: with `rgb/` or `normal/`, or both.
        height: of the person [m]; by default the fitted body gives the metre.

    Raises:
        InputError: views are missing, misnamed, or of different or oblong sizes, a matte is empty,
            or nothing gives the metre.
    """
    folder = Path(folder)
    names = _names(folder)
    colors = {name: _rgb(folder, name) for name in names}
    normals = {name: _decoded(folder, name) for name in names}
    mattes = {name: _matte(folder, name, colors[name], normals[name]) for name in names}
    first = mattes[names[0]]
    for name, matte in mattes.items():
        if matte.shape != (first.shape[0],) * 2:
            raise InputError(
                f"is {matte.shape[1]}x{matte.shape[0]}",
                where=f"{folder}, view {name}",
                mend="give square views of one size",
            )
    body = folder / BODY
    unit, floor = generator_frame(
        first,
        half_extent=HALF_EXTENT,
        height=height,
        unit=1.0 / magicman_scale(body) if body.is_file() else None,
    )
    cameras = magicman_cameras(
        len(names),
        center=np.array([0.0, floor, 0.0]),
        half_extent=HALF_EXTENT * unit,
        size=len(first),
    )
    views = []
    for name, camera in zip(names, cameras, strict=True):
        encoded = normals[name]
        views.append(
            View(
                name=name,
                camera=camera,
                rgb=colors[name],
                matte=mattes[name],
                normal=None if encoded is None else unit_normals(encoded, mattes[name]),
            )
        )
    image, matte = folder / "ref_rgb.png", folder / "ref_mask.png"
    parts = {
        "image": read_pixels(image)[0] if image.is_file() else None,
        "matte": read_coverage(matte) if matte.is_file() else None,
        "body": read_magicman_body(body, unit=unit, floor=floor) if body.is_file() else None,
        "views": tuple(views),
    }
    found = {part: value for part, value in parts.items() if value is not None}
    return Bundle(**found, sources=dict.fromkeys(found, _SOURCE))


def _names(folder: Path) -> list[str]:
    """Names of the views, which are azimuths at equal distances."""
    sets = {
        kind: sorted(path.stem for path in (folder / kind).glob("*.png"))
        for kind in ("rgb", "normal")
        if (folder / kind).is_dir()
    }
    names = next((found for found in sets.values() if found), [])
    if not names:
        raise InputError(
            "holds no views",
            where=str(folder),
            mend="give a folder with rgb/ or normal/ and one PNG per azimuth (000.png ...)",
        )
    for kind, found in sets.items():
        if found != names:
            odd = sorted(set(found) ^ set(names))[0]
            raise InputError(
                f"rgb/ and normal/ differ in view {odd}", where=str(folder / kind), mend="add it"
            )
    expected = [f"{i * (360 // len(names)):03d}" for i in range(len(names))]
    if names != expected:
        wrong = next(n for n, e in zip(names, expected, strict=True) if n != e)
        raise InputError(
            f"{len(names)} views are named {expected[0]}, {expected[1] if expected[1:] else ''} "
            f"..., not {wrong}",
            where=str(folder),
            mend="give the whole ring, with azimuths at equal distances",
        )
    return names


def _rgb(folder: Path, name: str) -> UInt8[np.ndarray, "h w 3"] | None:
    path = folder / "rgb" / f"{name}.png"
    return read_pixels(path)[0] if path.parent.is_dir() else None


def _decoded(folder: Path, name: str) -> Float[np.ndarray, "h w 3"] | None:
    path = folder / "normal" / f"{name}.png"
    return read_pixels(path)[0] / 127.5 - 1.0 if path.parent.is_dir() else None


def _matte(
    folder: Path, name: str, rgb: np.ndarray | None, normal: np.ndarray | None
) -> UInt8[np.ndarray, "h w"]:
    matte = None
    if normal is not None:
        matte = matte_from_normals(normal)
    elif rgb is not None:
        matte = matte_from_white(rgb)
    if matte is None or not matte.any():
        raise InputError(
            "shows nobody",
            where=f"{folder}, view {name}",
            mend="give normals as (n + 1) / 2, or colours in front of white",
        )
    return matte
