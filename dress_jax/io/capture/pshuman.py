"""Folders of PSHuman: six views around the person (S6.2)."""

from pathlib import Path

import numpy as np

from dress_jax.capture.bundle import Bundle
from dress_jax.capture.frames import generator_frame
from dress_jax.capture.views import View, matte_from_normals, unit_normals
from dress_jax.core.errors import InputError
from dress_jax.io.capture.pictures import read_pixels
from dress_jax.render.rings import pshuman_cameras

VIEWS = ("front", "front_right", "right", "back", "left", "front_left")
"""In the order of `render.rings.PSHUMAN_AZIMUTHS`; "right" is the right of the front picture."""
MIRRORED = ("back", "left")
HALF_EXTENT = 2.0
"""Of the orthographic views, in PSHuman's units."""
_SOURCE = "PSHuman"


def read_pshuman(
    folder: str | Path, *, height: float | None = None, mirrored: bool = True
) -> Bundle:
    """The six views, from `color_VIEW_masked.png` and `normals_VIEW_masked.png`.

    Cameras are orthographic at azimuths 0, 45, 90, 180, 270, 315 degrees towards +x: "right"
    stands at +x, the wearer's left. The network draws back and left as mirror images; they are
    turned round here. Normals are in the world frame and are not changed by that: only the pixels'
    places are mirrored. The matte is the alpha channel, or else normals of unit length.

    Args:
        folder: with all six views.
        height: of the person [m]; nothing in the folder gives the metre.
        mirrored: whether back and left are stored as the network drew them; False for forks that
            turn them before saving.

    Raises:
        InputError: a view is missing, empty, or of another or oblong size, or no height is given.
    """
    folder = Path(folder)
    pictures = [_view(folder, name, mirrored and name in MIRRORED) for name in VIEWS]
    first = pictures[0][1]
    for name, (_, matte, _) in zip(VIEWS, pictures, strict=True):
        if matte.shape != (first.shape[0],) * 2:
            raise InputError(
                f"is {matte.shape[1]}x{matte.shape[0]}",
                where=f"{folder}, view {name}",
                mend="give square views of one size",
            )
    unit, floor = generator_frame(first, half_extent=HALF_EXTENT, height=height, unit=None)
    cameras = pshuman_cameras(
        center=np.array([0.0, floor, 0.0]), half_extent=HALF_EXTENT * unit, size=len(first)
    )
    views = tuple(
        View(name=name, camera=camera, rgb=rgb, matte=matte, normal=unit_normals(encoded, matte))
        for name, camera, (rgb, matte, encoded) in zip(VIEWS, cameras, pictures, strict=True)
    )
    return Bundle(views=views, sources={"views": _SOURCE})


def _view(folder: Path, name: str, mirror: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Colours, matte and decoded normals."""
    rgb, _ = read_pixels(_path(folder, "color", name))
    normal, alpha = read_pixels(_path(folder, "normals", name))
    encoded = normal / 127.5 - 1.0
    matte = matte_from_normals(encoded) if alpha is None else alpha
    if not matte.any():
        raise InputError("shows nobody", where=f"{folder}, view {name}", mend="check its alpha")
    if rgb.shape != normal.shape:
        raise InputError(
            "colours and normals differ in size", where=f"{folder}, view {name}", mend="resize them"
        )
    if mirror:
        return rgb[:, ::-1].copy(), matte[:, ::-1].copy(), encoded[:, ::-1].copy()
    return rgb, matte, encoded


def _path(folder: Path, kind: str, name: str) -> Path:
    for stem in (name, "front_face") if name == "front" else (name,):
        path = folder / f"{kind}_{stem}_masked.png"
        if path.is_file():
            return path
    raise InputError(
        f"holds no {kind}_{name}_masked.png",
        where=str(folder),
        mend="give a folder with all six views of PSHuman",
    )
