"""Where the entries of a sparse matrix of 3x3 blocks go in a two-level preconditioner.

All of it is index arrays, made on the host from the sparsity, and kept while that stays. Their
lengths come from buckets, so that a matrix with other contacts meets compiled programs.
"""

import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Float, Int

from dress_jax.core.buckets import bucket_size
from dress_jax.core.pytree import pytree
from dress_jax.solver.linear.partition import overlapping, partition, strengths

# Nodes of a patch without and with overlap, and in how many patches a node may be. Without overlap
# a draped T-shirt takes half as many iterations more; larger patches cost more than they save.
PATCH, PATCH_WITH_OVERLAP, SHARING = 16, 32, 3
# Aggregates: of so many nodes at least, and of more where there would be more than this many,
# because their dense matrix has six rows for each.
SMALLEST_AGGREGATE, AGGREGATES = 32, 300
# Blocks in a row of the product; longer rows are split. A regular triangle mesh with hinges has 13.
WIDTH = 14
_GROWTH = 1.2


@pytree
class Layout:
    """Index arrays; n is the padded number of nodes.

    Blocks are those of the upper triangle, then the same ones transposed. The last two of each half
    are spare: zero and the identity.

    Attributes:
        entries: of each block the places of its entries among the data of the matrix, after which
            come a zero and a one.
        rows, cols: nodes of the blocks.
        share: 1 of a block off the diagonal, 1/2 on it, 0 of a spare one.
        row_blocks, row_nodes: blocks of each row of the product, and the nodes they multiply.
        continued: nodes to which the rows after the first n belong.
        patch_nodes, patch_blocks: of the dense matrices of the first level; node n is none.
        places: of a node among the flattened patch nodes; the first place after them is none.
        aggregate: of each node; the first number after them is none.
        members: nodes of each aggregate; node n is none.
    """

    entries: Int[Array, "blocks 9"]
    rows: Int[Array, " blocks"]
    cols: Int[Array, " blocks"]
    share: Float[Array, " blocks"]
    row_blocks: Int[Array, "width rows"]
    row_nodes: Int[Array, "width rows"]
    continued: Int[Array, " rest"]
    patch_nodes: Int[Array, "patches p"]
    patch_blocks: Int[Array, "patches p p"]
    places: Int[Array, "sharing n"]
    aggregate: Int[Array, " n"]
    members: Int[Array, "aggregates m"]


def padded_data(data: Float[np.ndarray, " k"]) -> Float[np.ndarray, " capacity"]:
    """The data of a matrix as `Layout.entries` number them."""
    out = np.zeros(_capacity(len(data) + 2, 4096))
    out[: len(data)] = data
    out[-1] = 1.0
    return out


