"""Joint ranges and the human prior."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.body.poses import POSES, named_pose
from dress_jax.body.skeleton import JOINTS, joint_index
from dress_jax.reconstruction.losses import absolute_residuals
from dress_jax.reconstruction.prior import joint_range, pose_limits, prior_residuals
from tests.central_differences import check_slope

TOLERANCE = 1e-6  # of fourth-order differences in double precision


def energy(pose, shape):
    return jnp.sum(prior_residuals(pose, shape) ** 2)


def test_ranges_mirror_each_other_and_hold_the_rest_pose():
    low, high = pose_limits()
    assert np.all(low[1:] < 0.0) and np.all(high[1:] > 0.0)
    for name in JOINTS:
        if name.startswith("left"):
            left, right = joint_range(name), joint_range(name.replace("left", "right"))
            np.testing.assert_allclose(left[0], [right[0, 0], -right[1, 1], -right[1, 2]])
            np.testing.assert_allclose(left[1], [right[1, 0], -right[0, 1], -right[0, 2]])


@pytest.mark.parametrize("name", POSES)
def test_named_poses_are_human(name):
    low, high = pose_limits()
    assert np.all(named_pose(name)[1:] >= low[1:]) and np.all(named_pose(name)[1:] <= high[1:])


@pytest.mark.parametrize(
    ("joint", "bent", "broken"),
    [
        ("left_knee", [1.5, 0, 0], [-1.5, 0, 0]),
        ("left_elbow", [0, -1.5, 0], [0, 1.5, 0]),
        ("right_elbow", [0, 1.5, 0], [0, -1.5, 0]),
        ("right_hip", [-1.5, 0, 0], [1.5, 0, 0]),
        ("left_index2", [0, 0, -1.2], [0, 0, 1.2]),
    ],
)
def test_a_joint_bends_one_way_only(joint, bent, broken):
    values = []
    for vector in (bent, broken):
        pose = np.zeros((55, 3))
        pose[joint_index(joint)] = vector
        values.append(float(energy(jnp.asarray(pose), jnp.zeros(16))))
    assert values[1] > 10.0 * values[0]


def test_the_prior_has_the_derivative_of_its_differences():
    rng = np.random.default_rng(0)
    # Far out of range at many joints.
    point = {"pose": jnp.asarray(0.8 * rng.normal(size=(55, 3))), "shape": jnp.asarray(rng.normal(size=16))}  # noqa: E501  # fmt: skip

    def value(at):
        return energy(at["pose"], at["shape"])

    check_slope(jax.jit(value), point, tolerance=TOLERANCE)
    slopes = jax.grad(value)(point)
    assert np.all(np.asarray(slopes["pose"])[0] == 0.0)  # the global rotation is free
    assert np.all(np.linalg.norm(np.asarray(slopes["pose"])[1:], axis=1) > 0.0)


def test_absolute_residuals_square_to_the_mean_absolute_value():
    rng = np.random.default_rng(1)
    difference = jnp.asarray(rng.normal(size=(7, 3)))
    smoothing = 1e-3
    value = float(jnp.sum(absolute_residuals(difference, smoothing) ** 2))
    np.testing.assert_allclose(value, np.mean(np.abs(difference)), atol=smoothing)
    zero = jnp.zeros(4)
    assert float(jnp.sum(absolute_residuals(zero, smoothing) ** 2)) == 0.0
    assert np.all(np.isfinite(jax.jacfwd(lambda d: absolute_residuals(d, smoothing))(zero)))

    def value_of(at):
        return jnp.sum(absolute_residuals(at, smoothing) ** 2)

    check_slope(value_of, 1e-3 * difference, tolerance=TOLERANCE, step=1e-5)
