import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.solver.block_matrix import (
    add_rows,
    block_pattern,
    block_rows,
    element_pairs,
    element_slots,
    empty_values,
    first_and_second,
    outer_rows,
    upper_triangle,
)

FREE, FIXED = 7, 3  # vertices; fixed ones have the highest indices
PAIRS = tuple((p, q) for p in range(4) for q in range(p, 4))
# Sums of a dozen terms in another order.
ROUNDING = 1e-13


def _elements(count: int = 12, seed: int = 0) -> np.ndarray:
    """Stencils (4, m) of distinct vertices in any order, some of them fixed."""
    rng = np.random.default_rng(seed)
    rows = [rng.choice(FREE + FIXED, 4, replace=False) for _ in range(count)]
    return np.array(rows).T


def _dense(elements: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """The free part of the sum of element matrices (m, 4, 3, 4, 3)."""
    out = np.zeros((FREE + FIXED, 3, FREE + FIXED, 3))
    for stencil, matrix in zip(elements.T, matrices, strict=True):
        for p in range(4):
            for q in range(4):
                out[stencil[p], :, stencil[q]] += matrix[p, :, q]
    return out[:FREE, :, :FREE].reshape(3 * FREE, 3 * FREE)


def _full(pattern, values) -> np.ndarray:
    upper = upper_triangle(pattern, values)
    assert np.all(np.diff(upper.indptr) > 0) and upper.has_sorted_indices
    triangle = upper.toarray()
    np.testing.assert_array_equal(np.tril(triangle, -1), 0.0)
    return triangle + np.triu(triangle, 1).T


def _setup(seed=0):
    elements = _elements(seed=seed)
    pattern = block_pattern(FREE, [element_pairs(elements, PAIRS)], smallest=8)
    return elements, pattern, element_slots(pattern, elements, PAIRS)


def test_general_blocks_against_a_dense_assembly():
    """Blocks that are not symmetric themselves, so that a missed transposition shows."""
    elements, pattern, slots = _setup()
    assert np.any(slots.transposed) and not np.all(slots.transposed)
    rng = np.random.default_rng(1)
    matrices = rng.normal(size=(elements.shape[1], 12, 12))
    matrices = (matrices + matrices.transpose(0, 2, 1)).reshape(-1, 4, 3, 4, 3)
    stacked = np.array([matrices[:, p, :, q] for p, q in PAIRS])  # (pairs, m, 3, 3)
    turned = np.asarray(slots.transposed)[:, :, None, None]
    stacked = np.where(turned, stacked.transpose(0, 1, 3, 2), stacked)
    blocks = [[jnp.asarray(stacked[:, :, i, j]) for j in range(3)] for i in range(3)]
    values = add_rows(empty_values(pattern.capacity), block_rows(blocks), slots.slots)
    expected = _dense(elements, matrices)
    np.testing.assert_allclose(_full(pattern, values), expected, rtol=0, atol=ROUNDING)


def test_rank_one_blocks_against_a_dense_assembly():
    elements, pattern, slots = _setup(seed=2)
    rng = np.random.default_rng(3)
    vectors, stiffness = rng.normal(size=(4, 3, elements.shape[1])), rng.uniform(size=12)
    values = empty_values(pattern.capacity)
    rows = outer_rows(jnp.asarray(vectors), jnp.asarray(stiffness), PAIRS, slots)
    for _ in range(2):  # values add up
        values = add_rows(values, rows, slots.slots)
    matrices = np.einsum("m,pim,qjm->mpiqj", 2.0 * stiffness, vectors, vectors)
    np.testing.assert_allclose(
        _full(pattern, values), _dense(elements, matrices), rtol=0, atol=ROUNDING
    )


def test_first_and_second_are_swapped_where_transposed():
    elements, _, slots = _setup()
    first, second = first_and_second(jnp.asarray(elements), PAIRS, slots)
    assert np.all(first <= second)
    np.testing.assert_array_equal(
        np.sort([first, second], axis=0), np.sort(element_pairs(elements, PAIRS), axis=0)
    )


def test_fixed_vertices_go_to_a_spare_slot():
    elements, pattern, slots = _setup()
    fixed = np.maximum(*element_pairs(elements, PAIRS)) >= FREE
    assert fixed.any()
    spare = np.asarray(slots.slots)[fixed]
    np.testing.assert_array_equal(spare, pattern.capacity - 1)
    assert pattern.capacity > len(pattern.rows)
    assert np.asarray(slots.slots)[~fixed].max() < len(pattern.rows)


def test_pattern_holds_the_diagonal_and_each_pair_once():
    _, pattern, _ = _setup()
    keys = list(zip(pattern.rows, pattern.cols, strict=True))
    assert keys == sorted(set(keys)) and np.all(pattern.rows <= pattern.cols)
    assert {(i, i) for i in range(FREE)} <= set(keys)
    empty = block_pattern(FREE, [])
    np.testing.assert_array_equal(empty.rows, np.arange(FREE))
    np.testing.assert_array_equal(_full(empty, empty_values(empty.capacity)), 0.0)


def test_missing_pairs_are_reported():
    pattern = block_pattern(FREE, [(np.array([0, 5]), np.array([2, 1]))])
    slots, transposed, complete = pattern.find(np.array([2, 1]), np.array([0, 5]))
    assert complete and transposed.tolist() == [True, False]
    assert pattern.cols[slots].tolist() == [2, 5]
    _, _, complete = pattern.find(np.array([0, 6]), np.array([2, 5]))
    assert not complete
    # The last vertex has the largest key: nothing lies beyond it.
    assert pattern.find(np.array([6]), np.array([6]))[2]
    with pytest.raises(ValueError, match="lacks a block"):
        element_slots(pattern, np.array([[3], [4]]), ((0, 1),))
