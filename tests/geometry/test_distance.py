from fractions import Fraction

import ipctk
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from dress_jax.geometry import host_distance
from dress_jax.geometry.distance import (
    edge_edge_closest,
    edge_edge_squared,
    edge_edge_squared_distance,
    point_triangle_squared_distance,
    vertex_face_closest,
    vertex_face_squared,
)

# Random stencils are conditioned to a few hundred at worst.
RELATIVE = 1e-12
# Second derivatives divide by squared sines once more.
RELATIVE_HESSIAN = 1e-9

KINDS = {
    "vertex_face": (
        vertex_face_squared,
        vertex_face_closest,
        point_triangle_squared_distance,
        ipctk.point_triangle_distance,
        ipctk.point_triangle_distance_gradient,
        ipctk.point_triangle_distance_hessian,
        host_distance.point_triangle,
    ),
    "edge_edge": (
        edge_edge_squared,
        edge_edge_closest,
        edge_edge_squared_distance,
        ipctk.edge_edge_distance,
        ipctk.edge_edge_distance_gradient,
        ipctk.edge_edge_distance_hessian,
        host_distance.edge_edge,
    ),
}
KIND = pytest.mark.parametrize("kind", KINDS)


def _random(n=600, seed=0):
    x = np.random.default_rng(seed).normal(size=(n, 4, 3))
    x[::3] *= 0.01  # garment scale
    return x


@KIND
def test_values_against_ipctk(kind):
    kernel, closest, stencil, oracle, _, _, host = KINDS[kind]
    x = _random()
    expected = np.array([oracle(*points) for points in x])
    components = jnp.asarray(x.transpose(1, 2, 0))
    np.testing.assert_allclose(kernel(components), expected, rtol=RELATIVE)
    np.testing.assert_allclose(jax.vmap(stencil)(*x.transpose(1, 0, 2)), expected, rtol=RELATIVE)
    np.testing.assert_allclose([host(*points) for points in x], expected, rtol=RELATIVE)
    nested = tuple(tuple(point) for point in components)
    np.testing.assert_array_equal(kernel(nested), kernel(components))

    weights, squared = closest(components)
    np.testing.assert_allclose(squared, expected, rtol=RELATIVE)
    difference = np.einsum("kn,kcn->nc", weights, components)
    np.testing.assert_allclose((difference**2).sum(1), expected, rtol=1e-10)
    np.testing.assert_allclose(np.asarray(weights).sum(0), 0.0, atol=1e-15)


@KIND
def test_derivatives_against_ipctk(kind):
    kernel, _, _, _, gradient, hessian, _ = KINDS[kind]
    x = _random(200)
    g = np.asarray(jax.vmap(jax.grad(kernel))(jnp.asarray(x))).reshape(-1, 12)
    h = np.asarray(jax.vmap(jax.hessian(kernel))(jnp.asarray(x))).reshape(-1, 12, 12)
    for points, mine, second in zip(x, g, h, strict=True):
        expected = gradient(*points)
        np.testing.assert_allclose(mine, expected, atol=RELATIVE * np.abs(expected).max() * 10)
        expected = hessian(*points)
        np.testing.assert_allclose(second, expected, atol=RELATIVE_HESSIAN * np.abs(expected).max())
        assert np.abs(second).max() > 0.1


@KIND
def test_derivatives_against_differences(kind):
    kernel = KINDS[kind][0]
    for x in _random(12, seed=5)[1::3]:
        check_grads(kernel, (jnp.asarray(x),), order=2, modes=("fwd", "rev"), atol=1e-5, rtol=1e-5)


DEGENERATE = {
    "all coincident": np.zeros((4, 3)),
    "coincident on a corner": [[0, 0, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0]],
    "on the face": [[0.25, 0.25, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0]],
    "above an edge": [[0.5, -0.5, 1], [0, 0, 0], [1, 0, 0], [0, 1, 0]],
    "parallel": [[0, 0, 0], [1, 0, 0], [0.25, 1, 0], [1.25, 1, 0]],
    "antiparallel": [[0, 0, 0], [1, 0, 0], [1.25, 1, 0], [0.25, 1, 0]],
    "collinear apart": [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]],
    "collinear overlapping": [[0, 0, 0], [1, 0, 0], [0.5, 0, 0], [3, 0, 0]],
    "crossing": [[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0]],
    "first edge a point": [[0, 0, 0], [0, 0, 0], [1, 0, 1], [-1, 0, 1]],
    "second edge a point": [[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, 1, 0]],
    "both points": [[0, 0, 0], [0, 0, 0], [1, 1, 0], [1, 1, 0]],
    "face a segment": [[0.5, 1, 0], [0, 0, 0], [1, 0, 0], [2, 0, 0]],
    "face a segment, corner inside": [[0.5, 1, 0], [0, 0, 0], [2, 0, 0], [1, 0, 0]],
    "face a point": [[1, 1, 1], [0, 0, 0], [0, 0, 0], [0, 0, 0]],
}


