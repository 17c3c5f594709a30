"""Parts of a weighted graph: compact, bounded in size, and cut where coupling is weak."""

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from dress_jax.core.native import compiled

_OLD_SHARE = 0.5  # weight of ties to finished parts: leaves no islands behind


def strengths(
    norms: Float[np.ndarray, " k"],
    rows: Int[np.ndarray, " k"],
    cols: Int[np.ndarray, " k"],
    size: int,
) -> scipy.sparse.csr_matrix:
    """How strongly the nodes of a symmetric block matrix are coupled.

    |A_ij| / sqrt(|A_ii| |A_jj|), so that a stiff pair stands out from its stiff neighbourhood.

    Args:
        norms: of the blocks of the upper triangle, (k,); each node has a diagonal block.
        rows, cols: their nodes, rows <= cols.
        size: number of nodes.

    Returns:
        Both triangles without the diagonal, with sorted indices; where a diagonal block is zero
        the strengths are zero.
    """
    diagonal = rows == cols
    scale = np.zeros(size)
    scale[rows[diagonal]] = norms[diagonal]
    scale = np.divide(1.0, np.sqrt(scale), out=np.zeros(size), where=scale > 0.0)
    rows, cols, norms = rows[~diagonal], cols[~diagonal], norms[~diagonal]
    weights = norms * scale[rows] * scale[cols]
    both = np.concatenate([weights, weights])
    at = np.concatenate([rows, cols]), np.concatenate([cols, rows])
    graph = scipy.sparse.csr_matrix((both, at), shape=(size, size))
    graph.sort_indices()
    return graph


def partition(graph: scipy.sparse.csr_matrix, limit: int) -> tuple[Int[np.ndarray, " n"], int]:
    """Parts of at most `limit` nodes.

    A part grows by the node that is tied to it most strongly; the next one starts at the node with
    the strongest ties to all parts so far. One that ends up small joins a neighbour with room, and
    small pieces that are tied to nothing share parts.

    Args:
        graph: symmetric, weights >= 0, from `strengths`.
        limit: largest number of nodes of a part.

    Returns:
        The part of each node, and the number of parts.
    """
    return _grow(graph.indptr, graph.indices, graph.data, limit)


@compiled
def _grow(indptr, indices, weights, limit):
    size = len(indptr) - 1
    part = np.full(size, -1, np.int64)
    filled = np.zeros(size, np.int64)
    old_ties, own_ties = np.zeros(size), np.zeros(size)
    # Nodes that touch the part that grows, and those that touch a finished one.
    rim, shore = np.empty(size, np.int64), np.empty(size, np.int64)
    in_rim, on_shore = np.zeros(size, np.bool_), np.zeros(size, np.bool_)
    shore_count, first_free, count, left = 0, 0, 0, size
    members = np.empty(limit, np.int64)
    ties = np.zeros(size)
    loose = -1  # the last part of pieces that are tied to nothing else
    while left > 0:
        chosen, best, kept = -1, -1.0, 0
        for at in range(shore_count):
            node = shore[at]
            if part[node] < 0:
                shore[kept] = node
                kept += 1
                if old_ties[node] > best:
                    chosen, best = node, old_ties[node]
        shore_count = kept
        if chosen < 0:
            while part[first_free] >= 0:
                first_free += 1
            chosen = first_free

        rim_count = 0
        while chosen >= 0:
            part[chosen] = count
            members[filled[count]] = chosen
            filled[count] += 1
            left -= 1
            for entry in range(indptr[chosen], indptr[chosen + 1]):
                node = indices[entry]
                if part[node] < 0:
                    if not in_rim[node]:
                        in_rim[node] = True
                        rim[rim_count] = node
                        rim_count += 1
                    own_ties[node] += weights[entry]
            chosen, best, kept = -1, -1.0, 0
            for at in range(rim_count):
                node = rim[at]
                if part[node] < 0:
                    rim[kept] = node
                    kept += 1
                    tie = own_ties[node] + _OLD_SHARE * old_ties[node]
                    if tie > best:
                        chosen, best = node, tie
                else:
                    in_rim[node], own_ties[node] = False, 0.0
            rim_count = kept
            if filled[count] == limit:
                chosen = -1
        for at in range(rim_count):
            node = rim[at]
            old_ties[node] += own_ties[node]
            in_rim[node], own_ties[node] = False, 0.0
            if not on_shore[node]:
                on_shore[node] = True
                shore[shore_count] = node
                shore_count += 1

        if 2 * filled[count] <= limit:  # enclosed by others
            host, best, tied = -1, 0.0, False
            for member in members[: filled[count]]:
                for entry in range(indptr[member], indptr[member + 1]):
                    other = part[indices[entry]]
                    tied = tied or other != count
                    if 0 <= other < count and filled[other] + filled[count] <= limit:
                        ties[other] += weights[entry]
                        if ties[other] > best:
                            host, best = other, ties[other]
            for member in members[: filled[count]]:
                for entry in range(indptr[member], indptr[member + 1]):
                    other = part[indices[entry]]
                    if other >= 0:
                        ties[other] = 0.0
            if not tied:
                if loose >= 0 and filled[loose] + filled[count] <= limit:
                    host = loose
                else:
                    loose = count
            if host >= 0:
                for member in members[: filled[count]]:
                    part[member] = host
                filled[host] += filled[count]
                filled[count] = 0
                continue
        count += 1
    return part, count


def overlapping(
    graph: scipy.sparse.csr_matrix,
    part: Int[np.ndarray, " n"],
    count: int,
    *,
    limit: int,
    sharing: int,
) -> Int[np.ndarray, "count limit"]:
    """The parts, filled up with the neighbours that are tied to them most strongly.

    Args:
        graph: as for `partition`.
        part, count: from `partition`.
        limit: largest number of nodes of a part with its neighbours.
        sharing: in how many parts a node may be.

    Returns:
        Nodes of each part, first its own; unused places hold the number of nodes.
    """
    return _fill(graph.indptr, graph.indices, graph.data, part, count, limit, sharing)


@compiled
def _fill(indptr, indices, weights, part, count, limit, sharing):
    size = len(part)
    nodes = np.full((count, limit), size, np.int64)
    own = np.zeros(count, np.int64)
    for node in range(size):
        nodes[part[node], own[part[node]]] = node
        own[part[node]] += 1
    shared = np.ones(size, np.int64)
    ties = np.zeros(size)
    rim = np.empty(size, np.int64)
    for number in range(count):
        rim_count = 0
        for node in nodes[number, : own[number]]:
            for entry in range(indptr[node], indptr[node + 1]):
                other = indices[entry]
                if part[other] != number and weights[entry] > 0.0:
                    if ties[other] == 0.0:
                        rim[rim_count] = other
                        rim_count += 1
                    ties[other] += weights[entry]
        room = limit - own[number]
        filled = own[number]
        for at in np.argsort(-ties[rim[:rim_count]], kind="mergesort"):
            if room == 0:
                break
            other = rim[at]
            if shared[other] < sharing:
                nodes[number, filled] = other
                shared[other] += 1
                filled += 1
                room -= 1
        ties[rim[:rim_count]] = 0.0
    return nodes
