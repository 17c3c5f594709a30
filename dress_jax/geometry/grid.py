"""Close pairs of primitives by a uniform grid, on the host.

Independent of the broad phase that the solver uses.
"""

import numpy as np
from jaxtyping import Float, Int

from dress_jax.core.native import compiled


def box_pairs(
    positions: Float[np.ndarray, "n 3"],
    first: Int[np.ndarray, "a i"],
    second: Int[np.ndarray, "b j"],
    reach: float,
) -> Int[np.ndarray, "k 2"]:
    """Primitives whose boxes are within `reach` of each other along every axis.

    Args:
        positions: vertices [m].
        first, second: vertices of the primitives of two sets.
        reach: [m].

    Returns:
        Sorted rows [first, second].
    """
    if not len(first) or not len(second):
        return np.zeros((0, 2), np.int64)
    boxes = []
    for rows in (first, second):
        corners = positions[rows]
        boxes.append((corners.min(axis=1) - 0.5 * reach, corners.max(axis=1) + 0.5 * reach))
    (low_a, high_a), (low_b, high_b) = boxes
    origin = np.minimum(low_a.min(axis=0), low_b.min(axis=0))
    extent = np.maximum(high_a.max(axis=0), high_b.max(axis=0)) - origin
    size = max(float(np.mean(high_b - low_b)), float(np.mean(high_a - low_a)), 1e-12)
    # A bounded number of cells: large primitives in a fine grid would fill it many times over.
    size = 2.0 * max(size, float(extent.max()) / 256.0)
    shape = (extent / size).astype(np.int64) + 1
    starts = np.zeros(int(np.prod(shape)) + 1, np.int64)
    _count_cells(low_b, high_b, origin, size, shape, starts)
    starts = np.cumsum(starts)
    entries = np.empty(starts[-1], np.int64)
    _fill_cells(low_b, high_b, origin, size, shape, starts[:-1].copy(), entries)
    pairs = np.empty((1 << 14, 2), np.int64)
    while True:
        grid = (origin, size, shape, starts, entries)
        count = _grid_pairs(low_a, high_a, low_b, high_b, *grid, pairs)
        if count <= len(pairs):
            break
        pairs = np.empty((count, 2), np.int64)
    pairs = pairs[:count]
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


@compiled
def _cell(value, axis, origin, size, shape):
    """The cell of a coordinate along an axis, limited to the grid."""
    return min(shape[axis] - 1, max(0, int((value - origin[axis]) / size)))


@compiled
def _cell_range(low, high, row, origin, size, shape):
    """First and last cell of a box along x, y and z."""
    return (
        _cell(low[row, 0], 0, origin, size, shape),
        _cell(high[row, 0], 0, origin, size, shape),
        _cell(low[row, 1], 1, origin, size, shape),
        _cell(high[row, 1], 1, origin, size, shape),
        _cell(low[row, 2], 2, origin, size, shape),
        _cell(high[row, 2], 2, origin, size, shape),
    )


@compiled
def _count_cells(low, high, origin, size, shape, starts):
    for row in range(low.shape[0]):
        i0, i1, j0, j1, k0, k1 = _cell_range(low, high, row, origin, size, shape)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                for k in range(k0, k1 + 1):
                    starts[(i * shape[1] + j) * shape[2] + k + 1] += 1


@compiled
def _fill_cells(low, high, origin, size, shape, free, entries):
    for row in range(low.shape[0]):
        i0, i1, j0, j1, k0, k1 = _cell_range(low, high, row, origin, size, shape)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                for k in range(k0, k1 + 1):
                    cell = (i * shape[1] + j) * shape[2] + k
                    entries[free[cell]] = row
                    free[cell] += 1


@compiled
def _grid_pairs(low_a, high_a, low_b, high_b, origin, size, shape, starts, entries, pairs):
    """Count overlapping boxes; rows go to `pairs` while they fit."""
    seen = np.full(low_b.shape[0], -1, np.int64)
    count = 0
    for row in range(low_a.shape[0]):
        i0, i1, j0, j1, k0, k1 = _cell_range(low_a, high_a, row, origin, size, shape)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                for k in range(k0, k1 + 1):
                    cell = (i * shape[1] + j) * shape[2] + k
                    for entry in range(starts[cell], starts[cell + 1]):
                        other = entries[entry]
                        if seen[other] == row:
                            continue
                        seen[other] = row
                        apart = False
                        for axis in range(3):
                            if (
                                low_a[row, axis] > high_b[other, axis]
                                or low_b[other, axis] > high_a[row, axis]
                            ):
                                apart = True
                        if apart:
                            continue
                        if count < pairs.shape[0]:
                            pairs[count, 0] = row
                            pairs[count, 1] = other
                        count += 1
    return count
