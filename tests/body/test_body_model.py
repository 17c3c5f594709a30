"""Skinning: closed forms, finite differences, an independent double-loop reference."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dress_jax.body.measurements import measure, section_girth
from dress_jax.body.model import BodyModel, forward, named_shape, rotation_matrices
from dress_jax.body.poses import POSES, a_pose, interpolate_poses, named_pose
from dress_jax.body.skeleton import JOINTS, PARENTS, depth_levels, joint_index
from dress_jax.io.bodies import load_default_body

# Central differences of a smooth function in double precision.
STEP, TOLERANCE = 1e-5, 1e-7
ZERO = np.zeros(3)


@pytest.fixture(scope="module")
def default_body():
    return load_default_body()


def small_body(*, vertices=20, components=4, correctives=True, seed=0):
    rng = np.random.default_rng(seed)
    count = len(PARENTS)
    weights = rng.random((vertices, count)) ** 4
    return BodyModel(
        template=jnp.array(rng.normal(size=(vertices, 3))),
        shapedirs=jnp.array(0.1 * rng.normal(size=(vertices, 3, components))),
        posedirs=jnp.array(0.01 * rng.normal(size=(vertices, 3, 9 * (count - 1))))
        if correctives
        else None,
        joint_template=jnp.array(rng.normal(size=(count, 3))),
        joint_shapedirs=jnp.array(0.1 * rng.normal(size=(count, 3, components))),
        skin_weights=jnp.array(weights / weights.sum(axis=1, keepdims=True)),
        pose_mean=jnp.array(0.1 * rng.normal(size=(count, 3))),
        named_shapes=jnp.ones((1, components)),
        faces=jnp.array([[0, 1, 2]]),
        parents=PARENTS,
        shape_names=("ones",),
    )


def reference(model, pose, shape, translation):
    """The same equations, vertex by vertex with scipy's rotations and 4x4 matrices."""
    rotations = Rotation.from_rotvec(pose + np.asarray(model.pose_mean)).as_matrix()
    rest = np.asarray(model.template) + np.asarray(model.shapedirs) @ shape
    joints = np.asarray(model.joint_template) + np.asarray(model.joint_shapedirs) @ shape
    if model.posedirs is not None:
        rest = rest + np.asarray(model.posedirs) @ (rotations[1:] - np.eye(3)).ravel()
    world = []
    for joint, parent in enumerate(model.parents):
        local = np.eye(4)
        local[:3, :3] = rotations[joint]
        local[:3, 3] = joints[joint] - (joints[parent] if parent >= 0 else 0.0)
        world.append(local if parent < 0 else world[parent] @ local)
    out = np.zeros_like(rest)
    for vertex, point in enumerate(rest):
        for joint, matrix in enumerate(world):
            moved = matrix[:3, :3] @ (point - joints[joint]) + matrix[:3, 3]
            out[vertex] += float(model.skin_weights[vertex, joint]) * moved
    return out + translation, np.array([matrix[:3, 3] for matrix in world]) + translation


@pytest.mark.parametrize("correctives", [True, False])
def test_forward_matches_the_reference(correctives):
    model = small_body(correctives=correctives)
    rng = np.random.default_rng(1)
    pose, shape, translation = rng.normal(size=(55, 3)), rng.normal(size=4), rng.normal(size=3)
    state = forward(model, jnp.array(pose), jnp.array(shape), jnp.array(translation))
    vertices, joints = reference(model, pose, shape, translation)
    np.testing.assert_allclose(state.vertices, vertices, atol=1e-12)
    np.testing.assert_allclose(state.joints, joints, atol=1e-12)


@pytest.mark.parametrize("scale", [0.0, 1e-3, 0.5])
def test_gradients_match_central_differences(scale):
    model = small_body()
    rng = np.random.default_rng(2)
    weights = jnp.array(rng.normal(size=(20, 3)))
    joint_weights = jnp.array(rng.normal(size=(55, 3)))
    # At scale zero every joint sits exactly at the singular point of the angle.
    point = [
        scale * rng.normal(size=(55, 3)) - np.asarray(model.pose_mean) * (scale == 0.0),
        rng.normal(size=4),
        rng.normal(size=3),
    ]

    def value(pose, shape, translation):
        state = forward(model, pose, shape, translation)
        return jnp.sum(weights * state.vertices**2) + jnp.sum(joint_weights * state.joints)

    gradients = jax.grad(value, argnums=(0, 1, 2))(*map(jnp.array, point))
    for k, gradient in enumerate(gradients):
        assert np.isfinite(gradient).all()
        assert np.linalg.norm(gradient) > 1e-2
        direction = rng.normal(size=point[k].shape)
        shifted = [
            value(*[jnp.array(p + sign * STEP * direction) if i == k else jnp.array(p)
                    for i, p in enumerate(point)])
            for sign in (1.0, -1.0)
        ]  # fmt: skip
        expected = (shifted[0] - shifted[1]) / (2.0 * STEP)
        np.testing.assert_allclose(jnp.sum(gradient * direction), expected, rtol=TOLERANCE * 10)


