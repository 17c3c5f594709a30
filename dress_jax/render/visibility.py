"""Which triangle each pixel centre sees. Nothing here is differentiated.

Triangles are held as a structure of arrays. A triangle whose box of pixel centres fits a K x K
window is drawn by a loop over window offsets that is vectorised over triangles; larger ones are cut
into K x K tiles, and a data-dependent loop draws the tiles in chunks. No buffer has a capacity, so
none can overflow.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int

from dress_jax.core.pytree import pytree
from dress_jax.render.cameras import Camera, CameraKind, view_coordinates

WINDOW = 6
"""K: at 512 x 512 a garment's triangles are 3 to 6 pixels wide."""

TILE_CHUNK = 4096
"""Tiles drawn at a time."""


@pytree
class Screen:
    """Vertices as one camera sees them, float32.

    Args:
        x, y: pixel coordinates times `w`, shape (n,).
        w: 1 (orthographic) or depth [m] (perspective), shape (n,).
        depth: along the viewing direction [m], shape (n,).
    """

    x: Float[Array, "n"]
    y: Float[Array, "n"]
    w: Float[Array, "n"]
    depth: Float[Array, "n"]


def to_screen(
    camera: Camera, positions: Float[Array, "n 3"], *, dtype: DTypeLike = jnp.float32
) -> Screen:
    """Homogeneous pixel coordinates, which stay meaningful behind a perspective eye."""
    right, up, depth = view_coordinates(camera, positions)
    w = depth if camera.kind is CameraKind.PERSPECTIVE else jnp.ones_like(depth)
    x = camera.principal[0] * w + camera.scale[0] * right
    y = camera.principal[1] * w - camera.scale[1] * up
    return Screen(*(a.astype(dtype) for a in (x, y, w, depth)))


def pixel_coordinates(camera: Camera, screen: Screen) -> tuple[Array, Array, Array]:
    """Pixel x and y, shape (n,), and which vertices lie beyond the near plane, bool (n,)."""
    beyond = screen.depth > camera.near.astype(jnp.float32)
    if camera.kind is CameraKind.ORTHOGRAPHIC:
        return screen.x, screen.y, beyond
    w = jnp.where(beyond, screen.w, 1.0)
    return screen.x / w, screen.y / w, beyond


class _Triangles(NamedTuple):
    """Triangles in pixels: per edge a base point and a direction, per corner a depth key."""

    base_x: Float[Array, "3 t"]
    base_y: Float[Array, "3 t"]
    dx: Float[Array, "3 t"]
    dy: Float[Array, "3 t"]
    key: Float[Array, "3 t"]
    column: Int[Array, "t"]
    row: Int[Array, "t"]
    columns: Int[Array, "t"]
    rows: Int[Array, "t"]
    face: Int[Array, "t"]


def rasterize(
    camera: Camera, screen: Screen, faces: Int[Array, "f 3"]
) -> tuple[Int[Array, "p"], Float[Array, "p"]]:
    """The nearest triangle at every pixel centre; both sides of a triangle are seen.

    A centre on a shared edge belongs to both triangles, and the nearer is drawn. Edge functions
    start from the same end of an edge in both of its triangles, so that no crack opens between
    them.

    Args:
        camera: one camera.
        screen: vertices from `to_screen`.
        faces: vertex indices, shape (f, 3).

    Returns:
        Face of every pixel, -1 where there is none, and a depth key that grows with depth (infinite
        where there is no face); both flat, row by row, shape (height * width,).
    """
    size = camera.height * camera.width
    if faces.shape[0] == 0:
        return jnp.full(size, -1, jnp.int32), jnp.full(size, jnp.inf, jnp.float32)
    corners, extra = _clip(camera, screen, faces)
    index = jnp.arange(faces.shape[0], dtype=jnp.int32)
    triangles = _set_up(camera, corners, index)
    small = (triangles.columns <= WINDOW) & (triangles.rows <= WINDOW)
    windowed = triangles._replace(
        columns=jnp.where(small, triangles.columns, 0), rows=jnp.where(small, triangles.rows, 0)
    )
    tiled = triangles._replace(columns=jnp.where(small, 0, triangles.columns))
    if extra is not None:
        more = _set_up(camera, extra, index)
        tiled = jax.tree.map(lambda a, b: jnp.concatenate([a, b], axis=-1), tiled, more)
    buffers = (jnp.full(size, -1, jnp.int32), jnp.full(size, jnp.inf, jnp.float32))
    buffers = _draw_window(camera, windowed, buffers)
    return _draw_tiles(camera, tiled, buffers)


