"""Axis-aligned box trees on the host: topology built once, boxes refitted for every query.

The tree is complete: its 2^depth leaves hold consecutive, equally long ranges of a primitive order
found by median splits, so the children of node k are 2k + 1 and 2k + 2 and there are no pointers.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from dress_jax.core.native import compiled

_LEAF_SIZE = 4


@dataclass(frozen=True)
class Tree:
    """Topology of a box tree.

    Attributes:
        order: primitives in leaf order, shape (n,).
        first: the range of `order` below node k is first[k] to last[k] - 1, shape (nodes,).
        last: see `first`, shape (nodes,).
    """

    order: Int[np.ndarray, "n"]
    first: Int[np.ndarray, "nodes"]
    last: Int[np.ndarray, "nodes"]


def build_tree(centres: Float[np.ndarray, "n 3"], *, depth: int | None = None) -> Tree:
    """Split primitives at the median of their widest axis, level by level.

    Args:
        centres: a point per primitive [m], shape (n, 3).
        depth: of the leaves, with less than half of them empty. Default: leaves of a few
            primitives, for traversals that go from leaf to leaf with little work in between.
    """
    n = len(centres)
    if depth is None:
        depth = 0
        while (n >> depth) > _LEAF_SIZE:
            depth += 1
    order = np.arange(n)
    for level in range(depth):
        bounds = _bounds(n, level)
        group = np.repeat(np.arange(1 << level), np.diff(bounds))
        points = centres[order]
        width = np.maximum.reduceat(points, bounds[:-1]) - np.minimum.reduceat(points, bounds[:-1])
        axis = np.argmax(width, axis=1)
        order = order[np.lexsort((points[np.arange(n), axis[group]], group))]
    levels = [_bounds(n, level) for level in range(depth + 1)]
    return Tree(
        order=order.astype(np.int32),
        first=np.concatenate([bounds[:-1] for bounds in levels]).astype(np.int32),
        last=np.concatenate([bounds[1:] for bounds in levels]).astype(np.int32),
    )


def _bounds(n: int, level: int) -> np.ndarray:
    """Ends of the 2^level ranges; those of the next level refine them."""
    return (np.arange((1 << level) + 1) * n) >> level


@compiled
def swept_boxes(start, end, primitives, order, boxes):
    """Boxes around primitives order[i] at both ends of a linear motion, into boxes (n, 6)."""
    for i in range(order.shape[0]):
        row = order[i]
        for axis in range(3):
            low, high = np.inf, -np.inf
            for corner in range(primitives.shape[1]):
                vertex = primitives[row, corner]
                a, b = start[vertex, axis], end[vertex, axis]
                low, high = min(low, a, b), max(high, a, b)
            boxes[i, axis] = low
            boxes[i, 3 + axis] = high


@compiled
def refit(leaf_boxes, first, last, node_boxes):
    """Boxes of all nodes (nodes, 6) from those of the primitives in leaf order (n, 6)."""
    nodes = first.shape[0]
    inner = nodes // 2
    for step in range(nodes):
        node = nodes - 1 - step
        for axis in range(3):
            low, high = np.inf, -np.inf
            if node >= inner:
                for i in range(first[node], last[node]):
                    low = min(low, leaf_boxes[i, axis])
                    high = max(high, leaf_boxes[i, 3 + axis])
            else:
                for child in (2 * node + 1, 2 * node + 2):
                    low = min(low, node_boxes[child, axis])
                    high = max(high, node_boxes[child, 3 + axis])
            node_boxes[node, axis] = low
            node_boxes[node, 3 + axis] = high
