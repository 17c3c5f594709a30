"""Symmetric sparse matrices of 3x3 blocks: pattern on the host, values on the device.

Elements know the slots of their vertex pairs; assembling is one scatter-add per family, and the
step from blocks to compressed rows is one precomputed gather.
"""

import dataclasses
import functools
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
        entry: for each stored scalar its position in the flattened (capacity, 9) values.
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
    entry = (3 * i + j) + 9 * np.arange(len(unique))[:, None]
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


Values = Float[Array, "capacity 9"]


def empty_values(capacity: int) -> Values:
    """Zero blocks, component (i, j) in column 3 i + j."""
    return jnp.zeros((capacity, 9))


BlockRows = Float[Array, "entries 9"]


def block_rows(blocks: Sequence[Sequence[Array]]) -> BlockRows:
    """Element blocks as rows of nine entries, pair by pair.

    Args:
        blocks: 3x3 nested sequence of (pairs, m) arrays, already transposed where the slots say.
    """
    return jnp.stack([blocks[i][j].ravel() for i in range(3) for j in range(3)], axis=1)


@functools.partial(jax.jit, donate_argnums=0)
def add_rows(values: Values, rows: BlockRows, slots: Int[Array, "pairs m"]) -> Values:
    """Add block rows to the values with one scatter.

    A program of its own: fused with what computes the rows it would compute them one by one.

    Args:
        values: their memory is taken.
        rows: see `block_rows`.
        slots: slot of each pair.
    """
    return values.at[slots.ravel()].add(rows)


def first_and_second(
    stencil: Float[Array, "k *c m"], pairs: Sequence[tuple[int, int]], target: BlockSlots
) -> tuple[Array, Array]:
    """Per pair the values of its first and second vertex, swapped where the block is transposed.

    Args:
        stencil: something per stencil vertex and element, (k, m) or (k, c, m).

    Returns:
        Two arrays (pairs, m) or (pairs, c, m).
    """
    first = stencil[np.array([p for p, _ in pairs])]
    second = stencil[np.array([q for _, q in pairs])]
    swap = target.transposed
    if stencil.ndim == 3:
        swap = swap[:, None, :]
    return jnp.where(swap, second, first), jnp.where(swap, first, second)


def outer_rows(
    vectors: Float[Array, "k 3 m"],
    stiffness: Float[Array, " m"],
    pairs: Sequence[tuple[int, int]],
    target: BlockSlots,
) -> BlockRows:
    """Block rows s v_p v_q^T of rank-one element Hessians.

    Args:
        vectors: v per stencil vertex.
        stiffness: s per element.
    """
    first, second = first_and_second(vectors, pairs, target)
    scaled = first * stiffness[None, None, :]
    return block_rows([[scaled[:, i] * second[:, j] for j in range(3)] for i in range(3)])


def upper_triangle(pattern: BlockPattern, values: Values) -> scipy.sparse.csr_matrix:
    """The upper triangle as a scalar sparse matrix."""
    data = np.take(np.asarray(values).ravel(), pattern.entry)
    shape = (3 * pattern.size, 3 * pattern.size)
    return scipy.sparse.csr_matrix((data, pattern.indices, pattern.indptr), shape=shape)


def symmetric_product(
    upper: scipy.sparse.csr_matrix, vector: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """A symmetric matrix, given by its upper triangle, times a vector."""
    return upper @ vector + upper.T @ vector - upper.diagonal() * vector