def _corner_arrays(camera: Camera, screen: Screen, faces: Array) -> tuple[Array, Array, Array]:
    """Pixel x, y and depth key of each triangle's corners, each (3, f)."""
    x, y, beyond = pixel_coordinates(camera, screen)
    if camera.kind is CameraKind.PERSPECTIVE:
        # -1 / depth grows with depth and is affine in the image.
        key = -1.0 / jnp.where(beyond, screen.depth, 1.0)
    else:
        key = screen.depth
    table = jnp.stack([x, y, key])
    corner = jnp.stack([table[:, faces[:, k]] for k in range(3)], axis=1)
    return corner[0], corner[1], corner[2]


def _clip(camera: Camera, screen: Screen, faces: Array):
    """Corners of what lies beyond the near plane: one triangle per face, and a second one where two
    of a face's corners lie beyond it. Empty triangles have all corners at infinity."""
    corner = _corner_arrays(camera, screen, faces)
    beyond = screen.depth > camera.near.astype(jnp.float32)
    inside = jnp.stack([beyond[faces[:, k]] for k in range(3)])
    whole = jnp.all(inside, axis=0)
    if camera.kind is CameraKind.ORTHOGRAPHIC:
        # Vertices on either side project alike, so cutting is left to the per-pixel depth test.
        some = jnp.any(inside, axis=0)
        return tuple(jnp.where(some, c, jnp.inf) for c in corner), None
    near = camera.near.astype(jnp.float32)

    def cut(_):
        # Turn each face so that its first corner is the one alone on its side of the plane.
        count = jnp.sum(inside, axis=0)
        lone = jnp.where(
            count == 1,
            jnp.argmax(inside, axis=0),
            jnp.argmin(inside, axis=0),
        )
        raw = jnp.stack([screen.x, screen.y, screen.depth])
        turned = [
            raw[:, jnp.take_along_axis(faces, ((lone + k) % 3)[:, None], axis=1)[:, 0]]
            for k in range(3)
        ]

        def crossing(a, b):
            step = b[2] - a[2]
            t = (near - a[2]) / jnp.where(step == 0, 1.0, step)
            point = a + t[None, :] * (b - a)
            return jnp.stack([point[0] / near, point[1] / near, jnp.full_like(t, -1.0 / near)])

        def seen(a):
            depth = jnp.where(a[2] > near, a[2], 1.0)
            return jnp.stack([a[0] / depth, a[1] / depth, -1.0 / depth])

        second, third = crossing(turned[0], turned[1]), crossing(turned[0], turned[2])
        one = jnp.stack([seen(turned[0]), second, third], axis=1)
        two = jnp.stack([second, seen(turned[1]), seen(turned[2])], axis=1)
        rest = jnp.stack([second, seen(turned[2]), third], axis=1)
        part = jnp.where((count == 1)[None, None, :], one, two)
        first = jnp.where(whole[None, None, :], jnp.stack(corner), part)
        first = jnp.where((count == 0)[None, None, :], jnp.inf, first)
        return first, jnp.where((count == 2)[None, None, :], rest, jnp.inf)

    def keep(_):
        first = jnp.where(jnp.any(inside, axis=0)[None, None, :], jnp.stack(corner), jnp.inf)
        return first, jnp.full_like(first, jnp.inf)

    split = jnp.any(inside, axis=0) & ~whole
    first, rest = jax.lax.cond(jnp.any(split), cut, keep, None)
    return tuple(first), tuple(rest)


