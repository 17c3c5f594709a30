import ipctk
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import two_layers

from dress_jax.contact import ccd
from dress_jax.contact.broad_phase import find_candidates, make_collision_mesh
from dress_jax.contact.candidates import make_candidates
from dress_jax.contact.ccd import step_bound
from dress_jax.geometry.intersection import edge_face_intersections, minimum_distance
from dress_jax.geometry.topology import unique_edges

# Tight-Inclusion's default tolerance on the time of impact.
TIME_TOLERANCE = 1e-6
EMPTY = np.zeros((0, 4), np.int32)
PAIR = np.array([[0, 1, 2, 3]])
FACE = np.array([[0.2, 1.0, 0.2], [0, 0, 0], [1, 0, 0], [0, 0, 1]], float)
EDGES = np.array([[-1, 0, 0], [1, 0, 0], [0, 1, -1], [0, 1, 1]], float)


def _bound(start, displacement, kind="vertex_face", **options):
    candidates = (
        make_candidates(PAIR, EMPTY) if kind == "vertex_face" else make_candidates(EMPTY, PAIR)
    )
    return float(step_bound(jnp.asarray(start), jnp.asarray(displacement), candidates, **options))


def _falling(height):
    d = np.zeros((4, 3))
    d[0, 1] = -height
    return d


def test_head_on_closed_form():
    # ACCD leaves a tenth to a hundredth of the gap: the true time is 0.5.
    assert 0.4 < _bound(FACE, _falling(2.0)) < 0.5
    # With thickness 0.2, contact is at 0.4.
    assert 0.32 < _bound(FACE, _falling(2.0), min_distance=0.2) < 0.4
    assert _bound(FACE, _falling(0.8)) == 1.0
    assert _bound(FACE, _falling(-5.0)) == 1.0


def test_edges_closed_form():
    d = np.zeros((4, 3))
    d[2:, 1] = -2.0
    assert 0.4 < _bound(EDGES, d, "edge_edge") < 0.5


@pytest.mark.parametrize("kind", ["vertex_face", "edge_edge"])
def test_no_motion_and_common_motion_are_free(kind):
    x = FACE if kind == "vertex_face" else EDGES
    assert _bound(x, np.zeros((4, 3)), kind) == 1.0
    assert _bound(x, np.full((4, 3), 1e6), kind) == 1.0


def test_parallel_edges():
    x = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], float)
    d = np.zeros((4, 3))
    d[2:, 1] = -2.0
    assert 0.4 < _bound(x, d, "edge_edge") < 0.5


def test_a_passage_between_the_ends_is_found():
    # The vertex goes right through: both ends of the motion are far from the face.
    assert _bound(FACE, _falling(100.0)) < 0.01


def test_bad_states_give_zero():
    touching = FACE.copy()
    touching[0, 1] = 0.0
    assert _bound(touching, _falling(1.0)) == 0.0
    assert _bound(touching, np.zeros((4, 3))) == 1.0
    assert _bound(FACE, _falling(0.1), min_distance=1.5) == 0.0
    assert _bound(FACE, _falling(np.nan)) == 0.0
    assert _bound(FACE, _falling(np.inf)) == 0.0
    assert _bound(np.where(FACE == 0.2, np.nan, FACE), _falling(1.0)) == 0.0


@pytest.mark.parametrize("limit", [1, 2, 5, 50])
def test_the_iteration_limit_is_conservative(limit):
    # Sliding closely past the face: many short advances, no hit.
    start = FACE.copy()
    start[0] = [-0.02, 1e-2, 0.2]
    d = np.zeros((4, 3))
    d[0, 0] = 1.5
    limited = _bound(start, d, iteration_limit=limit)
    assert 0.0 < limited < 1.0
    assert limited <= _bound(start, d) == 1.0


def test_no_candidates():
    x = jnp.asarray(FACE)
    assert float(step_bound(x, 100.0 * x, make_candidates(EMPTY, EMPTY), min_distance=0.0)) == 1.0


def _tight_inclusion(kind, start, end, min_distance):
    solver = ipctk.TightInclusionCCD(conservative_rescaling=1.0)
    call = solver.point_triangle_ccd if kind == "vertex_face" else solver.edge_edge_ccd
    hit, time = call(*start, *end, min_distance)
    return time if hit else 1.0


