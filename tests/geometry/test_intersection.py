import itertools

import ipctk
import numpy as np
import pytest

from dress_jax.core.errors import InputError
from dress_jax.geometry.intersection import (
    _meets_exactly,
    count_intersections,
    edge_face_intersections,
    minimum_distance,
)
from dress_jax.geometry.topology import unique_edges


def _brute_force(positions, edges, faces):
    return [
        (i, j)
        for (i, e), (j, f) in itertools.product(enumerate(edges), enumerate(faces))
        if not set(e) & set(f) and _meets_exactly(positions[e], positions[f])
    ]


def _soup(n, rng, size):
    centres = rng.uniform(size=(n, 1, 3))
    return (centres + size * rng.normal(size=(n, 3, 3))).reshape(-1, 3), np.arange(3 * n).reshape(
        -1, 3
    )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("lattice", [False, True], ids=["general", "degenerate"])
def test_soups_against_rational_brute_force(seed, lattice):
    rng = np.random.default_rng(seed)
    positions, faces = _soup(25, rng, 0.15)
    if lattice:  # a coarse lattice makes touching, coplanar and zero-area cases common
        positions = np.round(4 * positions) / 4
    edges = unique_edges(faces)
    expected = _brute_force(positions, edges, faces)
    assert len(expected) > 0
    found = edge_face_intersections(positions, edges, faces)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("seed", range(12))
def test_soups_against_ipctk(seed):
    rng = np.random.default_rng(seed)
    positions, faces = _soup(20, rng, 0.04)
    edges = unique_edges(faces)
    mesh = ipctk.CollisionMesh(positions, edges, faces)
    found = edge_face_intersections(positions, edges, faces)
    assert (len(found) > 0) == ipctk.has_intersections(mesh, positions)


TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)


@pytest.mark.parametrize(
    ("edge", "expected"),
    [
        ([[0.2, 0.2, -1], [0.2, 0.2, 1]], True),
        ([[0.2, 0.2, 0], [0.2, 0.2, 1]], True),  # an end touches the interior
        ([[0.2, 0.2, 1e-300], [0.2, 0.2, 1]], False),  # above by less than any tolerance
        ([[0.5, 0.5, -1], [0.5, 0.5, 1]], True),  # through a side
        ([[0.5, 0.5 + 2**-52, -1], [0.5, 0.5 + 2**-52, 1]], False),
        ([[0, 0, -1], [0, 0, 1]], True),  # through a corner
        ([[0.1, 0.1, 0], [0.2, 0.2, 0]], True),  # in the plane, inside
        ([[-1, 0.5, 0], [2, 0.5, 0]], True),  # in the plane, across
        ([[-1, 0, 0], [2, 0, 0]], True),  # along a side
        ([[1.5, 0, 0], [2, 0, 0]], False),  # on the line of a side, apart
        ([[1, 1, 0], [2, 2, 0]], False),  # in the plane, apart
        ([[0.2, 0.2, 0], [0.2, 0.2, 0]], True),  # a point on the face
        ([[0.2, 0.2, 0.1], [0.2, 0.2, 0.1]], False),
        ([[0.2, 0.2, 1], [0.2, 0.2, 2]], False),
    ],
)
@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 0, 2)])
def test_single_cases(edge, expected, order):
    positions = np.concatenate([TRIANGLE[list(order)], np.array(edge, float)])
    for e in ([3, 4], [4, 3]):
        found = edge_face_intersections(positions, np.array([e]), np.array([[0, 1, 2]]))
        assert bool(len(found)) is expected


@pytest.mark.parametrize(
    ("face", "expected"),
    [
        ([[-1, 0, 0], [1, 0, 0], [0, 0, 0]], True),
        ([[0, 0, 0], [0, 0, 0], [0, 0, 0]], True),
        ([[-1, 0, 0.5], [1, 0, 0.5], [0, 0, 0.5]], True),
        ([[1, 0, 0], [2, 0, 0], [3, 0, 0]], False),
        ([[1, 0, 0], [1, 0, 0], [1, 0, 0]], False),
    ],
)
def test_zero_area_faces(face, expected):
    positions = np.concatenate([np.array(face, float), [[0, 0, -1], [0, 0, 1]]])
    found = edge_face_intersections(positions, np.array([[3, 4]]), np.array([[0, 1, 2]]))
    assert bool(len(found)) is expected


@pytest.mark.parametrize(
    ("edge", "face"),
    [
        ([[0, 0, 0], [0, 0, 0]], [[1, 0, 0], [1, 0, 0], [1, 0, 0]]),
        ([[0, 0, 0], [1, 1, 1]], [[0.5, 0.5, 0], [0.5, 0.5, 0], [0.5, 0.5, 0]]),
        ([[0, 0, 0], [0, 0, 0]], [[-1, 1, 0], [1, -1, 1], [1, -1, 1]]),
    ],
)
def test_degenerate_pairs_apart_in_rational_arithmetic(edge, face):
    assert not _meets_exactly(np.array(edge, float), np.array(face, float))


def test_shared_vertices_and_welds_are_left_out():
    positions = np.concatenate([TRIANGLE, [[0.2, 0.2, -1], [0.2, 0.2, 1]]])
    edges, faces = np.array([[3, 4]]), np.array([[0, 1, 2]])
    assert len(edge_face_intersections(positions, edges, faces)) == 1
    weld = np.array([0, 1, 2, 1, 4])
    assert len(edge_face_intersections(positions, edges, faces, weld_ids=weld)) == 0
    assert len(edge_face_intersections(positions, np.array([[0, 4]]), faces)) == 0


def test_counts_of_cloth_and_body():
    cloth = np.concatenate([TRIANGLE, TRIANGLE + np.array([0, 0, 1.0])])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    body = np.array([[0.2, 0.2, -1], [0.2, 0.2, 0.5], [2.0, 2.0, -1]])
    count = count_intersections(cloth, faces, body, np.array([[0, 1, 2]]))
    assert (count.self, count.body) == (0, 2)
    assert count_intersections(cloth, faces).body == 0
    crossing = np.concatenate([TRIANGLE, TRIANGLE[:, [2, 0, 1]] * 0.5 + [0.2, 0.2, -0.1]])
    assert count_intersections(crossing, faces).self > 0


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("reach", [1e-6, 0.01, 10.0])
def test_minimum_distance_against_brute_force(seed, reach):
    rng = np.random.default_rng(seed)
    positions, faces = _soup(20, rng, 0.05)
    edges = unique_edges(faces)
    squared = [
        ipctk.point_triangle_distance(positions[v], *positions[f])
        for v in range(len(positions))
        for f in faces
        if v not in f
    ]
    squared += [
        ipctk.edge_edge_distance(*positions[a], *positions[b])
        for a, b in itertools.combinations(edges, 2)
        if not set(a) & set(b)
    ]
    expected = np.sqrt(min(squared))
    assert minimum_distance(positions, faces, reach=reach) == pytest.approx(expected, rel=1e-10)
    # The same triangles as cloth and body: each triangle of the body against all of the cloth.
    far = minimum_distance(positions, faces, positions + np.array([5.0, 0, 0]), faces, reach=reach)
    assert far == pytest.approx(expected, rel=1e-10)


def test_minimum_distance_without_pairs():
    assert minimum_distance(TRIANGLE, np.array([[0, 1, 2]])) == np.inf


def test_positions_that_are_not_finite_are_refused():
    positions = np.full((5, 3), np.nan)
    with pytest.raises(InputError, match="not finite"):
        edge_face_intersections(positions, np.array([[3, 4]]), np.array([[0, 1, 2]]))
