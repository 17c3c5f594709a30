import numpy as np
import pytest
import trimesh

from dress_jax.core.errors import InputError
from dress_jax.geometry.topology import (
    boundary_loops,
    connected_components,
    hinges,
    inconsistent_edges,
    unique_edges,
    validate_manifold,
)

SPHERE = np.asarray(trimesh.creation.icosphere(subdivisions=2).faces)
STRIP = np.array([[0, 1, 3], [0, 3, 2], [2, 3, 5], [2, 5, 4]])
# An annulus: outer square 0..3, inner square 4..7.
ANNULUS = np.array(
    [[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]]
)


def test_edges_against_trimesh():
    mesh = trimesh.creation.icosphere(subdivisions=2)
    expected = np.unique(np.sort(mesh.edges_unique, axis=1), axis=0)
    np.testing.assert_array_equal(unique_edges(mesh.faces), expected)
    assert unique_edges(np.zeros((0, 3), int)).shape == (0, 2)


def test_hinges_of_a_closed_surface_cover_every_edge_once():
    h = hinges(SPHERE)
    np.testing.assert_array_equal(
        np.unique(np.sort(h.vertices[:, :2], axis=1), axis=0), unique_edges(SPHERE)
    )
    assert len(h.vertices) == len(unique_edges(SPHERE))


@pytest.mark.parametrize("faces", [SPHERE, STRIP, ANNULUS], ids=["sphere", "strip", "annulus"])
def test_hinges_are_consistent(faces):
    h = hinges(faces)
    for side, opposite in ((0, 2), (1, 3)):
        corner, face = h.local_corner[:, side], faces[h.faces[:, side]]
        rows = np.arange(len(face))
        np.testing.assert_array_equal(face[rows, corner], h.vertices[:, opposite])
        shared = np.stack([face[rows, (corner + 1) % 3], face[rows, (corner + 2) % 3]], axis=1)
        np.testing.assert_array_equal(shared, h.vertices[:, [0, 1] if side == 0 else [1, 0]])
    assert (h.faces[:, 0] < h.faces[:, 1]).all()


def test_boundary_loops():
    assert boundary_loops(SPHERE) == []
    (loop,) = boundary_loops(STRIP)
    np.testing.assert_array_equal(loop, [0, 1, 3, 5, 4, 2])
    outer, inner = boundary_loops(ANNULUS)
    np.testing.assert_array_equal(outer, [0, 1, 2, 3])
    np.testing.assert_array_equal(inner, [4, 7, 6, 5])


def test_boundary_loops_that_touch_in_a_vertex_stay_apart():
    first, second = boundary_loops(np.array([[0, 1, 2], [0, 3, 4]]))
    np.testing.assert_array_equal(first, [0, 1, 2])
    np.testing.assert_array_equal(second, [0, 3, 4])


def test_connected_components():
    labels = connected_components(np.array([[0, 1, 2], [3, 4, 5]]), 7)
    np.testing.assert_array_equal(labels, [0, 0, 0, 1, 1, 1, 2])


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ([[0, 1, 2], [0, 1, 3], [1, 0, 4]], "more than two faces"),
        ([[0, 1, 2], [0, 1, 3]], "opposite orientations"),
        ([[0, 1, 1]], "names a vertex twice"),
        ([[0, 1, 9]], "there are 5 vertices"),
        ([[0, 1, -1]], "there are 5 vertices"),
    ],
)
def test_validation_names_the_fault(faces, message):
    with pytest.raises(InputError, match=message):
        validate_manifold(np.array(faces), 5)


def test_validation_accepts_good_meshes_and_orientation_is_optional():
    validate_manifold(SPHERE)
    validate_manifold(ANNULUS, 8)
    flipped = np.array([[0, 1, 2], [0, 1, 3]])
    validate_manifold(flipped, require_orientation=False)
    np.testing.assert_array_equal(inconsistent_edges(flipped), [[0, 1]])
    assert len(inconsistent_edges(SPHERE)) == 0
