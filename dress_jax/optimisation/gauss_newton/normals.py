"""Differences between drawn and target normals at a grid of pixels, linearized (S10.8, S10.9).

Masks say nothing about what lies inside an outline; normals do: how cloth falls there, and which
way its folds run. A pixel keeps the triangle that it sees, as in every derivative of an image; the
normal changes because the triangle turns and because the surface moves under the pixel. Where the
surface ends, in either picture, no pixel is taken.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.ndimage
from jaxtyping import Array, Bool, Float, Int

from dress_jax.core.buckets import bucket_size
from dress_jax.core.pytree import pytree, replace
from dress_jax.render.cameras import Camera
from dress_jax.render.images import normals_at
from dress_jax.render.mesh import RenderMesh

_MARGIN = 1  # pixels between a sample and the end of either surface


@pytree
class Samples:
    """Pixels of all views, padded to the same number q in each.

    Args:
        face: of the garment, that the pixel sees, (v, q).
        column, row: of the pixel, (v, q).
        used: entries that hold a sample, (v, q).
        target: normals there, (v, q, 3).
    """

    face: Int[np.ndarray, "v q"]
    column: Int[np.ndarray, "v q"]
    row: Int[np.ndarray, "v q"]
    used: Bool[np.ndarray, "v q"]
    target: Float[np.ndarray, "v q 3"]


class NormalRows(NamedTuple):
    """Drawn minus target normals.

    Attributes:
        samples: where.
        residual: differences, zero in padding, (v, q, 3).
        weight: share of each sample in the mean, (v, q).
    """

    samples: Samples
    residual: Float[np.ndarray, "v q 3"]
    weight: Float[np.ndarray, "v q"]


def choose_samples(
    face: Int[np.ndarray, "v h w"],
    normal: Float[np.ndarray, "v h w 3"],
    region: Float[np.ndarray, "v h w"],
    stride: int,
) -> Samples:
    """Pixels on a grid that lie inside the garment in both pictures.

    Args:
        face: face of the drawn garment at every pixel, -1 elsewhere.
        normal: the target's.
        region: where the target's normals count.
        stride: of the grid [px].
    """
    structure = np.ones((1, 2 * _MARGIN + 1, 2 * _MARGIN + 1), dtype=bool)
    inside = np.asarray(scipy.ndimage.binary_erosion((face >= 0) & (region > 0.5), structure), bool)
    grid = np.zeros_like(inside)
    grid[:, stride // 2 :: stride, stride // 2 :: stride] = True
    chosen = [np.nonzero(view) for view in inside & grid]
    longest = max(len(rows) for rows, _ in chosen)
    count = bucket_size(max(longest, 1))
    fields = np.zeros((3, len(chosen), count), dtype=np.int32)
    used, target = np.zeros((len(chosen), count), bool), np.zeros((len(chosen), count, 3))
    for view, (rows, columns) in enumerate(chosen):
        own = slice(len(rows))
        fields[:, view, own] = face[view, rows, columns], columns, rows
        used[view, own] = True
        target[view, own] = normal[view, rows, columns]
    return Samples(*fields, used=used, target=target)


def normal_rows(cameras: Camera, garment: RenderMesh, samples: Samples) -> NormalRows:
    """The differences at some samples; the mean is over all of them."""
    drawn = np.asarray(_drawn_normals(cameras, garment, samples), np.float64)
    used = samples.used
    residual = np.where(used[..., None], drawn - samples.target, 0.0)
    return NormalRows(samples, residual, used / max(int(used.sum()), 1))


def normal_changes(
    cameras: Camera,
    garment: RenderMesh,
    samples: Samples,
    sensitivity: Float[np.ndarray, "n 3 r"],
) -> Float[np.ndarray, "v q 3 r"]:
    """Derivatives of the drawn normals along r ways of moving the garment."""
    along = jnp.moveaxis(jnp.asarray(sensitivity), -1, 0)
    return np.moveaxis(np.asarray(_normal_changes(cameras, garment, samples, along)), 1, -1)


def _at(camera: Camera, garment: RenderMesh, samples: Samples, positions: Array) -> Array:
    moved = replace(garment, positions=positions)
    return normals_at(camera, moved, (samples.face, samples.column, samples.row))


@jax.jit
def _drawn_normals(cameras: Camera, garment: RenderMesh, samples: Samples) -> Float[Array, "v q 3"]:
    return jax.lax.map(
        lambda view: _at(view[0], garment, view[1], garment.positions), (cameras, samples)
    )


@jax.jit
def _normal_changes(
    cameras: Camera, garment: RenderMesh, samples: Samples, along: Float[Array, "r n 3"]
) -> Float[Array, "v r q 3"]:
    def view(camera: Camera, own: Samples) -> Array:
        _, push = jax.linearize(partial(_at, camera, garment, own), garment.positions)
        return jax.vmap(push)(along)

    return jax.lax.map(lambda pair: view(*pair), (cameras, samples))
