"""Values from one mesh of a pattern to another."""

import numpy as np
import pytest

from dress_jax.pattern import discretize
from dress_jax.pattern.templates import t_shirt
from dress_jax.pattern.transfer import vertex_transfer

PATTERN = t_shirt()


def at_vertices(mesh, values):
    """Of panel vertices, their mean at every welded vertex."""
    weld = np.asarray(mesh.weld_map)
    total = np.zeros(mesh.vertex_count)
    np.add.at(total, weld, values)
    return total / np.bincount(weld)


@pytest.mark.parametrize("lengths", [(0.06, 0.03), (0.03, 0.06)])
def test_linear_functions_are_kept(lengths):
    old, new = (discretize(PATTERN, length) for length in lengths)
    before, after = (np.asarray(mesh.meshed_positions) for mesh in (old, new))
    weights = vertex_transfer(old, before, new, after)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-12)
    assert weights.min() >= 0.0
    # In a panel of its own a linear function is continuous; inner vertices of that panel only.
    panel = 0
    inner = np.setdiff1d(
        np.flatnonzero(np.asarray(new.panel_of_vertex) == panel),
        np.concatenate([np.asarray(new.edge_samples), np.asarray(new.seam_vertices).ravel()]),
    )
    vertices = np.asarray(new.weld_map)[inner]
    own = np.asarray(old.panel_of_vertex) == panel
    values = at_vertices(old, np.where(own, before[:, 0] - 2.0 * before[:, 1], 0.0))
    # Beside a seam the old mesh's vertices hold the mean of two panels.
    sewn = np.zeros(old.vertex_count)
    sewn[np.asarray(old.weld_map)[np.asarray(old.seam_vertices).ravel()]] = 1.0
    free = weights.dot(sewn)[vertices] == 0.0
    assert free.sum() > 3
    expected = after[inner, 0] - 2.0 * after[inner, 1]
    np.testing.assert_allclose(weights.dot(values)[vertices][free], expected[free], atol=1e-12)


def test_the_same_mesh_keeps_every_value():
    mesh = discretize(PATTERN, 0.06)
    rest = np.asarray(mesh.meshed_positions)
    weights = vertex_transfer(mesh, rest, mesh, rest)
    values = np.random.default_rng(1).normal(size=(mesh.vertex_count, 3))
    np.testing.assert_allclose(weights.dot(values), values, atol=1e-9)
