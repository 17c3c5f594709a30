"""The outline of a garment's mask: where it crosses lines of pixel centres, and how it moves.

The derivative of an antialiased mask tells what one pixel gains when the outline moves within it,
and nothing about a target that lies ten pixels further. A crossing of the outline moves linearly
with the vertices over any distance, so distances to a target outline can be linearized.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from dress_jax.core.buckets import bucket_size
from dress_jax.core.pytree import pytree, replace
from dress_jax.render.attributes import Visibility, find_visibility
from dress_jax.render.cameras import Camera, project
from dress_jax.render.mesh import RenderMesh, join_meshes
from dress_jax.render.silhouettes import next_half_edge


@pytree
class Contour:
    """Crossings of a mask's outline with rows and columns of pixel centres; padded.

    Attributes:
        along: coordinate of the crossing on its line [px], (q,).
        line: number of the row or column, (q,).
        before: the pixel centre before the crossing on its line; the next one lies behind, (q,).
        vertical: whether the line is a column, (q,).
        vertices: ends of the mesh edge that makes the outline, (q, 2).
        slope: derivative of `along` in the two vertices [px/m]; zero where the outline is one of
            the occluder, (q, 2, 3).
        used: entries that hold a crossing, (q,).
        face: face of the garment that each pixel centre sees, or -1, (h, w).
        unfinished: as in `Image`, ().
    """

    along: Float[Array, " q"]
    line: Int[Array, " q"]
    before: Int[Array, " q"]
    vertical: Bool[Array, " q"]
    vertices: Int[Array, "q 2"]
    slope: Float[Array, "q 2 3"]
    used: Bool[Array, " q"]
    face: Int[Array, "h w"]
    unfinished: Int[Array, ""]


def find_contours(
    cameras: Camera, garment: RenderMesh, occluder: RenderMesh | None = None
) -> Contour:
    """The outlines of the garment's visible part in several views (host).

    A picture could hold as many crossings as it has pairs of pixels; it holds a hundredth of them.
    So they are counted first, and then followed in arrays of a fitting size.

    Args:
        cameras: a stack of cameras.
        garment: the mesh whose mask it is.
        occluder: what hides it.

    Returns:
        A stack of contours.
    """
    seen = _visibilities(cameras, garment, occluder)
    room = seen.silhouettes.pair.shape[1]
    size = min(bucket_size(int(jnp.max(seen.silhouettes.count))), room)
    return _contours(cameras, garment, occluder, seen, size)


@jax.jit
def _visibilities(cameras: Camera, garment: RenderMesh, occluder: RenderMesh | None) -> Visibility:
    meshes = join_meshes(garment, occluder)
    return jax.lax.map(lambda camera: find_visibility(camera, *meshes), cameras)


@partial(jax.jit, static_argnames="size")
def _contours(
    cameras: Camera,
    garment: RenderMesh,
    occluder: RenderMesh | None,
    seen: Visibility,
    size: int,
) -> Contour:
    def view(pair: tuple[Camera, Visibility]) -> Contour:
        camera, visibility = pair
        found = visibility.silhouettes
        short = replace(found, pair=found.pair[:size], edge=found.edge[:size])
        return contour_of(camera, garment, occluder, replace(visibility, silhouettes=short))

    return jax.lax.map(view, (cameras, seen))


def contour_of(
    camera: Camera,
    garment: RenderMesh,
    occluder: RenderMesh | None,
    visibility: Visibility,
) -> Contour:
    """The outline in one view, of what is visible there.

    Args:
        camera: one camera.
        garment: the mesh whose mask it is.
        occluder: what hides it.
        visibility: of both meshes together.
    """
    positions, faces, _ = join_meshes(garment, occluder)
    own = garment.faces.shape[0]
    pixels, width = camera.height * camera.width, camera.width
    found = visibility.silhouettes
    pair, swapped = found.pair // 2, found.pair % 2 == 1
    vertical = pair >= pixels
    first = jnp.where(vertical, pair - pixels, pair)
    second = jnp.minimum(first + jnp.where(vertical, width, 1), pixels - 1)
    near, far = jnp.where(swapped, second, first), jnp.where(swapped, first, second)
    seen = (visibility.ids >= 0) & (visibility.ids < own)
    used = jnp.arange(pair.shape[0], dtype=jnp.int32) < found.count
    used = used & (seen[near] != seen[far])
    corner = faces.reshape(-1)
    vertices = jnp.stack([corner[found.edge], corner[next_half_edge(found.edge)]], axis=1)
    column, row = first % width, first // width
    line = jnp.where(vertical, column, row)
    crossing = jax.vmap(jax.value_and_grad(partial(_crossing, camera)))
    along, slope = crossing(positions[vertices], line.astype(positions.dtype), vertical)
    moves = used & seen[near]
    return Contour(
        along=along,
        line=line,
        before=jnp.where(vertical, row, column),
        vertical=vertical,
        vertices=vertices,
        slope=jnp.where(moves[:, None, None], slope, 0.0),
        used=used,
        face=jnp.where(seen, visibility.ids, -1).reshape(camera.height, camera.width),
        unfinished=found.unfinished,
    )


def _crossing(
    camera: Camera, ends: Float[Array, "2 3"], line: Float[Array, ""], vertical: Bool[Array, ""]
) -> Float[Array, ""]:
    """Where the image of an edge crosses a row or column, along that row or column [px]."""
    x, y, _ = project(camera, ends)
    s, v = jnp.where(vertical, y, x), jnp.where(vertical, x, y)
    step = v[1] - v[0]
    return s[0] + (line - v[0]) / jnp.where(step == 0, 1.0, step) * (s[1] - s[0])
