"""Where a surface ends between two neighbouring pixel centres. Nothing here is differentiated.

Between two centres that see different triangles, the nearer surface is followed from its own centre
towards the other one, triangle by triangle, until it ends (a boundary edge, or an edge where it
folds back) or until the other centre is reached. Looking only at the edges of the one visible
triangle would miss most silhouettes of finely meshed limbs.

The walk is combinatorial. The line through the two centres crosses exactly two edges of a triangle
whose corners lie on both sides of it; the walk enters through one and leaves through the other.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from dress_jax.core.pytree import pytree
from dress_jax.render.compaction import append, compact, padded_size

EARLY_STEPS = (2, 8)
"""Steps of the first sweeps over all pairs. Four of five pairs end in the first, and all but a few
in a hundred in the second; the few long walks are then gathered, so that none waits for them."""

WALK_CHUNK = 1 << 10
"""Pairs that walk together: the longest walk holds up its chunk."""

STEP_LIMIT = 256
"""Triangles that a walk may cross within one pixel."""

_RUNNING, _NONE, _FOUND, _HIDDEN = 0, 1, 2, 3


@pytree
class Silhouettes:
    """Pairs of neighbouring pixels between which a surface ends, in no particular order.

    Args:
        pair: 2 (direction * pixels + pixel) + swapped, shape (q,). Direction 0 is the pair
            (pixel, next column), 1 is (pixel, next row); swapped is 1 when the surface that ends
            is the one at the second centre.
        edge: half-edge at which it ends, shape (q,).
        count: entries in use, shape ().
        unfinished: walks that met the step limit and found nothing, shape ().
    """

    pair: Int[Array, "q"]
    edge: Int[Array, "q"]
    count: Int[Array, ""]
    unfinished: Int[Array, ""]


class _Mesh(NamedTuple):
    """What a walk reads: pixel coordinates (2 n,) x then y, and flat faces and twins (3 f,)."""

    xy: Float[Array, "2n"]
    beyond: Bool[Array, "n"]
    corner: Int[Array, "3f"]
    twin: Int[Array, "3f"]
    vertices: int


class _Walk(NamedTuple):
    """Walks under way: the half-edge through which each leaves the triangle it is in, where its
    line crosses that edge, and how it stands."""

    edge: Int[Array, "q"]
    along: Float[Array, "q"]
    status: Int[Array, "q"]


class _Pairs(NamedTuple):
    """Pairs to walk, as 4 pair + 2 swapped + 1 if the other surface was tried before."""

    code: Int[Array, "q"]
    count: Int[Array, ""]


def find_silhouettes(
    x: Float[Array, "n"],
    y: Float[Array, "n"],
    beyond: Bool[Array, "n"],
    faces: Int[Array, "f 3"],
    adjacency: Int[Array, "f 3"],
    ids: Int[Array, "p"],
    keys: Float[Array, "p"],
    *,
    width: int,
    step_limit: int | Int[Array, ""] = STEP_LIMIT,
) -> Silhouettes:
    """All neighbouring pixel pairs between which the nearer surface ends.

    An edge belongs to the horizontal pairs if it spans at least as many rows as columns, and to the
    vertical pairs otherwise; so each bit of contour is counted once.

    Args:
        x, y: pixel coordinates, shape (n,).
        beyond: whether a vertex lies beyond the near plane, shape (n,). Walks end without a result
            where the near plane cuts a triangle.
        faces: vertex indices, shape (f, 3).
        adjacency: twin half-edges, shape (f, 3).
        ids, keys: from `rasterize`, shape (height * width,).
        width: image width [px].
        step_limit: triangles that one walk may cross.
    """
    pixels = ids.shape[0]
    mesh = _Mesh(
        jnp.concatenate([x, y]), beyond, faces.reshape(-1), adjacency.reshape(-1), x.shape[0]
    )
    room = padded_size(2 * pixels)
    zero = jnp.zeros((), jnp.int32)
    found = Silhouettes(jnp.zeros(room, jnp.int32), jnp.zeros(room, jnp.int32), zero, zero)
    if faces.shape[0] == 0:
        return found

    def walk_chunk(todo: _Pairs, found: Silhouettes, code, live, steps, final):
        walk = _walk(mesh, ids, width, code, live, steps)
        running, hidden = walk.status == _RUNNING, walk.status == _HIDDEN
        hit = (walk.status == _FOUND) & _owned(mesh, walk.edge, code // 4 >= pixels)
        (pair, edge), count = append(
            (found.pair, found.edge), found.count, (code // 2, walk.edge), hit
        )
        unfinished = found.unfinished + jnp.where(final, jnp.sum(running, dtype=jnp.int32), 0)
        # The other surface: swapped turns round, and the last bit says that this is done.
        again = jnp.where(hidden, (code ^ 2) | 1, code)
        (listed,), left = append((todo.code,), todo.count, (again,), hidden | (running & ~final))
        return _Pairs(listed, left), Silhouettes(pair, edge, count, unfinished)

    def sweep(state):
        """Walk all pairs; list those to be walked on, or whose other surface is to be tried."""
        number, pairs, found = state
        final = number >= len(EARLY_STEPS)
        limits = jnp.asarray([*EARLY_STEPS, jnp.iinfo(jnp.int32).max], jnp.int32)
        steps = jnp.minimum(step_limit, limits[jnp.minimum(number, len(EARLY_STEPS))])

        def body(state):
            start, todo, found = state
            code = jax.lax.dynamic_slice(pairs.code, (start,), (WALK_CHUNK,))
            live = start + jnp.arange(WALK_CHUNK, dtype=jnp.int32) < pairs.count
            todo, found = walk_chunk(todo, found, code, live, steps, final)
            return start + WALK_CHUNK, todo, found

        state = (zero, _Pairs(jnp.zeros(room, jnp.int32), zero), found)
        _, todo, found = jax.lax.while_loop(lambda s: s[0] < pairs.count, body, state)
        return number + 1, todo, found

    # After the early sweeps: long walks, then those on the other surface that turned up in them.
    state = (zero, _candidates(ids, keys, width), found)
    return jax.lax.while_loop(lambda s: s[1].count > 0, sweep, state)[2]


def _candidates(ids, keys, width) -> _Pairs:
    """Pairs that see different faces; each starts at the centre that sees the nearer one."""
    pixels = ids.shape[0]
    index = jnp.arange(pixels, dtype=jnp.int32)
    beside = (jnp.roll(ids, -1) != ids) & (index % width < width - 1)
    below = (jnp.roll(ids, -width) != ids) & (index < pixels - width)
    pair, count = compact(jnp.concatenate([beside, below]))
    first = jnp.where(pair >= pixels, pair - pixels, pair)
    second = jnp.minimum(first + jnp.where(pair >= pixels, width, 1), pixels - 1)
    return _Pairs(4 * pair + 2 * (keys[second] < keys[first]), count)


def _line(mesh: _Mesh, vertical, vertex):
    """Coordinates of vertices along and across the line through a pair's centres."""
    along = jnp.where(vertical, mesh.vertices, 0)
    return mesh.xy[vertex + along], mesh.xy[vertex + mesh.vertices - along]


