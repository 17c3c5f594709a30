"""The nearest point of a mesh: against every triangle."""

import numpy as np
import trimesh

from dress_jax.geometry.nearest import barycentric, nearest_on_surface


def test_against_every_triangle():
    rng = np.random.default_rng(7)
    triangles = rng.normal(size=(60, 3, 3)) * rng.uniform(0.05, 1.0, size=(60, 1, 1))
    points = 1.5 * rng.normal(size=(40, 3))
    found = nearest_on_surface(points, triangles)
    every = np.stack(
        [trimesh.triangles.closest_point(triangles, np.broadcast_to(p, (60, 3))) for p in points]
    )
    distance = np.linalg.norm(every - points[:, None], axis=2)
    np.testing.assert_array_equal(found.triangle, distance.argmin(axis=1))
    np.testing.assert_allclose(found.distance, distance.min(axis=1), rtol=1e-12)
    rows = np.arange(40)
    np.testing.assert_allclose(found.point, every[rows, found.triangle], atol=1e-12)
    weights = barycentric(found.point, triangles[found.triangle])
    rebuilt = np.sum(weights[:, :, None] * triangles[found.triangle], axis=1)
    np.testing.assert_allclose(rebuilt, found.point, atol=1e-9)


def test_one_triangle_and_no_points():
    triangle = np.eye(3)[None]
    found = nearest_on_surface(np.array([[1.0, 1.0, 1.0]]), triangle)
    np.testing.assert_allclose(found.point, np.full((1, 3), 1.0 / 3.0))
    assert len(nearest_on_surface(np.zeros((0, 3)), triangle).distance) == 0
