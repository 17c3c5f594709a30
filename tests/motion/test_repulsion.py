"""Bodies freed of self-intersection (S15.2); ipctk is the judge beside our own exact test."""

import itertools

import ipctk
import numpy as np
import pytest

from dress_jax.body.poses import a_pose
from dress_jax.body.skeleton import joint_index
from dress_jax.core.errors import InputError
from dress_jax.geometry.host_distance import point_triangle
from dress_jax.geometry.intersection import edge_face_intersections
from dress_jax.geometry.topology import unique_edges
from dress_jax.io.bodies import load_default_body
from dress_jax.motion.bodies import RiggedBody
from dress_jax.motion.repulsion import Repulsion, RepulsionOptions
from dress_jax.motion.repulsion_kernels import near_pairs, relax, vertex_normals


@pytest.fixture(scope="module")
def body():
    return RiggedBody(load_default_body(), a_pose(), np.zeros(16), np.zeros(3))


@pytest.fixture(scope="module")
def rest(body):
    return body.vertices(np.zeros((55, 3)), np.zeros(3))


def crosses(vertices, faces) -> bool:
    """By ipctk, which shares no code with ours."""
    edges = ipctk.edges(faces)
    return bool(ipctk.has_intersections(ipctk.CollisionMesh(vertices, edges, faces), vertices))


def bent(**joints) -> np.ndarray:
    pose = a_pose(angle=60.0)
    for name, turn in joints.items():
        pose[joint_index(name)] = turn
    return pose


POSES = {
    "arms down": a_pose(angle=85.0),
    "elbow": bent(left_elbow=(0.0, -1.8, 0.0)),
    "sitting": bent(
        left_hip=(-1.3, 0.0, 0.0), right_hip=(-1.3, 0.0, 0.0), left_knee=(1.3, 0.0, 0.0)
    ),
    "thighs": bent(left_hip=(-0.3, 0.0, -0.25), right_hip=(0.3, 0.0, 0.25)),
}


@pytest.mark.parametrize("name", POSES)
def test_a_body_is_free_and_little_changed(body, rest, name):
    posed = body.vertices(POSES[name], np.zeros(3))
    assert crosses(posed, body.faces)
    freed = Repulsion(rest, body.faces).free(posed)
    assert freed.before > 0
    assert freed.after == 0
    assert not crosses(freed.vertices, body.faces)
    moved = np.linalg.norm(freed.vertices - posed, axis=1)
    assert freed.largest == pytest.approx(moved.max())
    assert freed.largest < 0.04
    # Most of the body is where skinning put it.
    assert np.quantile(moved, 0.5) < 1e-3


def test_a_free_body_stays_as_it_is(body, rest):
    posed = body.vertices(a_pose(angle=45.0), np.zeros(3))
    freed = Repulsion(rest, body.faces).free(posed)
    assert (freed.before, freed.after) == (0, 0)
    np.testing.assert_array_equal(freed.vertices, posed)


def test_parts_are_kept_a_gap_apart(body, rest):
    """The arm's vertices near the trunk are a gap away from it, nearly."""
    gap = 0.008
    posed = body.vertices(POSES["arms down"], np.zeros(3))
    repulsion = Repulsion(rest, body.faces, RepulsionOptions(gap=gap))
    x = repulsion.free(posed).vertices
    hand = np.flatnonzero((rest[:, 0] > 0.5) & (rest[:, 0] < 0.62))  # the forearm, at rest
    trunk = body.faces[(np.abs(rest[body.faces][:, :, 0]) < 0.17).all(axis=1)]
    trunk = trunk[(np.abs(x[trunk][:, :, 1].mean(axis=1) - x[hand, 1].mean()) < 0.15)]
    distances = [min(point_triangle(x[v], *x[face]) for face in trunk) ** 0.5 for v in hand[::4]]
    assert min(distances) > 0.8 * gap


