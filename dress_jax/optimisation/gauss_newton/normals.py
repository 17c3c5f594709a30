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
import scipy.sparse
from jaxtyping import Array, Bool, Float, Int

from dress_jax.core.buckets import bucket_size
from dress_jax.core.pytree import pytree, replace
from dress_jax.render.attributes import attributes_at
from dress_jax.render.cameras import Camera
from dress_jax.render.images import normals_at, towards_camera
from dress_jax.render.mesh import RenderMesh, vertex_normals

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


def normal_jacobian(
    cameras: Camera, garment: RenderMesh, samples: Samples
) -> scipy.sparse.csr_array:
    """Derivative of the drawn normals in the garment's positions, shape (3 v q, 3 n).

    A pixel's normal depends on the corners of its triangle, which say where in it the pixel lies,
    and on their normals, and through these on all triangles around the corners.
    """
    faces = np.asarray(garment.faces)
    positions = np.asarray(garment.positions, np.float64)
    by_corner, by_normal = (np.asarray(part) for part in _local_slopes(cameras, garment, samples))
    view, place = np.nonzero(samples.used)
    rows = view * samples.used.shape[1] + place
    vertices = faces[samples.face[view, place]]
    shape = (samples.used.size, len(positions))
    direct, through = (
        _blocks(np.moveaxis(part[view, place], 2, 1), rows, vertices, shape)
        for part in (by_corner, by_normal)
    )
    return (direct + through.dot(_vertex_normal_slopes(positions, faces))).tocsr()


def _vertex_normal_slopes(
    positions: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "f 3"]
) -> scipy.sparse.csr_array:
    """Derivative of unit vertex normals in the positions, shape (3 n, 3 n).

    The area vector (b - a) x (c - a) of a triangle changes by e x d when a corner moves by d, with
    e the edge opposite to it; a vertex normal is the unit vector of the sum around the vertex.
    """
    count = len(positions)
    corners = positions[faces]
    opposite = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(positions)
    crossed = np.zeros((*faces.shape, 3, 3))
    for axis, (k, m) in enumerate(((1, 2), (2, 0), (0, 1))):
        crossed[:, :, axis, k], crossed[:, :, axis, m] = -opposite[:, :, m], opposite[:, :, k]
    parts = []
    for corner in range(3):
        np.add.at(total, faces[:, corner], area)
        parts.append(_blocks(crossed, faces[:, corner], faces, (count, count)))
    length = np.linalg.norm(total, axis=1)
    some = length > 0.0
    length = np.where(some, length, 1.0)
    unit = total / length[:, None]
    flat = np.eye(3)[None] - unit[:, :, None] * unit[:, None, :]
    flat *= np.where(some, 1.0 / length, 0.0)[:, None, None]
    every = np.arange(count)
    projection = _blocks(flat[:, None], every, every[:, None], (count, count))
    return projection.dot(parts[0] + parts[1] + parts[2]).tocsr()


def _blocks(
    values: Float[np.ndarray, "m k 3 3"],
    rows: Int[np.ndarray, " m"],
    columns: Int[np.ndarray, "m k"],
    shape: tuple[int, int],
) -> scipy.sparse.csr_array:
    """A sparse matrix of 3 x 3 blocks, k of them in each of m block rows."""
    axes = np.arange(3)
    row = np.broadcast_to((3 * rows)[:, None, None, None] + axes[:, None], values.shape)
    column = np.broadcast_to((3 * columns)[:, :, None, None] + axes, values.shape)
    entries = (values.ravel(), (row.ravel(), column.ravel()))
    return scipy.sparse.coo_array(entries, shape=(3 * shape[0], 3 * shape[1])).tocsr()


def _at(camera: Camera, garment: RenderMesh, samples: Samples, positions: Array) -> Array:
    moved = replace(garment, positions=positions)
    return normals_at(camera, moved, (samples.face, samples.column, samples.row))


@jax.jit
def _drawn_normals(cameras: Camera, garment: RenderMesh, samples: Samples) -> Float[Array, "v q 3"]:
    return jax.lax.map(
        lambda view: _at(view[0], garment, view[1], garment.positions), (cameras, samples)
    )


@jax.jit
def _local_slopes(
    cameras: Camera, garment: RenderMesh, samples: Samples
) -> tuple[Float[Array, "v q 3 3 3"], Float[Array, "v q 3 3 3"]]:
    """Derivatives of each sample's normal in its corners and in their normals: (component, corner,
    coordinate)."""
    normals = vertex_normals(garment.positions, garment.faces)
    triangle = jnp.arange(3)[None]

    def one(camera: Camera, corners: Array, own: Array, column: Array, row: Array) -> Array:
        seen = (jnp.zeros(1, jnp.int32), column[None], row[None])
        return attributes_at(camera, corners, triangle, own, seen, fragment=towards_camera)[0]

    def view(camera: Camera, own: Samples) -> tuple[Array, Array]:
        vertices = garment.faces[own.face]
        slopes = jax.vmap(jax.jacfwd(partial(one, camera), argnums=(0, 1)))
        return slopes(garment.positions[vertices], normals[vertices], own.column, own.row)

    return jax.lax.map(lambda pair: view(*pair), (cameras, samples))
