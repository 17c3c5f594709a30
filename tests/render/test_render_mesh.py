"""Adjacency and vertex normals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from dress_jax.core.errors import InputError
from dress_jax.render.mesh import build_adjacency, join_meshes, make_render_mesh, vertex_normals

STRIP = np.array([[0, 1, 2], [2, 1, 3]])


def _edges(faces):
    flat = np.asarray(faces).reshape(-1)
    return np.stack([flat, np.roll(np.asarray(faces), -1, axis=1).reshape(-1)], axis=1)


def test_twins_of_a_closed_surface():
    faces = np.asarray(trimesh.creation.icosphere(2).faces)
    twin = build_adjacency(faces).reshape(-1)
    assert (twin >= 0).all()
    np.testing.assert_array_equal(twin[twin], np.arange(len(twin)))
    edges = _edges(faces)
    np.testing.assert_array_equal(edges[twin], edges[:, ::-1])


def test_boundaries_and_orientation():
    np.testing.assert_array_equal(build_adjacency(STRIP), [[-1, 3, -1], [1, -1, -1]])
    # The second face turned round: still neighbours.
    turned = np.array([[0, 1, 2], [1, 2, 3]])
    np.testing.assert_array_equal(build_adjacency(turned), [[-1, 3, -1], [1, -1, -1]])
    assert build_adjacency(np.zeros((0, 3), dtype=int)).shape == (0, 3)


def test_three_faces_at_an_edge_are_boundaries():
    fan = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    assert (build_adjacency(fan) == -1).all()


def test_weld_map_closes_a_seam():
    cut = np.array([[0, 1, 2], [4, 3, 5]])
    assert (build_adjacency(cut) == -1).all()
    welded = build_adjacency(cut, np.array([0, 1, 2, 1, 2, 3]))
    np.testing.assert_array_equal(welded, [[-1, 3, -1], [1, -1, -1]])


def test_errors():
    with pytest.raises(InputError, match="shape"):
        build_adjacency(np.zeros((2, 4), dtype=int))
    with pytest.raises(InputError, match="negative"):
        build_adjacency(np.array([[0, 1, -1]]))
    with pytest.raises(InputError, match="weld map"):
        build_adjacency(STRIP, np.array([0, 1, 2]))
    with pytest.raises(InputError, match="names vertex 3"):
        make_render_mesh(np.zeros((3, 3)), STRIP)
    with pytest.raises(InputError, match="colors"):
        make_render_mesh(np.zeros((4, 3)), STRIP, colors=np.zeros((3, 3)))


def test_joined_meshes_keep_their_twins():
    mesh = make_render_mesh(np.zeros((4, 3)), STRIP)
    positions, faces, adjacency = join_meshes(mesh, mesh)
    assert positions.shape == (8, 3)
    np.testing.assert_array_equal(faces[2:], STRIP + 4)
    np.testing.assert_array_equal(adjacency, build_adjacency(np.asarray(faces)))


def test_sphere_normals():
    ball = trimesh.creation.icosphere(4, 0.7)
    normals = vertex_normals(jnp.asarray(ball.vertices), jnp.asarray(ball.faces))
    np.testing.assert_allclose(normals, ball.vertices / 0.7, atol=1e-2)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)


def test_faces_without_area_have_zero_normals_and_derivatives():
    positions = jnp.zeros((4, 3))
    normals, pull = jax.vjp(lambda p: vertex_normals(p, jnp.asarray(STRIP)), positions)
    assert not normals.any()
    assert not np.asarray(pull(jnp.ones_like(positions))[0]).any()
