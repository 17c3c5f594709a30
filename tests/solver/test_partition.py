import numpy as np
import pytest
import scipy.sparse
from solver_scenes import grid_graph

from dress_jax.solver.linear.partition import overlapping, partition, strengths

SIDE, LIMIT = 20, 16


def _sizes(part, count):
    return np.bincount(part, minlength=count)


def test_strength_has_no_unit():
    """By hand: |A_ij| / sqrt(|A_ii| |A_jj|), the same after a change of scale of a node."""
    norms = np.array([4.0, 3.0, 9.0, 0.0])
    rows, cols = np.array([0, 0, 1, 2]), np.array([0, 1, 1, 2])
    graph = strengths(norms, rows, cols, 3).toarray()
    np.testing.assert_allclose(graph, [[0.0, 0.5, 0.0], [0.5, 0.0, 0.0], [0.0, 0.0, 0.0]])
    scaled = strengths(norms * [100.0, 10.0, 1.0, 1.0], rows, cols, 3).toarray()
    np.testing.assert_allclose(scaled, graph)


@pytest.mark.parametrize("limit", [1, 7, 16, 1000])
def test_parts_are_bounded_connected_and_complete(limit):
    graph = grid_graph(SIDE)
    part, count = partition(graph, limit)
    sizes = _sizes(part, count)
    assert part.shape == (SIDE**2,) and sizes.sum() == SIDE**2
    assert sizes.min() >= 1 and sizes.max() <= limit
    for number in range(count):
        inside = np.nonzero(part == number)[0]
        within = graph[inside][:, inside]
        assert scipy.sparse.csgraph.connected_components(within)[0] == 1


def test_parts_are_compact_and_full():
    """A square of 16 nodes has 16 edges to others; strips of 16 nodes would have 32."""
    graph = grid_graph(SIDE)
    part, count = partition(graph, LIMIT)
    rows, cols = graph.nonzero()
    cut = np.count_nonzero(part[rows] != part[cols]) / count
    assert cut < 24.0
    assert count < 1.3 * SIDE**2 / LIMIT


def test_strong_ties_are_not_cut():
    """Contacts between two sheets, ten times stronger than the sheets themselves."""
    sheet = grid_graph(SIDE)
    rng = np.random.default_rng(0)
    lower = rng.choice(SIDE**2, 40, replace=False)
    tie = scipy.sparse.coo_matrix((np.full(40, 10.0), (lower, lower)), shape=sheet.shape)
    graph = scipy.sparse.bmat([[sheet, tie], [tie.T, sheet]], format="csr")
    part, _ = partition(graph, LIMIT)
    upper = lower + SIDE**2
    assert np.mean(part[lower] == part[upper]) > 0.9


def test_unconnected_nodes_and_empty_graphs():
    """Nodes without ties share parts: there may be thousands of them."""
    part, count = partition(scipy.sparse.csr_matrix((5 * LIMIT, 5 * LIMIT)), LIMIT)
    assert count == 5
    np.testing.assert_array_equal(_sizes(part, count), LIMIT)
    part, count = partition(scipy.sparse.csr_matrix((0, 0)), LIMIT)
    assert count == 0 and part.shape == (0,)


def test_overlap_takes_the_strongest_neighbours():
    graph = grid_graph(SIDE)
    part, count = partition(graph, LIMIT)
    patches = overlapping(graph, part, count, limit=2 * LIMIT, sharing=3)
    inside = patches < SIDE**2
    assert patches.shape == (count, 2 * LIMIT)
    times = np.bincount(patches[inside], minlength=SIDE**2)
    assert times.min() >= 1 and 1 < times.max() <= 3
    for number in range(count):
        nodes = patches[number][inside[number]]
        assert len(np.unique(nodes)) == len(nodes)
        own = np.nonzero(part == number)[0]
        np.testing.assert_array_equal(np.sort(nodes[: len(own)]), own)
        ties = np.asarray(graph[:, own].sum(axis=1)).ravel()
        assert np.all(ties[nodes[len(own) :]] > 0.0)
