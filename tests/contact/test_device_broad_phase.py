"""The broad phase in compiled code against the trees on the host, and against brute force."""

import jax
import numpy as np
import pytest
from close_pairs import required_pairs, soup
from scenes import grid, two_layers

from dress_jax.contact.broad_phase import find_candidates, make_collision_mesh
from dress_jax.contact.device_search import UNUSED, columns, search
from dress_jax.contact.device_trees import fit, plant
from dress_jax.contact.pair_finders import DeviceFinder, TreeFinder, make_pair_finder
from dress_jax.contact.potential import PairKind
from dress_jax.core.errors import InputError

# Small, so that stack and queue are used many times over.
CHUNK = 64
CLOTH, BODY = 40, 20  # loose triangles: one size of arrays, so that few programs are compiled


def finder(mesh, positions, **options):
    return DeviceFinder(mesh, positions, chunk=CHUNK, **options)


def loose(seed, *, size=0.1, spread=0.0, weld=True):
    """Loose triangles of cloth and body whose sizes span a factor of exp(2 spread)."""
    rng = np.random.default_rng(seed)
    parts = []
    for count in (CLOTH, BODY):
        points, faces = soup(count, rng, 1.0)
        centres = rng.uniform(size=(count, 1, 3))
        sizes = size * np.exp(rng.uniform(-spread, spread, size=(count, 1, 1)))
        corners = points.reshape(-1, 3, 3)
        corners = centres + sizes * (corners - corners.mean(axis=1, keepdims=True))
        parts.append((corners.reshape(-1, 3), faces))
    (cloth, cloth_faces), (body, body_faces) = parts
    points = np.concatenate([cloth, body])
    ids = np.arange(len(points))
    if weld:
        chosen = rng.choice(len(points), 12, replace=False)
        ids[chosen[:6]] = ids[chosen[6:]]
    mesh = make_collision_mesh(cloth_faces, len(cloth), body_faces, len(body), weld_ids=ids)
    return mesh, points, rng


def assert_same(mesh, start, end, radius):
    """The same rows in the same order; returns them."""
    expected = find_candidates(mesh, start, end, radius)
    found = finder(mesh, start).rows(start, end, radius)
    for rows, others in zip(found, expected, strict=True):
        assert rows.dtype == np.int32
        np.testing.assert_array_equal(rows, others)
    return found


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("motion", [0.0, 0.02, 0.5])
@pytest.mark.parametrize("spread", [0.0, 2.0], ids=["one size", "1:50"])
def test_loose_triangles(seed, motion, spread):
    mesh, start, rng = loose(seed, spread=spread)
    end = start + motion * rng.normal(size=start.shape)
    vertex_face, edge_edge = assert_same(mesh, start, end, 0.03)
    assert len(vertex_face) and len(edge_edge)


@pytest.mark.parametrize("seed", range(4))
def test_a_radius_at_each_vertex(seed):
    mesh, start, rng = loose(seed)
    end = start + 0.02 * rng.normal(size=start.shape)
    radii = np.exp(rng.uniform(-6.0, -1.0, len(start)))
    radii[rng.choice(len(start), 20, replace=False)] = 0.0
    vertex_face, edge_edge = assert_same(mesh, start, end, radii)
    assert len(vertex_face) and len(edge_edge)
    assert_same(mesh, start, end, 0.0)


@pytest.mark.parametrize("motion", [0.0, 0.1])
def test_brute_force(motion):
    mesh, start, rng = loose(7)
    end = start + motion * rng.normal(size=start.shape)
    needed = required_pairs(mesh, start, end, 0.03)
    found = finder(mesh, start).rows(start, end, 0.03)
    for pairs, rows in zip(needed, found, strict=True):
        assert pairs and pairs <= set(map(tuple, rows.tolist()))


def degenerate(points, rng):
    """Triangles of cloth made degenerate: points, needles, duplicates, parallel and flat ones."""
    points = points.copy()
    corners = points.reshape(-1, 3, 3)
    corners[0] = corners[0, 0]
    corners[1, 2] = corners[1, 1]
    corners[2] = corners[3]
    corners[4, 2] = 0.5 * (corners[4, 0] + corners[4, 1])
    corners[5, 2] = corners[5, 0] + 1e-9 * (corners[5, 1] - corners[5, 0]) + 1e-14
    corners[6] = corners[7] + np.array([0.0, 1e-10, 0.0])
    corners[CLOTH] = corners[8] + 1e-3
    corners[CLOTH + 1] = corners[9, [1, 0, 2]]
    corners[10:14, :, 1] = 0.5
    corners[10:14, :, ::2] = np.round(4.0 * corners[10:14, :, ::2]) / 4.0
    corners[14] += 1e3 * rng.normal(size=3)
    return points


