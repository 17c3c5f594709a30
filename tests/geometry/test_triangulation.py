"""Polygon meshes and harmonic coordinates: areas, angles, kept outlines, linear precision."""

import numpy as np
import pytest

from dress_jax.geometry.harmonic import cotangent_laplacian, harmonic_coordinates
from dress_jax.geometry.polygons import self_crossings, signed_area
from dress_jax.geometry.triangulation import (
    TriangulationError,
    triangle_angles,
    triangle_areas,
    triangulate,
)

LINEAR_PRECISION = 1e-12  # [m], one sparse factorisation of a well-shaped mesh
MIN_ANGLE = 25.0  # degrees; convex shapes sampled at the wanted edge length


def polyline(corners, spacing):
    parts = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / spacing)))
        parts.append(a + (b - a) * (np.arange(count) / count)[:, None])
    return np.concatenate(parts)


SQUARE = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.3], [0.0, 0.3]])
NOTCHED = np.array([[0, 0], [0.4, 0], [0.4, 0.3], [0.21, 0.3], [0.2, 0.1], [0.19, 0.3], [0, 0.3]])


@pytest.mark.parametrize("corners", [SQUARE, SQUARE[::-1], NOTCHED, NOTCHED + 100.0])
def test_mesh_fills_the_polygon_and_keeps_its_outline(corners):
    outline = polyline(corners, 0.02)
    points, faces = triangulate(outline, 0.02)
    np.testing.assert_array_equal(points[: len(outline)], outline)
    areas = triangle_areas(points, faces)
    assert (areas > 0.0).all()
    np.testing.assert_allclose(areas.sum(), abs(signed_area(outline)), rtol=1e-9)
    # Euler: a disc of n points, b of them on the outline, has 2 n - b - 2 triangles.
    assert len(faces) == 2 * len(points) - len(outline) - 2


def test_mesh_quality_on_a_square():
    outline = polyline(SQUARE, 0.02)
    points, faces = triangulate(outline, 0.02)
    assert np.degrees(triangle_angles(points, faces)).min() > MIN_ANGLE


def test_a_triangle_without_room_for_inner_points():
    points, faces = triangulate(np.array([[0.0, 0.0], [0.01, 0.0], [0.0, 0.01]]), 0.02)
    assert len(points) == 3 and len(faces) == 1


def test_crossing_outline_is_refused():
    bow_tie = np.array([[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    with pytest.raises(TriangulationError):
        triangulate(bow_tie, 0.2)
    with pytest.raises(TriangulationError, match="uplicate"):
        triangulate(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), 0.2)


@pytest.mark.parametrize("corners", [SQUARE, NOTCHED])
def test_harmonic_coordinates_reproduce_linear_functions(corners):
    outline = polyline(corners, 0.02)
    points, faces = triangulate(outline, 0.02)
    weights = harmonic_coordinates(points, faces, len(outline))
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    inner = points[len(outline) :]
    np.testing.assert_allclose(weights @ outline, inner, atol=LINEAR_PRECISION)
    # The discrete solution solves the discrete equation: the mean-value property on a dense oracle.
    laplacian = cotangent_laplacian(points, faces).toarray()
    b = len(outline)
    dense = -np.linalg.solve(laplacian[b:, b:], laplacian[b:, :b])
    np.testing.assert_allclose(weights, dense, atol=1e-12)


def test_no_inner_points_gives_an_empty_matrix():
    triangle = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    assert harmonic_coordinates(triangle, np.array([[0, 1, 2]]), 3).shape == (0, 3)


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([[0, 0], [1, 0], [1, 1], [0, 1]], []),
        ([[0, 0], [1, 1], [1, 0], [0, 1]], [(0, 2)]),
        ([[0, 0], [2, 0], [2, 2], [1, 0], [0, 2]], [(0, 2), (0, 3)]),  # touches the bottom
        ([[0, 0], [2, 0], [1, 0], [1, 1]], [(0, 1), (0, 2)]),  # folds back
    ],
)
def test_self_crossings_against_drawings(points, expected):
    found = {tuple(pair) for pair in self_crossings(np.array(points, dtype=float)).tolist()}
    assert found == set(expected)