def make_layout(upper: scipy.sparse.csr_matrix) -> Layout:
    """The layout of matrices with one sparsity.

    Patches and aggregates are cut where this matrix couples weakly.

    Args:
        upper: upper triangle, (3 nodes, 3 nodes).
    """
    count = (len(upper.indptr) - 1) // 3
    n = _capacity(count, 64)
    rows, cols, entries = _upper_blocks(upper)
    capacity = len(entries)
    zero, one = capacity - 2, capacity - 1
    norms = np.linalg.norm(padded_data(upper.data)[entries[: len(rows)]], axis=1)
    graph = strengths(norms, rows, cols, count)

    # Both triangles, row by row.
    off = np.nonzero(rows != cols)[0]
    row = np.concatenate([rows, cols[off]])
    node = np.concatenate([cols, rows[off]])
    block = np.concatenate([np.arange(len(rows)), capacity + off])
    order = np.argsort(row, kind="stable")
    row, node, block = row[order], node[order], block[order]
    row_blocks, row_nodes, continued = _product_rows(row, node, block, count, n, zero)

    part, parts = partition(graph, PATCH)
    patches = overlapping(graph, part, parts, limit=PATCH_WITH_OVERLAP, sharing=SHARING)
    patch_nodes = np.full((_capacity(parts, 8), PATCH_WITH_OVERLAP), n)
    patch_nodes[:parts] = np.where(patches == count, n, patches)
    places = _places(patch_nodes, n)
    patch_blocks = _patch_blocks(places, patch_nodes, row, node, block, zero, one)

    size = bucket_size(-(-count // AGGREGATES), smallest=SMALLEST_AGGREGATE, growth=_GROWTH)
    part, parts = partition(graph, size)
    room = _capacity(parts, 8)
    aggregate = np.full(n, room)
    aggregate[:count] = part
    members = _members(part, parts, room, size, n)

    spare = capacity - len(rows)
    share = np.pad(np.where(rows == cols, 0.5, 1.0), (0, spare))
    return Layout(
        entries=_indices(entries),
        rows=_indices(np.pad(rows, (0, spare))),
        cols=_indices(np.pad(cols, (0, spare))),
        share=jnp.asarray(share),
        row_blocks=_indices(row_blocks),
        row_nodes=_indices(row_nodes),
        continued=_indices(continued),
        patch_nodes=_indices(patch_nodes),
        patch_blocks=_indices(patch_blocks),
        places=_indices(places),
        aggregate=_indices(aggregate),
        members=_indices(members),
    )


def _capacity(count: int, smallest: int) -> int:
    return bucket_size(count, smallest=smallest, growth=_GROWTH)


def _indices(array: np.ndarray) -> Int[Array, "..."]:
    return jnp.asarray(array, jnp.int32)


def _upper_blocks(
    upper: scipy.sparse.csr_matrix,
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"], Int[np.ndarray, "capacity 9"]]:
    """Nodes of the blocks that have an entry or are on the diagonal, and `Layout.entries`."""
    count = (len(upper.indptr) - 1) // 3
    scalar_rows = np.repeat(np.arange(3 * count), np.diff(upper.indptr))
    scalar_cols = upper.indices.astype(np.int64)
    diagonal = np.arange(count) * (count + 1)
    keys = scalar_rows // 3 * count + scalar_cols // 3
    unique, block = np.unique(np.concatenate([keys, diagonal]), return_inverse=True)
    rows, cols = unique // count, unique % count
    data_capacity = len(padded_data(upper.data))
    entries = np.full((_capacity(len(unique) + 2, 1024), 9), data_capacity - 2)
    place = 3 * (scalar_rows % 3) + scalar_cols % 3
    entries[block[: len(keys)], place] = np.arange(len(keys))
    square = entries[: len(unique)].reshape(-1, 3, 3)
    on_diagonal = rows == cols
    for i, j in ((0, 1), (0, 2), (1, 2)):
        square[on_diagonal, j, i] = square[on_diagonal, i, j]
    entries[-1, [0, 4, 8]] = data_capacity - 1
    return rows, cols, entries


def _product_rows(
    row: np.ndarray, node: np.ndarray, block: np.ndarray, count: int, n: int, zero: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Blocks and nodes of the rows, and the nodes of the rows that continue others."""
    start, degree = _starts(row, count)
    extra = -(-np.maximum(degree - WIDTH, 0) // WIDTH)
    first_extra = np.cumsum(extra) - extra
    place = np.arange(len(row)) - start[row]
    part = place // WIDTH
    target = np.where(part == 0, row, n + first_extra[row] + part - 1)
    rest = bucket_size(int(extra.sum()), smallest=256)
    blocks = np.full((WIDTH, n + rest), zero)
    nodes = np.zeros((WIDTH, n + rest), np.int64)
    blocks[place % WIDTH, target] = block
    nodes[place % WIDTH, target] = node
    continued = np.zeros(rest, np.int64)
    continued[: extra.sum()] = np.repeat(np.arange(count), extra)
    return blocks, nodes, continued


def _starts(keys: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Where each key begins in a sorted array, and how often it is there."""
    times = np.bincount(keys, minlength=count)
    return np.cumsum(times) - times, times


def _places(patch_nodes: np.ndarray, n: int) -> np.ndarray:
    flat = patch_nodes.ravel()
    order = np.argsort(flat, kind="stable")[: np.count_nonzero(flat < n)]
    node = flat[order]
    start, _ = _starts(node, n)
    places = np.full((SHARING, n), flat.size)
    places[np.arange(len(node)) - start[node], node] = order
    return places


def _patch_blocks(
    places: np.ndarray,
    patch_nodes: np.ndarray,
    row: np.ndarray,
    node: np.ndarray,
    block: np.ndarray,
    zero: int,
    one: int,
) -> np.ndarray:
    """Blocks of the dense matrices; the identity where there is no node."""
    patches, size = patch_nodes.shape
    out = np.full((patches, size, size), zero)
    diagonal = np.arange(size)
    out[:, diagonal, diagonal] = one
    for at_row in places:
        for at_col in places:
            first, second = at_row[row], at_col[node]
            patch = first // size
            inside = (patch == second // size) & (patch < patches)
            out[patch[inside], first[inside] % size, second[inside] % size] = block[inside]
    return out


def _members(part: np.ndarray, parts: int, room: int, size: int, n: int) -> np.ndarray:
    order = np.argsort(part, kind="stable")
    start, _ = _starts(part[order], parts)
    members = np.full((room, size), n)
    members[part[order], np.arange(len(part)) - start[part[order]]] = order
    return members
