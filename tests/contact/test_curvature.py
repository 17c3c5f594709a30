"""Exact Hessians of contact pairs in closed form against automatic differentiation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.contact.barrier import contact_settings
from dress_jax.contact.curvature import curved_blocks
from dress_jax.contact.potential import Contact, PairKind, Pairs, closest, contact_energy, mollifier

SETTINGS = contact_settings(dhat=0.5, thickness=0.01)
TRIANGLE = [[0.0, 0.0, 0.0], [1.0, 0.1, 0.0], [0.2, 0.9, 0.1]]
# A vertex above the inside, beyond each edge and beyond each corner of the triangle.
VERTICES = {
    "inside": [0.4, 0.3, 0.2],
    "edge ab": [0.5, -0.1, 0.2],
    "edge ac": [-0.1, 0.5, 0.2],
    "edge bc": [0.75, 0.65, 0.2],
    "corner a": [-0.1, -0.1, 0.2],
    "corner b": [1.1, 0.05, 0.2],
    "corner c": [0.2, 1.05, 0.2],
}
EDGE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.1]]
EDGES = {
    "crossing": [[0.4, -0.5, 0.2], [0.6, 0.5, 0.25]],
    "end of the first": [[-0.1, -0.5, 0.2], [-0.2, 0.5, 0.25]],
    "end of the second": [[0.4, 0.1, 0.2], [0.5, 0.8, 0.3]],
    "two ends": [[-0.1, 0.1, 0.2], [-0.4, 0.8, 0.3]],
}
CASES = [(PairKind.VERTEX_FACE, name) for name in VERTICES]
CASES += [(PairKind.EDGE_EDGE, name) for name in EDGES]
FREE = {"inside": 3, "edge ab": 2, "edge ac": 2, "edge bc": 2, "crossing": 4}


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_closed_form_is_the_second_derivative(kind, name):
    if kind is PairKind.VERTEX_FACE:
        positions = jnp.asarray([VERTICES[name], *TRIANGLE])
    else:
        positions = jnp.asarray([*EDGE, *EDGES[name]])
    pairs = Pairs(jnp.arange(4)[:, None], jnp.asarray(1), jnp.asarray([0.8]), kind)
    contact = Contact(pairs, jnp.asarray([0.3, 0.5, 0.7, 0.4]), jnp.asarray(7.0), SETTINGS)
    points = positions[:, :, None]
    assert float(mollifier(points)[0]) == 1.0 or kind is PairKind.VERTEX_FACE
    if name in FREE:  # the case is the one that its name says
        weights = np.asarray(closest(points, kind)[0])
        assert np.sum(np.abs(weights) > 1e-9) == FREE[name] + (kind is PairKind.VERTEX_FACE)

    expected = jax.hessian(lambda x: contact_energy(x, contact))(positions)
    blocks = curved_blocks(positions, contact)
    w, v = np.asarray(blocks.weights)[:, 0], np.asarray(blocks.vectors)[..., 0]
    found = float(blocks.isotropic[0]) * np.einsum("p,q,ij->piqj", w, w, np.eye(3))
    found += np.einsum("k,kpi,kqj->piqj", np.asarray(blocks.stiffness)[:, 0], v, v)
    assert np.abs(expected).max() > 1.0
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_padded_lanes_are_zero():
    positions = jnp.asarray([VERTICES["inside"], *TRIANGLE])
    indices = jnp.stack([jnp.arange(4), jnp.zeros(4, int)], axis=1)
    pairs = Pairs(indices, jnp.asarray(1), jnp.ones(2), PairKind.VERTEX_FACE)
    blocks = curved_blocks(positions, Contact(pairs, jnp.ones(4), jnp.asarray(7.0), SETTINGS))
    assert float(blocks.isotropic[1]) == 0.0 and not np.any(np.asarray(blocks.stiffness)[:, 1])
    assert np.all(np.isfinite(np.asarray(blocks.vectors)))
