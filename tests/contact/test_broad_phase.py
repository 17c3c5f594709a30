import numpy as np
import pytest
from close_pairs import required_pairs, soup
from scenes import grid, two_layers

from dress_jax.contact import broad_phase
from dress_jax.contact.broad_phase import find_candidates, make_broad_phase, make_collision_mesh
from dress_jax.core.errors import InputError


def _as_set(rows):
    found = set(map(tuple, rows.tolist()))
    assert len(found) == len(rows), "a pair is reported twice"
    return found


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("motion", [0.0, 0.05, 0.3])
def test_no_pair_of_a_soup_is_missed(seed, motion):
    rng = np.random.default_rng(seed)
    cloth, cloth_faces = soup(9, rng, 0.15)
    body, body_faces = soup(6, rng, 0.15)
    start = np.concatenate([cloth, body])
    end = start + motion * rng.normal(size=start.shape)
    weld = np.arange(len(start))
    weld[5] = 0
    mesh = make_collision_mesh(cloth_faces, len(cloth), body_faces, len(body), weld_ids=weld)
    radius = 0.05
    vertex_face, edge_edge = map(_as_set, find_candidates(mesh, start, end, radius))
    needed_vf, needed_ee = required_pairs(mesh, start, end, radius)
    assert needed_vf and needed_ee
    assert needed_vf <= vertex_face
    assert needed_ee <= edge_edge
    for rows in vertex_face:
        assert weld[rows[0]] not in weld[list(rows[1:])]
        assert min(rows) < len(cloth)  # never body with body
    for rows in edge_edge:
        assert not set(weld[list(rows[:2])]) & set(weld[list(rows[2:])])
        assert rows[0] < len(cloth)


def test_two_layers_at_rest_give_exactly_the_close_pairs():
    positions, faces = two_layers(5, gap=0.004)
    mesh = make_collision_mesh(faces, len(positions))
    found = tuple(map(_as_set, find_candidates(mesh, positions, positions, 0.006)))
    assert found == required_pairs(mesh, positions, positions, 0.006)


def test_degenerate_primitives_are_kept():
    # A zero-area face and a zero-length edge, both touched.
    positions = np.array(
        [[0, 0, 0], [1, 0, 0], [2, 0, 0], [0.5, 1e-4, 0], [0.5, 1, 0], [0.5, 1, 0]], float
    )
    mesh = make_collision_mesh(np.array([[0, 1, 2], [3, 4, 5]]), 6)
    vertex_face, edge_edge = find_candidates(mesh, positions, positions, 1e-3)
    assert (3, 0, 1, 2) in _as_set(vertex_face)
    assert required_pairs(mesh, positions, positions, 1e-3)[1] <= _as_set(edge_edge)


def test_touching_pairs_are_found_with_radius_zero():
    positions = np.array(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.25, 0.25, 0], [0, 0, 1], [1, 0, 1]], float
    )
    mesh = make_collision_mesh(np.array([[0, 1, 2], [3, 4, 5]]), 6)
    assert (3, 0, 1, 2) in _as_set(find_candidates(mesh, positions, positions, 0.0)[0])


def test_pairs_are_sorted_and_do_not_depend_on_the_trees():
    positions, faces = two_layers(8, gap=0.004)
    mesh = make_collision_mesh(faces, len(positions))
    shuffled = np.random.default_rng(0).permutation(positions)
    one = find_candidates(make_broad_phase(mesh, positions), positions, positions, 0.01)
    two = find_candidates(make_broad_phase(mesh, shuffled), positions, positions, 0.01)
    for a, b in zip(one, two, strict=True):
        assert a.dtype == np.int32
        np.testing.assert_array_equal(a, b)
    rows = one[0].astype(np.int64)
    assert (np.diff(rows[:, 0]) >= 0).all()


def test_the_buffer_grows_until_all_pairs_fit():
    positions, faces = two_layers(8, gap=0.004)
    mesh = make_collision_mesh(faces, len(positions))
    expected = find_candidates(mesh, positions, positions, 0.02)
    state = make_broad_phase(mesh, positions)
    state.capacity = 3
    for a, b in zip(find_candidates(state, positions, positions, 0.02), expected, strict=True):
        np.testing.assert_array_equal(a, b)
    assert state.capacity > 3


def test_body_boxes_are_kept_only_when_asked():
    cloth, faces = grid(3)
    body, body_faces = grid(3)
    mesh = make_collision_mesh(faces, 9, body_faces, 9)
    near = np.concatenate([cloth, body + np.array([0, 0.01, 0])])
    far = np.concatenate([cloth, body + np.array([0, 5.0, 0])])
    state = broad_phase.make_broad_phase(mesh, near)
    assert len(find_candidates(state, near, near, 0.011, body_moved=False)[0])
    assert not len(find_candidates(state, far, far, 0.011)[0])
    assert not len(find_candidates(state, far, far, 0.011, body_moved=False)[0])
    assert len(find_candidates(state, near, near, 0.011, body_moved=True)[0])


def test_empty_meshes():
    mesh = make_collision_mesh(np.zeros((0, 3), int), 0)
    vertex_face, edge_edge = find_candidates(mesh, np.zeros((0, 3)), np.zeros((0, 3)), 1.0)
    assert vertex_face.shape == (0, 4) and edge_edge.shape == (0, 4)


def test_bad_input_is_refused():
    positions, faces = grid(3)
    mesh = make_collision_mesh(faces, 9)
    with pytest.raises(InputError, match="expected"):
        find_candidates(mesh, positions[:-1], positions, 0.1)
    with pytest.raises(InputError, match="not finite"):
        find_candidates(mesh, positions, positions * np.nan, 0.1)
    with pytest.raises(InputError, match="radius"):
        find_candidates(mesh, positions, positions, float("nan"))
    with pytest.raises(InputError, match="there are 8 vertices"):
        make_collision_mesh(faces, 8)
    with pytest.raises(InputError, match="weld_ids"):
        make_collision_mesh(faces, 9, weld_ids=np.arange(3))
