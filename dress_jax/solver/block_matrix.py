"""Symmetric sparse matrices of 3x3 blocks: pattern on the host, values on the device.

Elements know the slots of their vertex pairs; assembling is a scatter-add per component, and the
step from blocks to compressed rows is one precomputed gather.
"""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Bool, Float, Int

from dress_jax.core.buckets import bucket_size
from dress_jax.core.pytree import pytree


@pytree
class BlockSlots:
    """Where the vertex pairs of a family of elements go.

    Attributes:
        slots: slot of each pair, (pairs, m).
        transposed: whether the block enters transposed, (pairs, m).
    """

    slots: Int[Array, "pairs m"]
    transposed: Bool[Array, "pairs m"]


@dataclasses.dataclass(frozen=True, eq=False)
class BlockPattern:
    """The upper block triangle of a symmetric matrix with `size` block rows.

    Attributes:
        rows, cols: block indices of each slot, sorted by row, then column, rows <= cols.
        capacity: length of the value arrays; at least one slot is spare and takes what belongs
            to fixed vertices.
        indptr, indices: compressed rows of the scalar upper triangle.
        entry: for each stored scalar its position in the flattened (9, capacity) values.
    """

    size: int
    rows: np.ndarray
    cols: np.ndarray
    capacity: int
    indptr: np.ndarray
    indices: np.ndarray
    entry: np.ndarray

    def find(self, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool]:
        """Slots of block pairs.

        Args:
            first, second: block indices of the same shape; an index >= `size` is a fixed vertex.

        Returns:
            Slots, transposition flags, and whether every pair has a slot.
        """
        low, high = np.minimum(first, second), np.maximum(first, second)
        keys = self.rows.astype(np.int64) * self.size + self.cols
        wanted = low.astype(np.int64) * self.size + high
        slots = np.searchsorted(keys, wanted)
        free = high < self.size
        known = keys[np.minimum(slots, len(keys) - 1)] == wanted
        complete = bool(np.all(known | ~free))
        slots = np.where(free, slots, self.capacity - 1)
        return slots.astype(np.int32), first > second, complete


def block_pattern(
    size: int, pairs: Sequence[tuple[np.ndarray, np.ndarray]], *, smallest: int = 4096
) -> BlockPattern:
    """The pattern that holds the diagonal and the given block pairs.

    Args:
        size: number of free vertices.
        pairs: (first, second) index arrays; pairs with an index >= size are left out.
    """
    diagonal = np.arange(size, dtype=np.int64)
    keys = [diagonal * size + diagonal]
    for first, second in pairs:
        low = np.minimum(first, second).astype(np.int64).ravel()
        high = np.maximum(first, second).astype(np.int64).ravel()
        free = high < size
        keys.append(low[free] * size + high[free])
    unique = np.unique(np.concatenate(keys))
    rows, cols = unique // size, unique % size
    capacity = bucket_size(len(unique) + 1, smallest=smallest)
    i, j = np.meshgrid(np.arange(3), np.arange(3), indexing="ij")
    i, j = i.ravel(), j.ravel()
    scalar_rows = 3 * rows[:, None] + i
    scalar_cols = 3 * cols[:, None] + j
    entry = (3 * i + j) * capacity + np.arange(len(unique))[:, None]
    upper = scalar_cols >= scalar_rows
    scalar_rows, scalar_cols, entry = scalar_rows[upper], scalar_cols[upper], entry[upper]
    order = np.argsort(scalar_rows * (3 * size) + scalar_cols, kind="stable")
    indptr = np.zeros(3 * size + 1, np.int64)
    np.cumsum(np.bincount(scalar_rows, minlength=3 * size), out=indptr[1:])
    return BlockPattern(
        size=size,
        rows=rows.astype(np.int32),
        cols=cols.astype(np.int32),
        capacity=capacity,
        indptr=indptr.astype(np.int32),
        indices=scalar_cols[order].astype(np.int32),
        entry=entry[order],
    )


def element_pairs(
    elements: np.ndarray, pairs: Sequence[tuple[int, int]]
) -> tuple[np.ndarray, np.ndarray]:
    """Block pairs of elements with vertices (k, m), as two (pairs, m) arrays."""
    first = np.stack([elements[p] for p, _ in pairs])
    second = np.stack([elements[q] for _, q in pairs])
    return first, second


def element_slots(pattern: BlockPattern, elements: np.ndarray, pairs: Sequence) -> BlockSlots:
    """Slots of elements whose pairs the pattern is known to hold."""
    slots, transposed, complete = pattern.find(*element_pairs(elements, pairs))
    if not complete:
        raise ValueError("the sparsity pattern lacks a block of these elements")
    return BlockSlots(jnp.asarray(slots), jnp.asarray(transposed))


Values = tuple[Array, ...]


def empty_values(capacity: int) -> Values:
    """Nine zero arrays, component (i, j) at position 3 i + j."""
    return tuple(jnp.zeros(capacity) for _ in range(9))


def scatter_blocks(
    values: Values, blocks: Sequence[Sequence[Sequence[Array]]], target: BlockSlots
) -> Values:
    """Add element blocks to the values.

    Args:
        blocks: for each pair a 3x3 nested list of (m,) arrays.
    """
    out = list(values)
    for i in range(3):
        for j in range(3):
            total = out[3 * i + j]
            for pair, block in enumerate(blocks):
                if i == j:
                    value = block[i][i]
                else:
                    value = jnp.where(target.transposed[pair], block[j][i], block[i][j])
                total = total.at[target.slots[pair]].add(value)
            out[3 * i + j] = total
    return tuple(out)


@jax.jit
def flatten_values(values: Values) -> Float[Array, " 9c"]:
    """The values as one array, as `BlockPattern.entry` counts."""
    return jnp.concatenate(values)


def upper_triangle(pattern: BlockPattern, values: Values) -> scipy.sparse.csr_matrix:
    """The upper triangle as a scalar sparse matrix."""
    data = np.take(np.asarray(flatten_values(values)), pattern.entry)
    shape = (3 * pattern.size, 3 * pattern.size)
    return scipy.sparse.csr_matrix((data, pattern.indices, pattern.indptr), shape=shape)