@pytest.mark.parametrize("radius", [0.0, 1e-9, 0.03])
def test_degenerate_triangles(radius):
    mesh, points, rng = loose(3, weld=False)
    start = degenerate(points, rng)
    end = start + 0.01 * rng.normal(size=start.shape)
    for last in (start, end):
        vertex_face, edge_edge = assert_same(mesh, start, last, radius)
        # Coincident vertices, and edges that lie on each other.
        assert {(6, 9, 10, 11)} <= set(map(tuple, vertex_face.tolist()))
        assert {(6, 7, 9, 10)} <= set(map(tuple, edge_edge.tolist()))
    needed = required_pairs(mesh, start, start, radius)
    found = finder(mesh, start).rows(start, start, radius)
    for pairs, rows in zip(needed, found, strict=True):
        assert pairs <= set(map(tuple, rows.tolist()))


@pytest.mark.parametrize("radius", [0.02, 0.02 * np.sqrt(2.0), 0.04])
def test_pairs_at_the_very_radius_of_a_regular_mesh(radius):
    """Distances are multiples of the spacing but for rounding, and so is the radius."""
    lower, faces = grid(7)
    points = np.concatenate([lower, lower + np.array([0.0, 0.02, 0.0])])
    mesh = make_collision_mesh(np.concatenate([faces, faces + 49]), 98)
    vertex_face, edge_edge = assert_same(mesh, points, points, radius)
    assert len(vertex_face) and len(edge_edge)


def test_without_a_body_and_with_some_vertices_left_out():
    points, faces = two_layers(9, gap=0.004)
    mesh = make_collision_mesh(faces, len(points), cloth_vertices=np.arange(0, len(points), 3))
    vertex_face, _ = assert_same(mesh, points, points, 0.006)
    assert len(vertex_face) and not np.any(vertex_face[:, 0] % 3)


def test_empty_meshes():
    mesh = make_collision_mesh(np.zeros((0, 3), int), 0)
    nothing = np.zeros((0, 3))
    for rows in finder(mesh, nothing).rows(nothing, nothing, 1.0):
        assert rows.shape == (0, 4)
    _, faces = grid(3)
    # A body alone collides with nothing, whatever the radius.
    mesh = make_collision_mesh(np.zeros((0, 3), int), 0, faces, 9)
    points = np.zeros((9, 3))
    for rows in finder(mesh, points).rows(points, points, np.inf):
        assert rows.shape == (0, 4)


def test_an_infinite_radius_gives_every_pair():
    points, faces = grid(3)
    mesh = make_collision_mesh(faces, 9)
    vertex_face, edge_edge = assert_same(mesh, points, points, np.inf)
    apart = sum(len(set(a) | set(b)) == 4 for a in mesh.cloth_edges for b in mesh.cloth_edges)
    assert len(vertex_face) == 9 * len(faces) - 3 * len(faces)
    assert len(edge_edge) == apart // 2


def test_a_search_with_too_little_room_is_repeated():
    mesh, start, rng = loose(1)
    end = start + 0.05 * rng.normal(size=start.shape)
    expected = find_candidates(mesh, start, end, 0.1)
    small = finder(mesh, start, capacity=3)
    for rows, others in zip(small.rows(start, end, 0.1), expected, strict=True):
        np.testing.assert_array_equal(rows, others)
    assert all(capacity > 3 for capacity in small.capacities.values())


def test_pairs_are_counted_beyond_the_capacity():
    mesh, start, _ = loose(1)
    forest = plant(mesh, start)
    radii = jax.numpy.full(len(start), 0.1)
    x = jax.numpy.asarray(start)
    boxes, _ = fit(forest, x, x, radii)
    expected = find_candidates(mesh, start, start, 0.1)
    for kind, rows in zip(PairKind, expected, strict=True):
        for capacity in (len(rows) - 1, len(rows) + 1):
            keys, count = search(
                forest,
                boxes,
                x,
                x,
                radii,
                jax.numpy.asarray(mesh.weld_ids),
                kind=kind,
                chunk=CHUNK,
                capacity=capacity,
            )
            assert int(count) == len(rows)
            assert len(np.unique(keys)) == min(capacity, len(rows) + 1)
            assert np.sum(np.asarray(keys) != UNUSED) == min(capacity, len(rows))