@KIND
@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_cases_are_right_and_finite(kind, name):
    kernel, host = KINDS[kind][0], KINDS[kind][-1]
    x = np.array(DEGENERATE[name], float)
    # Dense sampling of both primitives is the oracle: ipctk divides by zero for some of these.
    s = np.linspace(0, 1, 41)
    if kind == "vertex_face":
        v, w = np.meshgrid(s, s, indexing="ij")
        v, w = v[v + w <= 1 + 1e-12], w[v + w <= 1 + 1e-12]
        first = x[:1]
        second = x[1] + v[:, None] * (x[2] - x[1]) + w[:, None] * (x[3] - x[1])
    else:
        first = x[0] + s[:, None] * (x[1] - x[0])
        second = x[2] + s[:, None] * (x[3] - x[2])
    expected = ((first[:, None] - second[None]) ** 2).sum(-1).min()
    # All closest points of these cases lie on the sampling grid up to this.
    assert float(kernel(jnp.asarray(x))) == pytest.approx(expected, abs=1e-3)
    assert host(*x) == pytest.approx(float(kernel(jnp.asarray(x))), abs=1e-14)
    assert np.isfinite(jax.grad(kernel)(jnp.asarray(x))).all()
    assert np.isfinite(jax.hessian(kernel)(jnp.asarray(x))).all()
    turned = jnp.asarray(x[[0, 2, 3, 1]] if kind == "vertex_face" else x[[2, 3, 0, 1]])
    np.testing.assert_allclose(kernel(turned), kernel(jnp.asarray(x)), atol=1e-15)


def _exact_plane_squared(o, u, v, q):
    """((u x v) . (q - o))^2 / |u x v|^2 in rational arithmetic."""
    o, u, v, q = ([Fraction(float(c)) for c in point] for point in (o, u, v, q))
    u, v, w = ([a - b for a, b in zip(p, o, strict=True)] for p in (u, v, q))
    n = [u[k - 2] * v[k - 1] - u[k - 1] * v[k - 2] for k in range(3)]
    height = sum(a * b for a, b in zip(n, w, strict=True))
    return float(height * height / sum(a * a for a in n))


@pytest.mark.parametrize("gap", [1e-3, 1e-6, 1e-8])
def test_vertex_face_is_accurate_for_tiny_gaps(gap):
    rng = np.random.default_rng(1)
    for _ in range(40):
        a, b, c = 0.01 * rng.normal(size=(3, 3)) + 0.5
        n = np.cross(b - a, c - a)
        p = rng.dirichlet([2, 2, 2]) @ np.stack([a, b, c]) + gap * n / np.linalg.norm(n)
        expected = _exact_plane_squared(a, b, c, p)
        value = vertex_face_squared(jnp.asarray(np.stack([p, a, b, c])))
        # Rounding of 1e-2 lengths: 1e-18 absolute in the distance.
        assert abs(np.sqrt(value) - np.sqrt(expected)) < 1e-16
        assert float(value) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("angle", [1.0, 1e-3, 1e-6, 1e-8, 1e-10])
def test_edge_edge_is_accurate_for_nearly_parallel_edges(angle):
    gap = 1e-8
    rng = np.random.default_rng(2)
    for _ in range(20):
        s, t = rng.uniform(0.2, 0.8, 2)
        u, v = 0.01 * np.array([1.0, 0, 0]), 0.01 * np.array([np.cos(angle), np.sin(angle), 0])
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        x = (
            np.stack([-s * u, (1 - s) * u, -t * v + [0, 0, gap], (1 - t) * v + [0, 0, gap]])
            @ turn.T
        )
        # Of nearly parallel lines the exact crossing moves with rounding of the input, so the
        # reference is the exact minimum over the segments: crossing or endpoints.
        o, w = x[0], x[2]
        expected = _exact_plane_squared(o, x[1], o + (x[3] - w), w)
        value = float(edge_edge_squared(jnp.asarray(x)))
        assert value == pytest.approx(gap**2, rel=1e-5)
        if angle > 1e-7:
            assert value == pytest.approx(expected, rel=1e-5)
        g = np.asarray(jax.grad(edge_edge_squared)(jnp.asarray(x)))
        np.testing.assert_allclose(np.linalg.norm(g[0] + g[1]), 2 * gap, rtol=1e-5)


@KIND
def test_rigid_motion_leaves_the_distance(kind):
    kernel = KINDS[kind][0]
    x = _random(50, seed=7)
    turn = np.linalg.qr(np.random.default_rng(8).normal(size=(3, 3)))[0]
    moved = x @ turn.T + [1.0, -2.0, 0.5]
    np.testing.assert_allclose(
        kernel(jnp.asarray(moved.transpose(1, 2, 0))),
        kernel(jnp.asarray(x.transpose(1, 2, 0))),
        rtol=1e-9,
    )
