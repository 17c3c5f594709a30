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
from dress_jax.render.compaction import CHUNK, compact, padded_size

QUICK_STEPS = 2
"""Steps that every pair takes; most have met the other centre or a silhouette by then."""

STEP_LIMIT = 256
"""Triangles that a walk may cross within one pixel."""

_RUNNING, _NONE, _FOUND = 0, 1, 2


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
    edge: Int[Array, "q"]
    """Half-edge through which the walk leaves the triangle it is in."""
    along: Float[Array, "q"]
    """Where the line crosses that edge."""
    swapped: Int[Array, "q"]
    tries: Int[Array, "q"]
    status: Int[Array, "q"]


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
    step_limit: int = STEP_LIMIT,
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
    column = jnp.arange(pixels, dtype=jnp.int32) % width
    beside = (jnp.roll(ids, -1) != ids) & (column < width - 1)
    below = (jnp.roll(ids, -width) != ids) & (jnp.arange(pixels) < pixels - width)
    candidates, count = compact(jnp.concatenate([beside, below]))
    room = padded_size(2 * pixels)
    empty = Silhouettes(
        jnp.zeros(room, jnp.int32),
        jnp.zeros(room, jnp.int32),
        jnp.zeros((), jnp.int32),
        jnp.zeros((), jnp.int32),
    )
    if faces.shape[0] == 0:
        return empty

    def sweep(pairs, count, steps, found):
        """Walk all pairs; append what is found, and list the pairs that are still under way."""

        def body(state):
            start, found, open_pairs, open_count = state
            chunk = jax.lax.dynamic_slice(pairs, (start,), (CHUNK,))
            live = start + jnp.arange(CHUNK, dtype=jnp.int32) < count
            walk = _walk(mesh, ids, keys, width, chunk, live, steps)
            hit = (walk.status == _FOUND) & _owned(mesh, walk.edge, chunk >= pixels)
            rank = jnp.cumsum(hit.astype(jnp.int32))
            slot = jnp.where(hit, found.count + rank - 1, room)
            found = Silhouettes(
                found.pair.at[slot].set(2 * chunk + walk.swapped, mode="drop"),
                found.edge.at[slot].set(walk.edge, mode="drop"),
                found.count + rank[-1],
                found.unfinished,
            )
            running = walk.status == _RUNNING
            rank = jnp.cumsum(running.astype(jnp.int32))
            slot = jnp.where(running, open_count + rank - 1, room)
            open_pairs = open_pairs.at[slot].set(chunk, mode="drop")
            return start + CHUNK, found, open_pairs, open_count + rank[-1]

        zero = jnp.zeros((), jnp.int32)
        state = (zero, found, jnp.zeros(room, jnp.int32), zero)
        return jax.lax.while_loop(lambda s: s[0] < count, body, state)[1:]

    found, open_pairs, open_count = sweep(candidates, count, min(QUICK_STEPS, step_limit), empty)
    found, _, unfinished = sweep(open_pairs, open_count, step_limit, found)
    return Silhouettes(found.pair, found.edge, found.count, unfinished)


def _line(mesh: _Mesh, vertical, vertex):
    """Coordinates of vertices along and across the line through a pair's centres."""
    along = jnp.where(vertical, mesh.vertices, 0)
    return mesh.xy[vertex + along], mesh.xy[vertex + mesh.vertices - along]


def _end(half_edge):
    """The half-edge after this one in its face; it starts at this one's end."""
    return jnp.where(half_edge % 3 == 2, half_edge - 2, half_edge + 1)


def _owned(mesh: _Mesh, edge, vertical) -> Bool[Array, "q"]:
    s0, v0 = _line(mesh, vertical, mesh.corner[edge])
    s1, v1 = _line(mesh, vertical, mesh.corner[_end(edge)])
    across, along = jnp.abs(v1 - v0), jnp.abs(s1 - s0)
    return (across > along) | ((across == along) & ~vertical)


def _cross(s0, v0, s1, v1, line):
    step = v1 - v0
    return s0 + (line - v0) / jnp.where(step == 0, 1.0, step) * (s1 - s0)