@pytest.mark.parametrize("chunk", [1, 7, 4096])
def test_chunks_of_any_size(chunk):
    """Their size bounds stack and queue; a bound that is too small would lose pairs."""
    mesh, start, _ = loose(2, spread=2.0)
    expected = find_candidates(mesh, start, start, 0.2)
    found = DeviceFinder(mesh, start, chunk=chunk).rows(start, start, 0.2)
    for rows, others in zip(found, expected, strict=True):
        np.testing.assert_array_equal(rows, others)


def test_a_mesh_deeper_than_the_seeds():
    """Large enough that pairs of nodes wait on the stack through many chunks."""
    points, faces = two_layers(24, gap=0.004)
    mesh = make_collision_mesh(faces, len(points))
    assert plant(mesh, points).splits >= 10
    for start in (points, np.random.default_rng(0).permutation(points)):
        expected = find_candidates(mesh, start, points, 0.006)
        found = DeviceFinder(mesh, points, chunk=512).rows(start, points, 0.006)
        for rows, others in zip(found, expected, strict=True):
            np.testing.assert_array_equal(rows, others)


def test_both_finders_give_the_same_candidates():
    """Also with another numbering of the body, and with a scale at each vertex."""
    mesh, start, rng = loose(5)
    shift = 100
    scales = rng.uniform(0.1, 1.0, len(start) + shift)
    options = {"body_offset": mesh.n_cloth + shift, "scales": scales}
    for chosen in ({}, options):
        one = TreeFinder(mesh, start).find(start, start, 0.05, **chosen)
        two = finder(mesh, start).find(start, start, 0.05, **chosen)
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True):
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)
    assert np.any(one.vertex_face[1:] >= mesh.n_cloth + shift)


def test_positions_on_the_device_are_taken_as_they_are():
    mesh, start, _ = loose(5)
    expected = finder(mesh, start).rows(start, start, 0.05)
    found = finder(mesh, start).rows(jax.numpy.asarray(start), jax.numpy.asarray(start), 0.05)
    for rows, others in zip(found, expected, strict=True):
        np.testing.assert_array_equal(rows, others)


def test_numbers_of_pairs_and_similar_meshes_compile_nothing():
    programs = (fit, search, columns)

    def find(seed, radius):
        mesh, start, rng = loose(seed)
        # Fewer triangles, in the same buckets.
        kept = mesh.cloth_faces[: CLOTH - seed]
        mesh = make_collision_mesh(kept, 3 * len(kept), mesh.body_faces - 3 * CLOTH, 3 * BODY)
        start = np.concatenate([start[: 3 * len(kept)], start[3 * CLOTH :]])
        end = start + 0.01 * rng.normal(size=start.shape)
        return sum(map(len, finder(mesh, start).rows(start, end, radius)))

    numbers = [find(0, 0.03)]
    before = [program._cache_size() for program in programs]
    assert all(before)
    numbers += [find(seed, radius) for seed, radius in ((0, 0.1), (1, 0.03), (3, 0.0), (4, 0.06))]
    assert len(set(numbers)) == len(numbers)
    assert [program._cache_size() for program in programs] == before


def test_bad_input_is_refused():
    positions, faces = grid(3)
    mesh = make_collision_mesh(faces, 9)
    device = finder(mesh, positions)
    broken = positions.copy()
    broken[4, 1] = np.inf
    with pytest.raises(InputError, match=r"end: shape \(8, 3\), expected \(9, 3\)"):
        device.rows(positions, positions[:-1], 0.1)
    with pytest.raises(InputError, match="start: positions that are not finite"):
        device.rows(broken, positions, 0.1)
    with pytest.raises(InputError, match="end: positions that are not finite"):
        device.rows(positions, broken, 0.1)
    for radius in (float("nan"), -1.0):
        with pytest.raises(InputError, match="radius"):
            device.rows(positions, positions, radius)
    device.rows(positions, positions, 0.1)


def test_a_broad_phase_is_chosen_by_name_or_by_the_backend(monkeypatch):
    positions, faces = grid(3)
    mesh = make_collision_mesh(faces, 9)
    for name in ("trees", "device"):
        assert make_pair_finder(name, mesh, positions).name == name
    for backend, name in (("cpu", "trees"), ("gpu", "device"), ("tpu", "device")):
        monkeypatch.setattr(jax, "default_backend", lambda backend=backend: backend)
        assert make_pair_finder("auto", mesh, positions).name == name
    with pytest.raises(InputError, match="choose one of auto, trees, device"):
        make_pair_finder("grid", mesh, positions)