def test_rotation_matrices_match_scipy_across_the_series_switch():
    rng = np.random.default_rng(3)
    axes = rng.normal(size=(9, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angles = np.array([0.0, 1e-12, 1e-6, 3.1e-3, 3.2e-3, 0.1, 1.0, np.pi, 5.0])
    vectors = axes * angles[:, None]
    expected = Rotation.from_rotvec(vectors).as_matrix()
    np.testing.assert_allclose(rotation_matrices(jnp.array(vectors)), expected, atol=3e-16 * 4)


def test_forward_is_traced_once_per_shape_count():
    model = small_body()
    pose, before = jnp.zeros((55, 3)), forward._cache_size()
    for k in range(3):
        forward(model, pose + k, jnp.ones(4) * k, jnp.zeros(3))
    assert forward._cache_size() - before <= 1


def test_fewer_coefficients_leave_the_rest_at_zero_and_more_are_refused():
    model = small_body()
    pose = 0.3 * jnp.ones((55, 3))
    few = forward(model, pose, jnp.array([1.0, -2.0]), jnp.zeros(3))
    padded = forward(model, pose, jnp.array([1.0, -2.0, 0.0, 0.0]), jnp.zeros(3))
    np.testing.assert_allclose(few.vertices, padded.vertices, atol=1e-14)
    with pytest.raises(ValueError, match="4 components"):
        forward(model, pose, jnp.zeros(5), jnp.zeros(3))
    with pytest.raises(ValueError, match=r"\(55, 3\)"):
        forward(model, pose[:54], jnp.zeros(4), jnp.zeros(3))


def test_depth_levels_cover_the_tree_and_refuse_broken_ones():
    levels = depth_levels(PARENTS)
    assert sorted(sum(levels, ())) == list(range(55))
    for bad in [(), (0, 0), (-1, -1), (-1, 2, 0)]:
        with pytest.raises(ValueError, match="joint"):
            depth_levels(bad)


def test_names_that_do_not_exist_are_listed(default_body):
    with pytest.raises(ValueError, match="arms_up"):
        named_pose("lotus")
    with pytest.raises(ValueError, match="female"):
        named_shape(default_body, "giant")
    with pytest.raises(ValueError, match="left_knee"):
        joint_index("tail")
    assert float(jnp.abs(named_shape(default_body, "average")).max()) == 0.0


def test_pose_interpolation_turns_at_a_constant_rate():
    path = interpolate_poses(named_pose("t"), a_pose(angle=60.0), steps=4)
    np.testing.assert_allclose(path[0], named_pose("t"))
    np.testing.assert_allclose(path[-1], a_pose(angle=60.0))
    np.testing.assert_allclose(path[1], a_pose(angle=20.0), atol=1e-14)
    with pytest.raises(ValueError, match="two steps"):
        interpolate_poses(path[0], path[1], steps=1)


def test_the_default_body_is_closed_upright_and_of_usual_size(default_body):
    faces = np.asarray(default_body.faces)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert (counts == 2).all()
    left, right = joint_index("left_wrist"), joint_index("right_wrist")
    for name, low, high in [("female", 1.62, 1.70), ("male", 1.68, 1.76), ("average", 1.6, 1.75)]:
        state = forward(
            default_body, jnp.zeros((55, 3)), named_shape(default_body, name), jnp.zeros(3)
        )
        vertices, joints = np.asarray(state.vertices), np.asarray(state.joints)
        size = measure(vertices, faces, half_width=joints[joint_index("left_shoulder"), 0])
        assert low < size.height < high
        assert abs(vertices[:, 1].min()) < 2e-3
        assert joints[left, 0] > 0.5 > -0.5 > joints[right, 0]  # +x is the wearer's left
        assert joints[joint_index("left_foot"), 2] > joints[joint_index("left_ankle"), 2]
        assert size.waist < size.bust
        assert size.waist < size.hips
    volume = np.einsum("fi,fi->", *(vertices[faces[:, 0]], np.cross(vertices[faces[:, 1]], vertices[faces[:, 2]]))) / 6  # fmt: skip  # noqa: E501
    assert 0.04 < volume < 0.12  # faces point outward


@pytest.mark.parametrize("pose", list(POSES))
@pytest.mark.parametrize("shape", ["average", "female", "male"])
def test_the_default_body_does_not_intersect_itself(default_body, pose, shape):
    ipctk = pytest.importorskip("ipctk")
    state = forward(
        default_body, jnp.array(named_pose(pose)), named_shape(default_body, shape), jnp.zeros(3)
    )
    vertices, faces = np.asarray(state.vertices), np.asarray(default_body.faces)
    mesh = ipctk.CollisionMesh(vertices, ipctk.edges(faces), faces)
    assert not ipctk.has_intersections(mesh, vertices)


def test_a_girth_is_the_hull_of_the_section():
    angles = 2.0 * np.pi * np.arange(400) / 400
    ring = np.stack([0.2 * np.cos(angles), np.zeros(400), 0.1 * np.sin(angles)], axis=1)
    tube = np.concatenate([ring, ring + np.array([0.0, 1.0, 0.0])])
    k, n = np.arange(400), (np.arange(400) + 1) % 400
    faces = np.concatenate([np.stack([k, k + 400, n + 400], 1), np.stack([k, n + 400, n], 1)])
    ellipse = np.sum(np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1))
    assert section_girth(tube, faces, 0.5) == pytest.approx(ellipse, rel=1e-4)
    with pytest.raises(ValueError, match="does not cut"):
        section_girth(tube, faces, 2.0)


def test_every_joint_has_one_name():
    assert len(set(JOINTS)) == len(JOINTS) == len(PARENTS) == 55