def test_a_motion_is_freed_without_jumps(body, rest):
    """The displacement of the last frame is where the next one starts."""
    repulsion = Repulsion(rest, body.faces)
    shifts = []
    for angle in (80.0, 81.0, 82.0, 83.0):
        posed = body.vertices(a_pose(angle=angle), np.zeros(3))
        freed = repulsion.free(posed)
        assert freed.after == 0
        shifts.append(freed.vertices - posed)
    change = [np.abs(b - a).max() for a, b in itertools.pairwise(shifts)]
    assert max(change) < 0.015


def test_what_cannot_be_freed_is_counted(body, rest):
    """Both forearms within the trunk: deeper than the way out can be told."""
    pose = bent(left_elbow=(0.0, -2.6, 0.0), right_elbow=(0.0, 2.6, 0.0))
    pose[joint_index("left_shoulder")] = (0.0, -1.3, -1.2)
    pose[joint_index("right_shoulder")] = (0.0, 1.3, 1.2)
    freed = Repulsion(rest, body.faces).free(body.vertices(pose, np.zeros(3)))
    again = edge_face_intersections(freed.vertices, unique_edges(body.faces), body.faces)
    assert freed.after == len(again) > 0
    assert freed.largest < 0.09


def test_near_pairs_are_those_of_brute_force():
    """Two facing plates that were far apart at rest."""
    rng = np.random.default_rng(0)
    plate = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], float) * 0.1
    faces = np.array([[0, 2, 1], [0, 3, 2]])  # facing up
    x = np.concatenate([plate, plate + np.array([0.0, 0.02, 0.0])])
    x += 1e-3 * rng.normal(size=x.shape)
    both = np.concatenate([faces, faces[:, ::-1] + 4])  # the upper one faces down
    rest = x.copy()
    rest[4:] += [0.0, 1.0, 0.0]
    found = {tuple(pair) for pair in near_pairs(x, both, rest, reach=0.04, closer=2.0)}
    expected = {(v, f) for v in range(4) for f in (2, 3)}
    expected |= {(v, f) for v in range(4, 8) for f in (0, 1)}
    assert found == expected
    # Facing the same way they are no pair, nor where they were as near at rest.
    same = np.concatenate([faces, faces + 4])
    assert len(near_pairs(x, same, rest, reach=0.04, closer=2.0)) == 0
    assert len(near_pairs(x, both, x, reach=0.04, closer=2.0)) == 0


def test_vertex_normals_are_those_of_a_sphere():
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=3)
    normals = vertex_normals(np.asarray(sphere.vertices), np.asarray(sphere.faces))
    np.testing.assert_allclose(normals, sphere.vertices, atol=0.02)


def test_xpbd_meets_its_constraint_with_the_smallest_smooth_field():
    """A chain pushed at one end: the solution of the quadratic program in closed form."""
    n, edge, anchor, gap = 30, 0.05, 3.0, 0.01
    posed = np.zeros((n + 3, 3))
    edges = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    points, weights = np.array([[0, n, n + 1, n + 2]]), np.array([[1 / 3, 1 / 3, 1 / 3]])
    d = np.zeros_like(posed)
    # Inertia of the displacement fades over restarts, as from frame to frame.
    for _ in range(200):
        relax(
            d,
            posed,
            edges,
            points,
            weights,
            np.array([[0.0, 1.0, 0.0]]),
            np.array([gap]),
            20,
            edge,
            anchor,
        )
    separation = d[0, 1] - d[n:, 1].mean()
    assert separation == pytest.approx(gap, rel=1e-6)
    # Along the chain: (d_i - d_j) / edge balances d_i / anchor.
    inner = (2 * d[1:-1, 1] - d[:-2, 1] - d[2:, 1])[: n - 2] / edge + d[1:-1, 1][: n - 2] / anchor
    assert np.abs(inner[: n - 3]).max() < 1e-2 * gap / edge
    assert (np.diff(d[:n, 1]) < 0).all()


def test_bad_options_are_refused():
    with pytest.raises(InputError, match="gap below the depth"):
        RepulsionOptions(gap=0.05)