def _set_up(camera: Camera, corners, face: Array) -> _Triangles:
    x, y, key = corners
    finite = jnp.all(jnp.isfinite(x) & jnp.isfinite(y) & jnp.isfinite(key), axis=0)
    x, y, key = (jnp.where(finite[None, :], a, 0.0) for a in (x, y, key))
    # Edge k lies opposite corner k.
    ax, ay = jnp.roll(x, -1, axis=0), jnp.roll(y, -1, axis=0)
    bx, by = jnp.roll(x, -2, axis=0), jnp.roll(y, -2, axis=0)
    swap = (bx < ax) | ((bx == ax) & (by < ay))
    base_x, base_y = jnp.where(swap, bx, ax), jnp.where(swap, by, ay)
    end_x, end_y = jnp.where(swap, ax, bx), jnp.where(swap, ay, by)
    area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
    sign = jnp.where(swap, -1.0, 1.0) * jnp.sign(area)[None, :]
    dx, dy = sign * (end_x - base_x), sign * (end_y - base_y)

    def span(values, limit):
        low = jnp.clip(jnp.ceil(jnp.min(values, axis=0)), 0, limit).astype(jnp.int32)
        high = jnp.clip(jnp.floor(jnp.max(values, axis=0)), -1, limit - 1).astype(jnp.int32)
        return low, jnp.where(finite & (area != 0), jnp.maximum(high - low + 1, 0), 0)

    column, columns = span(x, camera.width)
    row, rows = span(y, camera.height)
    return _Triangles(base_x, base_y, dx, dy, key, column, row, columns, rows, face)


def _draw_window(camera: Camera, t: _Triangles, buffers):
    """Draw triangles whose boxes fit one window, one offset of all triangles at a time."""
    wide = jnp.max(t.columns, initial=0)
    high = jnp.max(t.rows, initial=0)

    def body(i, buffers):
        dx, dy = i % wide, i // wide
        return _draw(
            camera, t, t.column + dx, t.row + dy, (dx < t.columns) & (dy < t.rows), buffers
        )

    return jax.lax.fori_loop(0, wide * high, body, buffers)


def _draw_tiles(camera: Camera, t: _Triangles, buffers):
    """Cut boxes into tiles and draw the tiles chunk by chunk."""
    across = -(-t.columns // WINDOW)
    tiles = jnp.where(t.columns > 0, across * -(-t.rows // WINDOW), 0)
    ends = jnp.cumsum(tiles)
    total = ends[-1]

    def body(state):
        start, buffers = state
        item = start + jnp.arange(TILE_CHUNK, dtype=ends.dtype)
        owner = jnp.minimum(jnp.searchsorted(ends, item, side="right"), ends.shape[0] - 1)
        local = item - (ends[owner] - tiles[owner])
        one = jax.tree.map(lambda a: a[..., owner], t)
        safe = jnp.maximum(across[owner], 1)
        left, top = WINDOW * (local % safe), WINDOW * (local // safe)
        live = item < total
        one = one._replace(
            column=one.column + left,
            row=one.row + top,
            columns=jnp.where(live, jnp.clip(one.columns - left, 0, WINDOW), 0),
            rows=jnp.where(live, jnp.clip(one.rows - top, 0, WINDOW), 0),
        )
        return start + TILE_CHUNK, _draw_window(camera, one, buffers)

    start = jnp.zeros((), ends.dtype)
    return jax.lax.while_loop(lambda s: s[0] < total, body, (start, buffers))[1]


def _draw(camera: Camera, t: _Triangles, column, row, active: Bool[Array, "t"], buffers):
    ids, keys = buffers
    px, py = column.astype(jnp.float32)[None, :], row.astype(jnp.float32)[None, :]
    edge = t.dx * (py - t.base_y) - t.dy * (px - t.base_x)
    total = edge[0] + edge[1] + edge[2]
    inside = active & (edge[0] >= 0) & (edge[1] >= 0) & (edge[2] >= 0) & (total > 0)
    # A convex combination: slivers cannot extrapolate to the front.
    key = (edge[0] * t.key[0] + edge[1] * t.key[1] + edge[2] * t.key[2]) / jnp.where(
        inside, total, 1.0
    )
    if camera.kind is CameraKind.ORTHOGRAPHIC:
        inside = inside & (key > camera.near.astype(jnp.float32))
    pixel = jnp.where(inside, row * camera.width + column, ids.shape[0])
    keys = keys.at[pixel].min(key, mode="drop")
    won = inside & (keys.at[pixel].get(mode="fill", fill_value=-jnp.inf) == key)
    ids = ids.at[jnp.where(won, pixel, ids.shape[0])].set(t.face, mode="drop")
    return ids, keys
