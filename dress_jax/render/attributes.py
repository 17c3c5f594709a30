"""Shading and antialiasing: the differentiable half, with a hand-written reverse rule.

Each pixel centre gets the interpolated attributes of the triangle it sees. Where a surface ends
between two neighbouring centres, at a fraction t of the way from the near one, the near surface
covers 1/2 + t pixels from its centre: for t < 1/2 the near pixel gets 1/2 - t of its neighbour's
value, else the far pixel gets t - 1/2 of the near value. That is the box-filtered coverage of a
straight edge along one axis, and its derivative in t is what carries a gradient to positions.
A pixel that would get more than its own area from its neighbours gets their weighted mean.

Autodiff of the whole chain of gathers is several times slower; here it only sees the arithmetic of
one chunk, and gathers and scatters are transposed by hand.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.core.pytree import pytree
from dress_jax.render.cameras import Camera
from dress_jax.render.compaction import CHUNK, compact
from dress_jax.render.silhouettes import STEP_LIMIT, Silhouettes, find_silhouettes, next_half_edge
from dress_jax.render.visibility import Screen, pixel_coordinates, rasterize, to_screen

Fragment = Callable[[Float[Array, "q c"], Float[Array, "q"]], Float[Array, "q d"]]
"""Per-pixel function of interpolated attributes and facing (+1 if the face runs counter-clockwise
in the picture, else -1), applied before antialiasing."""

Pixels = Int[Array, "q"] | Int[np.ndarray, "q"]
Seen = tuple[Pixels, Pixels, Pixels]
"""Face, column and row of some pixels."""


def identity_fragment(values: Float[Array, "q c"], facing: Float[Array, "q"]) -> Array:
    """The interpolated attributes as they are."""
    del facing
    return values


@pytree
class Visibility:
    """What a camera sees; holds no derivative.

    Args:
        ids: face of every pixel, -1 for background, shape (height * width,).
        keys: depth keys, shape (height * width,).
        pixels: pixels that see a face, shape (q,), the first `covered` of them in use.
        covered: their number, shape ().
        silhouettes: where surfaces end.
    """

    ids: Int[Array, "p"]
    keys: Float[Array, "p"]
    pixels: Int[Array, "q"]
    covered: Int[Array, ""]
    silhouettes: Silhouettes


def find_visibility(
    camera: Camera,
    positions: Float[Array, "n 3"],
    faces: Int[Array, "f 3"],
    adjacency: Int[Array, "f 3"],
    *,
    step_limit: int | Int[Array, ""] = STEP_LIMIT,
) -> Visibility:
    """Visible faces and silhouettes; no derivative passes through.

    Args:
        camera: one camera.
        positions: vertices [m], shape (n, 3).
        faces: vertex indices, shape (f, 3).
        adjacency: twin half-edges from `build_adjacency`, shape (f, 3).
        step_limit: triangles that a silhouette walk may cross; walks that meet it are counted in
            `silhouettes.unfinished`.
    """
    camera, positions = jax.lax.stop_gradient((camera, positions))
    screen = to_screen(camera, positions)
    ids, keys = rasterize(camera, screen, faces)
    pixels, covered = compact(ids >= 0)
    x, y, beyond = pixel_coordinates(camera, screen)
    silhouettes = find_silhouettes(
        x, y, beyond, faces, adjacency, ids, keys, width=camera.width, step_limit=step_limit
    )
    return Visibility(ids, keys, pixels, covered, silhouettes)


def render_attributes(
    camera: Camera,
    positions: Float[Array, "n 3"],
    faces: Int[Array, "f 3"],
    attributes: Float[Array, "n c"],
    adjacency: Int[Array, "f 3"],
    *,
    background: Float[Array, "d"],
    fragment: Fragment = identity_fragment,
    visibility: Visibility | None = None,
) -> Float[Array, "h w d"]:
    """Any number of vertex attributes as one antialiased image, float32.

    Differentiable in positions, attributes, background and camera, with visibility held fixed:
    through interpolation inside a surface, and through the blend where a surface ends (S10.10).

    Args:
        camera: one camera.
        positions: vertices [m], shape (n, 3); float64 is cast.
        faces: vertex indices, shape (f, 3).
        attributes: one row per vertex, shape (n, c).
        adjacency: twin half-edges from `build_adjacency`, shape (f, 3).
        background: value where no face is seen, shape (d,).
        fragment: see `Fragment`; d channels come out of it.
        visibility: from `find_visibility` for the same arguments; computed when None.

    Returns:
        Image of shape (height, width, d).
    """
    if faces.shape[0] == 0:
        shape = (camera.height, camera.width, background.shape[0])
        return jnp.broadcast_to(background.astype(jnp.float32)[None, None, :], shape)
    if visibility is None:
        visibility = find_visibility(camera, positions, faces, adjacency)
    screen = to_screen(camera, positions)
    x, y, _ = pixel_coordinates(camera, screen)
    image = _shade(
        (camera.height, camera.width, fragment),
        _vertex_table(screen, attributes),
        jnp.stack([x, y], axis=1),
        background.astype(jnp.float32),
        faces,
        visibility,
    )
    return image.reshape(camera.height, camera.width, -1)


def attributes_at(
    camera: Camera,
    positions: Float[Array, "n 3"],
    faces: Int[Array, "f 3"],
    attributes: Float[Array, "n c"],
    seen: Seen,
    *,
    fragment: Fragment = identity_fragment,
) -> Float[Array, "q d"]:
    """Attributes where pixels see given faces, without antialiasing.

    Made of plain arithmetic in the precision of the positions, so unlike an image it can be
    differentiated forward too.

    Args:
        camera: one camera.
        positions: vertices [m], shape (n, 3).
        faces: vertex indices, shape (f, 3).
        attributes: of the vertices, shape (n, c).
        seen: face, column and row of every pixel, each of shape (q,).
        fragment: see `Fragment`.
    """
    face, column, row = (jnp.asarray(part) for part in seen)
    table = _vertex_table(to_screen(camera, positions, dtype=positions.dtype), attributes)
    corners = [table[faces[face, k]] for k in range(3)]
    return _interpolate(corners, column.astype(table.dtype), row.astype(table.dtype), fragment)


def _vertex_table(screen: Screen, attributes: Array) -> Array:
    """Rows (x, y, w, attributes): one gather per corner fetches all a pixel needs."""
    head = jnp.stack([screen.x, screen.y, screen.w], axis=1)
    return jnp.concatenate([head, attributes.astype(head.dtype)], axis=1)


def _interpolate(rows, px, py, fragment: Fragment):
    """Attributes where the rays through pixel centres meet the planes of their triangles."""
    u = [r[:, 0] - px * r[:, 2] for r in rows]
    v = [r[:, 1] - py * r[:, 2] for r in rows]
    weight = [u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3] for k in range(3)]
    total = weight[0] + weight[1] + weight[2]
    inverse = 1.0 / jnp.where(total == 0, 1.0, total)
    # Differences, so that constant attributes have an exactly zero derivative (S10.9).
    base = rows[0][:, 3:]
    values = (
        base
        + (weight[1] * inverse)[:, None] * (rows[1][:, 3:] - base)
        + (weight[2] * inverse)[:, None] * (rows[2][:, 3:] - base)
    )
    # Rows grow downward, so a counter-clockwise face has negative area in pixel coordinates.
    return fragment(values, jax.lax.stop_gradient(jnp.where(total < 0, 1.0, -1.0)))


def _covered_chunk(visibility: Visibility, faces, start, width):
    pixel = jax.lax.dynamic_slice(visibility.pixels, (start,), (CHUNK,))
    live = start + jnp.arange(CHUNK, dtype=jnp.int32) < visibility.covered
    face = jnp.where(live, visibility.ids[pixel], 0)
    corner = faces[face]
    px, py = (pixel % width).astype(jnp.float32), (pixel // width).astype(jnp.float32)
    return pixel, live, corner, px, py


def _fraction(xy0, xy1, line, near, forward, vertical):
    """Where an edge crosses the line between two centres, measured from the near one [px]."""
    s0, v0 = jnp.where(vertical, xy0[:, 1], xy0[:, 0]), jnp.where(vertical, xy0[:, 0], xy0[:, 1])
    s1, v1 = jnp.where(vertical, xy1[:, 1], xy1[:, 0]), jnp.where(vertical, xy1[:, 0], xy1[:, 1])
    step = v1 - v0
    t = (line - v0) / jnp.where(step == 0, 1.0, step)
    return forward * (s0 + t * (s1 - s0) - near)


def _pair_chunk(silhouettes: Silhouettes, faces, start, width, pixels):
    """Near and far pixels, edge ends and line data of a chunk of silhouette pairs."""
    code = jax.lax.dynamic_slice(silhouettes.pair, (start,), (CHUNK,))
    edge = jax.lax.dynamic_slice(silhouettes.edge, (start,), (CHUNK,))
    live = start + jnp.arange(CHUNK, dtype=jnp.int32) < silhouettes.count
    pair, swapped = code // 2, code % 2 == 1
    vertical = pair >= pixels
    first = jnp.where(vertical, pair - pixels, pair)
    second = first + jnp.where(vertical, width, 1)
    near, far = jnp.where(swapped, second, first), jnp.where(swapped, first, second)
    column, row = near % width, near // width
    line = jnp.where(vertical, column, row).astype(jnp.float32)
    center = jnp.where(vertical, row, column).astype(jnp.float32)
    corner = faces.reshape(-1)
    geometry = (line, center, jnp.where(swapped, -1.0, 1.0), vertical)
    return live, near, far, corner[edge], corner[next_half_edge(edge)], geometry


def _blend_terms(xy, silhouettes, faces, start, width, pixels):
    """Which pixel of each pair receives, which one gives, and how much; rounding may put a crossing
    just outside the two centres, where the weight saturates."""
    live, near, far, start_vertex, end_vertex, geometry = _pair_chunk(
        silhouettes, faces, start, width, pixels
    )
    t = _fraction(xy[start_vertex], xy[end_vertex], *geometry)
    takes_far = t >= 0.5
    into = jnp.where(live, jnp.where(takes_far, far, near), pixels)
    source = jnp.where(takes_far, near, far)
    weight = jnp.where(live, jnp.clip(jnp.abs(t - 0.5), 0.0, 0.5), 0.0)
    return into, source, weight, near, far, (start_vertex, end_vertex, geometry, live)


def _loop(count, body, state):
    """Run `body(start, state)` for every chunk below `count`."""

    def step(carry):
        start, state = carry
        return start + CHUNK, body(start, state)

    return jax.lax.while_loop(lambda c: c[0] < count, step, (jnp.zeros((), jnp.int32), state))[1]


def _base_image(static, table, background, faces, visibility):
    height, width, fragment = static
    pixels = height * width

    def body(start, image):
        pixel, live, corner, px, py = _covered_chunk(visibility, faces, start, width)
        value = _interpolate([table[corner[:, k]] for k in range(3)], px, py, fragment)
        return image.at[jnp.where(live, pixel, pixels)].set(value, mode="drop")

    image = jnp.broadcast_to(background[None, :], (pixels, background.shape[0]))
    return _loop(visibility.covered, body, image)


def _total_weight(xy, faces, visibility, width):
    pixels = visibility.ids.shape[0]

    def body(start, total):
        into, _, weight, *_ = _blend_terms(xy, visibility.silhouettes, faces, start, width, pixels)
        return total.at[into].add(weight, mode="drop")

    return _loop(visibility.silhouettes.count, body, jnp.zeros(pixels, jnp.float32))


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _shade(static, table, xy, background, faces, visibility: Visibility):
    return _shade_forward(static, table, xy, background, faces, visibility)[0]


def _shade_forward(static, table, xy, background, faces, visibility: Visibility):
    height, width, _ = static
    pixels = height * width
    base = _base_image(static, table, background, faces, visibility)
    total = _total_weight(xy, faces, visibility, width)

    def body(start, image):
        into, source, weight, *_ = _blend_terms(
            xy, visibility.silhouettes, faces, start, width, pixels
        )
        share = weight / jnp.maximum(total[into], 1.0)
        change = share[:, None] * (base[source] - base[into])
        return image.at[into].add(change, mode="drop")

    image = _loop(visibility.silhouettes.count, body, base)
    return image, (table, xy, faces, visibility, base, total)


def _shade_backward(static, residuals, cotangent):
    height, width, fragment = static
    pixels = height * width
    table, xy, faces, visibility, base, total = residuals

    # Pixels whose weights are normalised: the derivative of the common denominator.
    def gather_excess(start, excess):
        into, source, weight, *_ = _blend_terms(
            xy, visibility.silhouettes, faces, start, width, pixels
        )
        slope = jnp.sum(cotangent[into] * (base[source] - base[into]), axis=1)
        return excess.at[into].add(weight * slope, mode="drop")

    excess = _loop(visibility.silhouettes.count, gather_excess, jnp.zeros(pixels, jnp.float32))

    def blend(start, state):
        to_base, to_xy = state
        into, source, weight, near, far, rest = _blend_terms(
            xy, visibility.silhouettes, faces, start, width, pixels
        )
        start_vertex, end_vertex, geometry, live = rest
        scale = jnp.maximum(total[into], 1.0)
        g = cotangent[into]
        part = (weight / scale)[:, None] * g
        to_base = to_base.at[jnp.where(live, source, pixels)].add(part, mode="drop")
        to_base = to_base.at[into].add(-part, mode="drop")
        # More t always means more of the near surface, whichever pixel receives.
        slope = jnp.sum(g * (base[near] - base[far]), axis=1)
        sign = jnp.where(into == far, 1.0, -1.0)
        over = jnp.where(total[into] > 1.0, sign * excess[into] / scale, 0.0)
        slope = jnp.where(live, (slope - over) / scale, 0.0)
        _, pull = jax.vjp(lambda a, b: _fraction(a, b, *geometry), xy[start_vertex], xy[end_vertex])
        for vertex, value in zip((start_vertex, end_vertex), pull(slope), strict=True):
            to_xy = to_xy.at[vertex].add(value)
        return to_base, to_xy

    to_base, to_xy = _loop(visibility.silhouettes.count, blend, (cotangent, jnp.zeros_like(xy)))

    def interpolate(start, to_table):
        pixel, live, corner, px, py = _covered_chunk(visibility, faces, start, width)
        rows = [table[corner[:, k]] for k in range(3)]
        _, pull = jax.vjp(lambda r: _interpolate(r, px, py, fragment), rows)
        (pulled,) = pull(jnp.where(live[:, None], to_base[pixel], 0.0))
        for k in range(3):
            to_table = to_table.at[corner[:, k]].add(pulled[k])
        return to_table

    to_table = _loop(visibility.covered, interpolate, jnp.zeros_like(table))
    to_background = jnp.sum(jnp.where((visibility.ids < 0)[:, None], to_base, 0.0), axis=0)
    return to_table, to_xy, to_background, None, None


_shade.defvjp(_shade_forward, _shade_backward)
