"""Views with fewer pixels: a fit follows outlines to a part of a pixel, and pays for every one."""

import dataclasses
import math

import numpy as np
from jaxtyping import Shaped

from dress_jax.capture.landmarks import Landmarks
from dress_jax.capture.views import View
from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace


def reduction_factor(views: tuple[View, ...], longest_side: int) -> int:
    """The smallest whole factor by which no view has a longer side.

    Raises:
        InputError: the side is not positive.
    """
    if longest_side < 1:
        raise InputError(f"is {longest_side} px", where="size of the views", mend="give pixels")
    sides = [max(view.camera.height, view.camera.width) for view in views]
    return max(1, *(math.ceil(side / longest_side) for side in sides))


def reduced_view(view: View, factor: int) -> View:
    """A view whose pixels are the means of blocks of `factor` by `factor`.

    Where the size is no multiple, the picture is first continued by its last row or column. The
    camera sees the same, continued rows apart.

    Args:
        view: any.
        factor: a whole number of at least 1.
    """
    if factor == 1:
        return view
    camera = view.camera
    principal = (np.asarray(camera.principal, float) + 0.5) / factor - 0.5
    smaller = replace(
        camera,
        scale=camera.scale / factor,
        principal=np.asarray(principal, np.asarray(camera.principal).dtype),
        height=math.ceil(camera.height / factor),
        width=math.ceil(camera.width / factor),
    )

    def bytes_of(picture: np.ndarray | None) -> np.ndarray | None:
        return None if picture is None else np.round(_means(picture, factor)).astype(np.uint8)

    landmarks = view.landmarks
    if landmarks is not None:
        points = (landmarks.points + 0.5) / factor - 0.5
        landmarks = Landmarks(points=points, confidence=landmarks.confidence)
    return dataclasses.replace(
        view,
        camera=smaller,
        rgb=bytes_of(view.rgb),
        matte=bytes_of(view.matte),
        mask=bytes_of(view.mask),
        parts={
            name: np.round(_means(part, factor)).astype(np.uint8)
            for name, part in view.parts.items()
        },
        hidden=bytes_of(view.hidden),
        normal=None if view.normal is None else _mean_normals(view.normal, factor),
        landmarks=landmarks,
    )


def _mean_normals(normal: np.ndarray, factor: int) -> np.ndarray:
    """Unit again; zero where less than half of a block has a surface."""
    mean = _means(normal, factor)
    covered = _means((np.abs(normal).sum(axis=-1) > 0.0).astype(float), factor) >= 0.5
    length = np.linalg.norm(mean, axis=-1)
    keep = (covered & (length > 0.1))[..., None]
    return np.where(keep, mean / np.where(keep, length[..., None], 1.0), 0.0).astype(np.float32)


def _means(picture: Shaped[np.ndarray, "h w *c"], factor: int) -> np.ndarray:
    """Means of blocks; borders are continued."""
    more = [(0, -side % factor) for side in picture.shape[:2]]
    padded = np.pad(picture.astype(float), [*more, *[(0, 0)] * (picture.ndim - 2)], mode="edge")
    height, width = (side // factor for side in padded.shape[:2])
    blocks = padded.reshape(height, factor, width, factor, *picture.shape[2:])
    return blocks.mean(axis=(1, 3))