def next_half_edge(half_edge: Int[Array, "q"]) -> Int[Array, "q"]:
    """The half-edge after this one in its face; it starts where this one ends."""
    return jnp.where(half_edge % 3 == 2, half_edge - 2, half_edge + 1)


def _owned(mesh: _Mesh, edge, vertical) -> Bool[Array, "q"]:
    s0, v0 = _line(mesh, vertical, mesh.corner[edge])
    s1, v1 = _line(mesh, vertical, mesh.corner[next_half_edge(edge)])
    across, along = jnp.abs(v1 - v0), jnp.abs(s1 - s0)
    return (across > along) | ((across == along) & ~vertical)


def _cross(s0, v0, s1, v1, line):
    step = v1 - v0
    return s0 + (line - v0) / jnp.where(step == 0, 1.0, step) * (s1 - s0)


def _walk(mesh: _Mesh, ids, width, code, live, steps) -> _Walk:
    """Start in the triangle that the near centre sees; walk towards the far centre."""
    pixels = ids.shape[0]
    pair, swapped, tried = code // 4, (code & 2) == 2, (code & 1) == 1
    vertical = pair >= pixels
    first = jnp.where(vertical, pair - pixels, pair)
    second = jnp.where(live, first + jnp.where(vertical, width, 1), 0)
    column, row = first % width, first // width
    line = jnp.where(vertical, column, row).astype(jnp.float32)
    forward = jnp.where(swapped, -1.0, 1.0)
    # Coordinates along the line are taken along the walk, so that they grow with it.
    target = forward * (jnp.where(vertical, row, column) + jnp.where(swapped, 0, 1))
    near = ids[jnp.where(swapped, second, first)]
    far = ids[jnp.where(swapped, first, second)]

    base = 3 * jnp.maximum(near, 0)
    corner = [mesh.corner[base + k] for k in range(3)]
    s, v = zip(*(_line(mesh, vertical, c) for c in corner), strict=True)
    best, edge = jnp.full_like(line, -jnp.inf), base
    for k in range(3):
        m = (k + 1) % 3
        reach = forward * _cross(s[k], v[k], s[m], v[m], line)
        better = ((v[k] >= line) != (v[m] >= line)) & (reach > best)
        best, edge = jnp.where(better, reach, best), jnp.where(better, base + k, edge)
    seen = mesh.beyond[corner[0]] & mesh.beyond[corner[1]] & mesh.beyond[corner[2]]
    ok = live & (near >= 0) & seen & (best > -jnp.inf)
    walk = _Walk(edge, best, jnp.where(ok, _RUNNING, _NONE))

    def step(walk: _Walk) -> _Walk:
        arrived = walk.along >= target
        # The surface goes on under the far centre, where something else is seen: that other surface
        # ends on the way here, even though it is deeper at its own centre.
        hidden = arrived & (far >= 0) & (walk.edge // 3 != far) & ~tried
        twin = mesh.twin[walk.edge]
        across = jnp.maximum(twin, 0)
        after = next_half_edge(across)
        before = next_half_edge(after)
        apex = mesh.corner[before]
        s0, v0 = _line(mesh, vertical, mesh.corner[across])
        s1, v1 = _line(mesh, vertical, mesh.corner[after])
        s2, v2 = _line(mesh, vertical, apex)
        up0, up1, up2 = v0 >= line, v1 >= line, v2 >= line
        # On which side of the edge, taken upwards, the next triangle's apex lies.
        side = ((s1 - s0) * (v2 - v0) - (v1 - v0) * (s2 - s0)) * jnp.where(up1, forward, -forward)
        # An edge that the line does not cross on its other side is an open seam.
        ends = (twin < 0) | (side > 0) | (up0 == up1)
        through_after = up1 != up2
        edge = jnp.where(through_after, after, before)
        sa, va = jnp.where(through_after, s1, s0), jnp.where(through_after, v1, v0)
        along = forward * _cross(sa, va, s2, v2, line)
        status = jnp.where(ends, _FOUND, jnp.where(mesh.beyond[apex], _RUNNING, _NONE))
        status = jnp.where(arrived, jnp.where(hidden, _HIDDEN, _NONE), status)
        running = walk.status == _RUNNING
        moves = running & (status == _RUNNING)
        return _Walk(
            jnp.where(moves, edge, walk.edge),
            jnp.where(moves, along, walk.along),
            jnp.where(running, status, walk.status),
        )

    def more(state):
        i, walk = state
        return (i < steps) & jnp.any(walk.status == _RUNNING)

    return jax.lax.while_loop(more, lambda s: (s[0] + 1, step(s[1])), (0, walk))[1]