def _walk(mesh: _Mesh, ids, keys, width, pair, live, steps) -> _Walk:
    pixels = ids.shape[0]
    vertical = pair >= pixels
    first = jnp.where(vertical, pair - pixels, pair)
    second = jnp.where(live, first + jnp.where(vertical, width, 1), 0)
    column, row = first % width, first // width
    line = jnp.where(vertical, column, row).astype(jnp.float32)
    at_first = jnp.where(vertical, row, column).astype(jnp.float32)
    swapped = (keys[second] < keys[first]).astype(jnp.int32)

    def enter(swapped):
        """Start in the triangle that the near centre sees; leave it towards the far centre."""
        face = ids[jnp.where(swapped == 1, second, first)]
        base = 3 * jnp.maximum(face, 0)
        forward = jnp.where(swapped == 1, -1.0, 1.0)
        s, v, seen = [], [], True
        for k in range(3):
            vertex = mesh.corner[base + k]
            sk, vk = _line(mesh, vertical, vertex)
            s.append(sk)
            v.append(vk)
            seen = seen & mesh.beyond[vertex]
        best, edge, crosses = jnp.full_like(line, -jnp.inf), base, False
        for k in range(3):
            m = (k + 1) % 3
            straddles = (v[k] >= line) != (v[m] >= line)
            reach = forward * _cross(s[k], v[k], s[m], v[m], line)
            better = straddles & (reach > best)
            best, edge = jnp.where(better, reach, best), jnp.where(better, base + k, edge)
            crosses = crosses | straddles
        ok = (face >= 0) & seen & crosses
        return edge, jnp.where(ok, forward * best, 0.0), ok

    edge, along, ok = enter(swapped)
    walk = _Walk(
        edge, along, swapped, jnp.zeros_like(swapped), jnp.where(live & ok, _RUNNING, _NONE)
    )

    def step(walk: _Walk) -> _Walk:
        forward = jnp.where(walk.swapped == 1, -1.0, 1.0)
        target = at_first + jnp.where(walk.swapped == 1, 0.0, 1.0)
        far = ids[jnp.where(walk.swapped == 1, first, second)]
        arrived = forward * walk.along >= forward * target
        # The surface goes on under the far centre, where something else is seen: that other surface
        # ends on the way here, even though it is deeper at its own centre.
        hidden = arrived & (far >= 0) & (walk.edge // 3 != far) & (walk.tries == 0)
        twin = mesh.twin[walk.edge]
        across = jnp.maximum(twin, 0)
        after = _end(across)
        last = _end(after)
        start, end, apex = mesh.corner[across], mesh.corner[after], mesh.corner[last]
        (s0, v0), (s1, v1), (s2, v2) = (_line(mesh, vertical, i) for i in (start, end, apex))
        up0, up1, up2 = v0 >= line, v1 >= line, v2 >= line
        # Which side of the edge the next triangle's apex lies on, the edge taken upwards.
        turn = ((s1 - s0) * (v2 - v0) - (v1 - v0) * (s2 - s0)) * jnp.where(up1, 1.0, -1.0)
        ends = (twin < 0) | (turn * forward > 0) | (up0 == up1)
        leave_after = up1 != up2
        edge = jnp.where(leave_after, after, last)
        along = jnp.where(leave_after, _cross(s1, v1, s2, v2, line), _cross(s2, v2, s0, v0, line))
        cut = ~mesh.beyond[apex] & (twin >= 0)
        status = jnp.where(arrived, _NONE, jnp.where(ends, _FOUND, jnp.where(cut, _NONE, _RUNNING)))
        again_edge, again_along, again_ok = enter(1 - walk.swapped)
        moved = _Walk(
            jnp.where(status == _RUNNING, edge, walk.edge),
            jnp.where(status == _RUNNING, along, walk.along),
            walk.swapped,
            walk.tries,
            status,
        )
        again = _Walk(
            again_edge,
            again_along,
            1 - walk.swapped,
            walk.tries + 1,
            jnp.where(again_ok, _RUNNING, _NONE),
        )
        running = walk.status == _RUNNING
        chosen = jax.tree.map(lambda a, b: jnp.where(hidden, a, b), again, moved)
        return jax.tree.map(lambda a, b: jnp.where(running, a, b), chosen, walk)

    def more(state):
        i, walk = state
        return (i < steps) & jnp.any(walk.status == _RUNNING)

    return jax.lax.while_loop(more, lambda s: (s[0] + 1, step(s[1])), (0, walk))[1]
