import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.contact.candidates import gather, gather_displacements, make_candidates, mask
from dress_jax.geometry.distance import edge_edge_squared, vertex_face_squared

POSITIONS = jnp.asarray(np.random.default_rng(0).normal(size=(7, 3)))
ROWS = np.array([[0, 1, 2, 3], [6, 5, 4, 3]])
EMPTY = np.zeros((0, 4), np.int32)


def test_columns_counts_and_padding():
    c = make_candidates(ROWS, EMPTY)
    assert c.vertex_face.shape[0] == c.edge_edge.shape[0] == 4 and c.vertex_face.shape[1] > 2
    assert c.vertex_face.dtype == jnp.int32
    assert (int(c.vertex_face_count), int(c.edge_edge_count)) == (2, 0)
    np.testing.assert_array_equal(c.vertex_face[:, :2], ROWS.T)
    assert int(mask(c.vertex_face, c.vertex_face_count).sum()) == 2
    assert not mask(c.edge_edge, c.edge_edge_count).any()


def test_gather_gives_the_stencils():
    c = make_candidates(ROWS, ROWS)
    x = gather(POSITIONS, c.vertex_face, c.vertex_face_count)
    assert x.shape == (4, 3, c.vertex_face.shape[1])
    np.testing.assert_array_equal(x[:, :, 1], POSITIONS[ROWS[1]])
    p = gather_displacements(POSITIONS, c.vertex_face, c.vertex_face_count)
    np.testing.assert_array_equal(p[:, :, 0], POSITIONS[ROWS[0]])
    assert not p[:, :, 2:].any()


@pytest.mark.parametrize("squared", [vertex_face_squared, edge_edge_squared])
def test_padding_is_far_apart_and_without_derivative(squared):
    c = make_candidates(EMPTY, EMPTY)

    def smallest(positions):
        return squared(gather(positions, c.vertex_face, c.vertex_face_count)).min()

    assert smallest(POSITIONS) > 1e4
    # Even where all positions coincide or are not finite.
    assert smallest(jnp.full((1, 3), jnp.nan)) > 1e4
    np.testing.assert_array_equal(jax.grad(smallest)(POSITIONS), 0.0)


def test_one_bucket_is_one_program():
    traces = []

    @jax.jit
    def total(positions, candidates):
        traces.append(1)
        x = gather(positions, candidates.vertex_face, candidates.vertex_face_count)
        return vertex_face_squared(x).sum()

    for n in (1, 2):
        total(POSITIONS, make_candidates(ROWS[:n], EMPTY))
    assert len(traces) == 1
    larger = make_candidates(ROWS, EMPTY).vertex_face.shape[1]
    total(POSITIONS, make_candidates(np.tile(ROWS, (larger, 1)), EMPTY))
    assert len(traces) == 2
