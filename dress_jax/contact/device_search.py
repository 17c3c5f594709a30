"""The broad phase in compiled code: which primitives come close, by trees on the device.

The same pairs as `broad_phase.find_candidates`, by the same two tests: boxes around the motion that
are within the radius of the pair, and a distance half-way that does not exceed the radius by more
than the parts can move. Two trees are descended together: of a pair of nodes whose boxes are close,
the larger one is split. Pairs of nodes wait on a stack, pairs of leaves in a queue, and a chunk of
either is worked on at a time. Stack and queue cannot overflow. Only the number of results is not
known before: they are counted beyond the capacity, and the caller repeats a search that had too
little of it.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from dress_jax.contact.broad_phase import ROUNDING
from dress_jax.contact.device_trees import ID_BITS, Boxes, Forest
from dress_jax.contact.potential import PairKind
from dress_jax.core.components import Components, add, dot, gather, scale, split, subtract
from dress_jax.geometry.distance import edge_edge_squared, vertex_face_squared

_NODE_BITS = 31
_QUEUED_CHUNKS = 16
UNUSED = jnp.iinfo(jnp.int64).max


class _State(NamedTuple):
    """Of a search.

    Attributes:
        waiting: the stack of pairs of nodes, then the queue of pairs of leaves.
        nodes: number of pairs of nodes on the stack.
        leaves: number of pairs of leaves in the queue.
        keys: of the pairs found, as many as fit.
        count: number of pairs found.
    """

    waiting: Int[Array, " w"]
    nodes: Int[Array, ""]
    leaves: Int[Array, ""]
    keys: Int[Array, " c"]
    count: Int[Array, ""]


@functools.partial(jax.jit, static_argnames=("kind", "chunk", "capacity"))
def search(
    forest: Forest,
    boxes: Boxes,
    start: Float[Array, "n 3"],
    end: Float[Array, "n 3"],
    radii: Float[Array, " n"],
    weld_ids: Int[Array, " n"],
    *,
    kind: PairKind,
    chunk: int,
    capacity: int,
) -> tuple[Int[Array, " c"], Int[Array, ""]]:
    """Keys of all pairs that can come within their radius, and how many there are.

    Args:
        forest: the trees.
        boxes: of the same motion and radii.
        start: positions [m], shape (n, 3).
        end: positions [m], shape (n, 3).
        radii: at the vertices [m], shape (n,); a pair has the smallest of its four.
        weld_ids: primitives that share one are no pair, shape (n,).
        kind: the family.
        chunk: number of pairs that are worked on at a time.
        capacity: number of keys that are returned.

    Returns:
        Keys in no order, `UNUSED` behind the last one, and the true count: where it exceeds the
        capacity, some keys are missing.
    """
    seeds = forest.vertex_face_seeds if kind is PairKind.VERTEX_FACE else forest.edge_edge_seeds
    # Pairs lie on the stack by the number of splits that led to them, and the last ones go first.
    # So the pairs of one number have all come from one chunk, or are seeds.
    stack = seeds.shape[1] + 2 * chunk * forest.splits
    queue = _QUEUED_CHUNKS * chunk
    state = _State(
        jnp.zeros(stack + queue, jnp.int64).at[: seeds.shape[1]].set(_packed(seeds[0], seeds[1])),
        jnp.asarray(seeds.shape[1], jnp.int32),
        jnp.zeros((), jnp.int32),
        jnp.full(capacity, UNUSED, jnp.int64),
        jnp.zeros((), jnp.int64),
    )
    columns = (split(start), split(end))

    def descend(state: _State) -> _State:
        begin = jnp.maximum(state.nodes - chunk, 0)
        taken = lax.dynamic_slice(state.waiting, (begin,), (chunk,))
        used = begin + jnp.arange(chunk, dtype=jnp.int32) < state.nodes
        done, parted, children = _tested(forest, boxes, taken, used)
        target, leaves = _targets(done, stack + state.leaves, len(state.waiting))
        first, nodes = _targets(parted, begin, len(state.waiting), stride=2)
        # One scatter: between two of them XLA would copy what waits.
        target = jnp.concatenate([jnp.where(done, target, first), first + 1])
        values = jnp.concatenate([jnp.where(done, taken, children[0]), children[1]])
        waiting = state.waiting.at[target].set(values, mode="drop", unique_indices=True)
        return state._replace(
            waiting=waiting, nodes=begin + 2 * nodes, leaves=state.leaves + leaves
        )

    def sift(state: _State) -> _State:
        begin = jnp.maximum(state.leaves - chunk, 0)
        taken = lax.dynamic_slice(state.waiting, (stack + begin,), (chunk,))
        used = begin + jnp.arange(chunk, dtype=jnp.int32) < state.leaves
        keys, close = _close(forest, taken, columns, radii, weld_ids, kind)
        target, number = _targets(used & close, state.count, capacity)
        keys = state.keys.at[target].set(keys, mode="drop", unique_indices=True)
        return state._replace(leaves=begin, keys=keys, count=state.count + number)

    def work(state: _State) -> _State:
        room = queue - chunk
        state = lax.while_loop(lambda s: (s.nodes > 0) & (s.leaves <= room), descend, state)
        return lax.while_loop(lambda s: s.leaves > 0, sift, state)

    state = lax.while_loop(lambda s: (s.nodes > 0) | (s.leaves > 0), work, state)
    return state.keys, state.count


def _targets(
    kept: Bool[Array, " m"], begin: Int[Array, ""], size: int, *, stride: int = 1
) -> tuple[Int[Array, " m"], Int[Array, ""]]:
    """Where lanes that are kept go when they are lined up from `begin`, and their number.

    Lanes that are not kept, and those that do not fit, get places of their own behind the end.
    """
    lanes = jnp.arange(len(kept), dtype=jnp.int32)
    rank = jnp.cumsum(kept, dtype=jnp.int32)
    target = begin + stride * (rank - 1)
    return jnp.where(kept & (target < size), target, size + stride * lanes), rank[-1]


def _packed(a: Int[Array, " m"], b: Int[Array, " m"]) -> Int[Array, " m"]:
    return (a.astype(jnp.int64) << _NODE_BITS) | b.astype(jnp.int64)


def _unpacked(pairs: Int[Array, " m"]) -> tuple[Int[Array, " m"], Int[Array, " m"]]:
    low = (1 << _NODE_BITS) - 1
    return (pairs >> _NODE_BITS).astype(jnp.int32), (pairs & low).astype(jnp.int32)


def _tested(
    forest: Forest, boxes: Boxes, pairs: Int[Array, " m"], used: Bool[Array, " m"]
) -> tuple[Bool[Array, " m"], Bool[Array, " m"], tuple[Array, Array]]:
    """Which pairs of nodes are close and leaves, which are close and no leaves, and their children.

    The children are those of the larger node, each with the other node.
    """
    a, b = _unpacked(pairs)
    squared = size_a = size_b = jnp.zeros(len(a))
    for low, high in zip(boxes.low, boxes.high, strict=True):
        low_a, high_a, low_b, high_b = low[a], high[a], low[b], high[b]
        gap = jnp.maximum(0.0, jnp.maximum(low_b - high_a, low_a - high_b))
        squared = squared + gap * gap
        size_a, size_b = size_a + (high_a - low_a), size_b + (high_b - low_b)
    radius = jnp.minimum(boxes.radius[a], boxes.radius[b])
    close = used & (radius >= 0.0) & (squared <= radius * radius * ROUNDING)
    # Within one tree, only pairs whose first leaf comes before the second: each pair once.
    close = close & (forest.first[a] + 1 < forest.last[b])
    leaf_a, leaf_b = a < forest.counts[0], b < forest.counts[0]
    splits_a = leaf_b | (~leaf_a & (size_a >= size_b))
    child = forest.child[jnp.where(splits_a, a, b)]
    one, other = (
        jnp.where(splits_a, _packed(node, b), _packed(a, node)) for node in (child, child + 1)
    )
    return close & leaf_a & leaf_b, close & ~(leaf_a & leaf_b), (one, other)


def _close(
    forest: Forest,
    pairs: Int[Array, " m"],
    columns: tuple[Components, Components],
    radii: Float[Array, " n"],
    weld_ids: Int[Array, " n"],
    kind: PairKind,
) -> tuple[Int[Array, " m"], Bool[Array, " m"]]:
    """Keys of pairs of leaves, and which of them are neither welded nor stay apart."""
    a, b = _unpacked(pairs)
    one, other = forest.leaf_ids[a], forest.leaf_ids[b]
    first, second = jnp.minimum(one, other), jnp.maximum(one, other)
    section = 2 * forest.is_body[first] + forest.is_body[second]
    key = section.astype(jnp.int64) << (2 * ID_BITS)
    key = key | (first.astype(jnp.int64) << ID_BITS) | second.astype(jnp.int64)
    corners = _corners(forest, first, second, kind)
    sides = 1 if kind is PairKind.VERTEX_FACE else 2
    welds = [weld_ids[corner] for corner in corners]
    welded = jnp.zeros(len(pairs), bool)
    for p in range(sides):
        for q in range(sides, 4):
            welded = welded | (welds[p] == welds[q])
    radius = functools.reduce(jnp.minimum, [radii[corner] for corner in corners])
    begin, end = ([gather(points, corner) for corner in corners] for points in columns)
    return key, ~welded & ~_stays_apart(begin, end, radius, kind)


def _corners(
    forest: Forest, first: Int[Array, " m"], second: Int[Array, " m"], kind: PairKind
) -> list[Int[Array, " m"]]:
    """The four vertices of pairs of primitives."""
    c = forest.corners
    if kind is PairKind.VERTEX_FACE:
        return [c[0][first], c[0][second], c[1][second], c[2][second]]
    return [c[0][first], c[1][first], c[0][second], c[1][second]]


def _stays_apart(
    start: list[Components], end: list[Components], radius: Array, kind: PairKind
) -> Bool[Array, " m"]:
    """Whether the distance half-way exceeds the radius by more than half of the relative motion."""
    half = tuple(scale(0.5, add(x, y)) for x, y in zip(start, end, strict=True))
    moved = [subtract(y, x) for x, y in zip(start, end, strict=True)]
    mean = scale(0.25, add(add(moved[0], moved[1]), add(moved[2], moved[3])))
    relative = [subtract(motion, mean) for motion in moved]
    n = [jnp.sqrt(dot(motion, motion)) for motion in relative]
    if kind is PairKind.VERTEX_FACE:
        squared = vertex_face_squared(half)
        speed = n[0] + jnp.maximum(n[1], jnp.maximum(n[2], n[3]))
    else:
        squared = edge_edge_squared(half)
        speed = jnp.maximum(n[0], n[1]) + jnp.maximum(n[2], n[3])
    # The slack covers rounding of the distance, also of slivers.
    first, second = subtract(half[1], half[3]), subtract(half[2], half[3])
    size = sum(jnp.abs(component) for component in (*first, *second))
    reach = radius + 0.5 * speed + 1e-7 * size
    return squared > reach * reach


@functools.partial(jax.jit, static_argnames=("kind", "capacity"))
def columns(
    forest: Forest,
    keys: Int[Array, " c"],
    count: Int[Array, ""],
    first_body: Int[Array, ""],
    body_offset: Int[Array, ""],
    scales: Float[Array, " s"] | None,
    *,
    kind: PairKind,
    capacity: int,
) -> tuple[Int[Array, "4 m"], Float[Array, " m"]]:
    """Vertices of sorted pairs, and the smallest scale of each; 0 and 1 where there is no pair.

    Args:
        forest: the trees.
        keys: from `search`, all of them.
        count: number of pairs, at most `capacity`.
        first_body: number of the body's first vertex in the mesh.
        body_offset: its number in the result.
        scales: at the vertices, numbered as in the result. Default: 1.
        kind: the family.
        capacity: number of columns.
    """
    keys = keys[:capacity]
    keys = jnp.sort(jnp.pad(keys, (0, capacity - len(keys)), constant_values=UNUSED))
    low = (1 << ID_BITS) - 1
    first, second = (keys >> ID_BITS) & low, keys & low
    used = jnp.arange(capacity, dtype=jnp.int32) < count
    first, second = jnp.where(used, first, 0), jnp.where(used, second, 0)
    corners = _corners(forest, first, second, kind)
    shifted = [
        jnp.where(corner < first_body, corner, corner + (body_offset - first_body))
        for corner in corners
    ]
    factors = jnp.ones(capacity)
    if scales is not None:
        factors = functools.reduce(jnp.minimum, [scales[corner] for corner in shifted])
    indices = jnp.stack([jnp.where(used, corner, 0) for corner in shifted])
    return indices, jnp.where(used, factors, 1.0)