@pytest.mark.parametrize("kind", ["vertex_face", "edge_edge"])
@pytest.mark.parametrize("min_distance", [0.0, 1e-3])
def test_never_beyond_tight_inclusion(kind, min_distance):
    rng = np.random.default_rng(3)
    hits = 0
    for _ in range(60):
        start = rng.normal(size=(4, 3))
        displacement = 0.3 * rng.normal(size=(4, 3))
        # Towards each other, beyond the contact.
        first = 1 if kind == "vertex_face" else 2
        displacement[:first] += 1.5 * (start[first:].mean(0) - start[:first].mean(0))
        oracle = _tight_inclusion(kind, start, start + displacement, min_distance)
        bound = _bound(start, displacement, kind, min_distance=min_distance)
        assert 0.0 < bound <= oracle + TIME_TOLERANCE
        hits += oracle < 1.0
    assert hits > 10


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("min_distance", [0.0, 5e-4])
def test_two_layers_stay_apart(seed, min_distance):
    rng = np.random.default_rng(seed)
    positions, faces = two_layers(10, gap=0.004, seed=seed)
    n = len(positions) // 2
    displacement = 2e-3 * rng.normal(size=positions.shape)
    displacement[n:, 1] -= 0.01  # the upper layer falls through the lower one
    mesh = make_collision_mesh(faces, 2 * n)
    pairs = find_candidates(mesh, positions, positions + displacement, min_distance)
    bound = float(
        step_bound(
            jnp.asarray(positions),
            jnp.asarray(displacement),
            make_candidates(*pairs),
            min_distance=min_distance,
        )
    )
    assert 0.0 < bound < 1.0
    edges = unique_edges(faces)
    before = minimum_distance(positions, faces)
    assert before > min_distance
    for fraction in (0.3, 0.7, 1.0):
        moved = positions + fraction * bound * displacement
        assert len(edge_face_intersections(moved, edges, faces)) == 0
        gap = minimum_distance(moved, faces) - min_distance
        assert gap > 0.005 * (before - min_distance)
    # The bound is not needlessly small: the full step intersects.
    assert len(edge_face_intersections(positions + displacement, edges, faces)) > 0

    candidates = ipctk.Candidates()
    collision_mesh = ipctk.CollisionMesh(positions, edges, faces)
    candidates.build(collision_mesh, positions, positions + displacement, min_distance)
    exact = candidates.compute_collision_free_stepsize(
        collision_mesh,
        positions,
        positions + displacement,
        min_distance,
        ipctk.TightInclusionCCD(conservative_rescaling=1.0),
    )
    assert bound <= exact + TIME_TOLERANCE


def test_many_lanes_are_processed_in_chunks():
    # More pending lanes than a chunk holds; the earliest hit sits in the last one.
    n = 5000
    heights = np.linspace(2.0, 1.0, n)
    positions = np.concatenate(
        [FACE[1:], np.stack([0.2 + 0 * heights, heights, 0.2 + 0 * heights], 1)]
    )
    rows = np.stack([np.arange(3, 3 + n), *np.tile([[0], [1], [2]], n)], axis=1)
    d = np.zeros_like(positions)
    d[3:, 1] = -2.5
    together = step_bound(
        jnp.asarray(positions), jnp.asarray(d), make_candidates(rows, EMPTY), min_distance=0.0
    )
    alone = step_bound(
        jnp.asarray(positions), jnp.asarray(d), make_candidates(rows[-1:], EMPTY), min_distance=0.0
    )
    # Chunks find the hit within what the gap fraction leaves open.
    assert float(together) == pytest.approx(float(alone), rel=1e-3)
    assert float(alone) < 0.4


def test_one_bucket_is_one_program():
    jax.clear_caches()
    x, d = jnp.asarray(FACE), jnp.asarray(_falling(2.0))
    for rows in (PAIR, np.tile(PAIR, (3, 1))):
        step_bound(x, d, make_candidates(rows, EMPTY), min_distance=0.0)
    step_bound(2.0 * x, d, make_candidates(PAIR, PAIR), min_distance=0.1)
    # One program per family of pairs.
    assert ccd._measure._cache_size() == 2
    assert ccd._earliest_hit._cache_size() == 2


def test_single_precision_is_refused():
    with jax.enable_x64(False), pytest.raises(RuntimeError, match="jax_enable_x64"):
        step_bound(
            jnp.asarray(FACE), jnp.asarray(FACE), make_candidates(PAIR, EMPTY), min_distance=0.0
        )
