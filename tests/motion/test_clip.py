"""Motions as data: rates, places, ways in, and those made here (S15)."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dress_jax.body.poses import a_pose
from dress_jax.body.skeleton import PARENTS, joint_index
from dress_jax.core.errors import InputError
from dress_jax.io.bodies import load_default_body
from dress_jax.motion.chain import (
    joint_places,
    local_rotations,
    matrices,
    vectors,
    world_rotations,
)
from dress_jax.motion.clip import Motion, eased, heading, lifted, placed
from dress_jax.motion.procedural import Procedure, procedural_motion

FPS = 30.0


@pytest.fixture(scope="module")
def joints():
    body = load_default_body()
    return np.asarray(body.joint_template) - [0.0, np.asarray(body.template)[:, 1].min(), 0.0]


def turning(rate: float, frames: int = 4, fps: float = 10.0) -> Motion:
    """The body turns about +y at a constant rate [rad/s] and walks along +x at 1 m/s."""
    times = np.arange(frames) / fps
    pose = np.zeros((frames, 55, 3))
    pose[:, 0, 1] = rate * times
    return Motion(fps, pose, np.stack([times, 0 * times, 0 * times], axis=1))


def test_resampling_turns_at_a_constant_rate():
    fine = turning(2.0).resampled(30.0)
    assert fine.fps == 30.0
    assert fine.frames == 10  # 0.3 s
    np.testing.assert_allclose(fine.pose[:, 0, 1], 2.0 * np.arange(10) / 30.0, atol=1e-12)
    np.testing.assert_allclose(fine.root[:, 0], np.arange(10) / 30.0, atol=1e-12)


def test_resampling_takes_the_short_way_around():
    """From 170 to 190 degrees, which rotation vectors write as -170, is 20 degrees."""
    pose = np.zeros((2, 55, 3))
    pose[0, 3, 0], pose[1, 3, 0] = np.radians(170.0), np.radians(-170.0)
    middle = Motion(1.0, pose, np.zeros((2, 3))).at(np.array([0.5]))
    assert np.linalg.norm(middle.pose[0, 3]) == pytest.approx(np.pi, abs=1e-9)


def test_times_outside_of_a_clip_are_refused():
    with pytest.raises(InputError, match="the clip runs from 0 to"):
        turning(1.0).at(np.array([0.0, 5.0]))


@pytest.mark.parametrize("fault", ["nan", "shape", "rate"])
def test_a_motion_checks_its_numbers(fault):
    pose, root = np.zeros((3, 55, 3)), np.zeros((3, 3))
    if fault == "nan":
        pose[2, 5, 1] = np.nan
    message = {"nan": "frame 2", "shape": "shape", "rate": "rate"}[fault]
    with pytest.raises(InputError, match=message):
        Motion(0.0 if fault == "rate" else 30.0, pose, root[:2] if fault == "shape" else root)


def test_a_placed_motion_begins_at_the_origin_and_faces_as_asked():
    motion = turning(1.0)
    pose = motion.pose.copy()
    pose[:, 0] = (
        Rotation.from_rotvec([0.0, 1.1, 0.0]) * Rotation.from_rotvec(pose[:, 0])
    ).as_rotvec()
    moved = placed(Motion(10.0, pose, motion.root + np.array([3.0, 0.9, -2.0])), facing=0.4)
    np.testing.assert_allclose(moved.root[0], [0.0, 0.9, 0.0], atol=1e-12)
    assert heading(moved.pose[0]) == pytest.approx(0.4)
    # What was to the side stays to the side: the way turns with the body.
    expected = Rotation.from_rotvec([0.0, 0.4 - 1.1, 0.0]).apply([0.1, 0.0, 0.0])
    np.testing.assert_allclose(moved.root[1] - moved.root[0], expected, atol=1e-12)


def test_lifting_puts_the_lowest_points_on_the_floor():
    motion = turning(1.0, frames=100)
    lowest = np.full(100, 0.12)
    lowest[7] = -0.5  # one bad frame
    assert lifted(motion, lowest).root[0, 1] == pytest.approx(-0.12, abs=1e-9)


def test_the_way_in_begins_in_the_pose_at_rest_and_is_smooth(joints):
    motion = procedural_motion(Procedure.WALK, joints, frames=90, fps=FPS)
    whole = eased(motion, a_pose(), np.zeros(3), seconds=0.8)
    np.testing.assert_allclose(whole.pose[0], a_pose(), atol=1e-12)
    np.testing.assert_array_equal(whole.root[0], np.zeros(3))
    # Half of the blend's time is used up.
    assert whole.frames == 90 + 12
    blend = int(0.8 * FPS)
    after = motion.at((np.arange(blend, whole.frames) / FPS) - 0.4)
    np.testing.assert_allclose(whole.root[blend:], after.root, atol=1e-12)
    # From rest, and no frame's change of velocity exceeds what the walk itself has by much.
    speed = np.diff(whole.root, axis=0) * FPS
    assert np.linalg.norm(speed[0]) < 0.05
    jumps = np.linalg.norm(np.diff(speed, axis=0), axis=1)
    own = np.linalg.norm(np.diff(np.diff(motion.root, axis=0) * FPS, axis=0), axis=1)
    assert jumps.max() < own.max() + 0.2


def test_a_way_in_longer_than_the_clip_is_refused():
    with pytest.raises(InputError, match="twice the length"):
        eased(turning(1.0), a_pose(), np.zeros(3), seconds=0.7)


def test_world_and_local_rotations_are_inverse():
    rng = np.random.default_rng(0)
    local = matrices(0.5 * rng.normal(size=(3, 55, 3)))
    world = world_rotations(PARENTS, local)
    np.testing.assert_allclose(local_rotations(PARENTS, world), local, atol=1e-12)
    np.testing.assert_allclose(matrices(vectors(local)), local, atol=1e-12)


# Procedural motions


def soles(motion: Motion, joints: np.ndarray) -> dict[str, np.ndarray]:
    """Places of heel and ball of both feet on the ground plane, from independent sums."""
    world = world_rotations(PARENTS, matrices(motion.pose))
    places = joint_places(PARENTS, world, joints) + motion.root[:, None] + joints[0]
    return {
        name: places[:, joint_index(name)]
        + world[:, joint_index(name)] @ np.array([0.0, -joints[joint_index(name), 1], 0.0])
        for name in ("left_ankle", "left_foot", "right_ankle", "right_foot")
    }


@pytest.mark.parametrize("procedure", list(Procedure))
def test_feet_are_on_the_floor(procedure, joints):
    motion = procedural_motion(procedure, joints, frames=80, fps=FPS)
    lowest = np.min([place[:, 1] for place in soles(motion, joints).values()], axis=0)
    assert lowest.min() > -0.01 and lowest.max() < 0.03  # toes and sides of the sole left out
    np.testing.assert_allclose(motion.root[0, [0, 2]], 0.0, atol=1e-12)


def test_a_walk_goes_forward_on_feet_that_stay(joints):
    motion = procedural_motion(Procedure.WALK, joints, frames=90, fps=FPS)
    speed = np.diff(motion.root[:, 2]) * FPS
    assert 0.8 < speed.mean() < 1.4
    assert speed.min() > 0.5
    for name in ("left_foot", "right_foot"):
        place = soles(motion, joints)[name]
        down = place[1:, 1] < 0.01
        sliding = np.abs(np.diff(place[:, 2]))[down] * FPS
        assert 0.3 < down.mean() < 0.8
        assert sliding.mean() < 0.3 * speed.mean()
    # The legs are half a cycle apart, the arms swing against them.
    hip = motion.pose[:, joint_index("left_hip"), 0], motion.pose[:, joint_index("right_hip"), 0]
    assert np.corrcoef(*hip)[0, 1] < -0.8
    hands = joint_places(PARENTS, world_rotations(PARENTS, matrices(motion.pose)), joints)
    arm = hands[:, joint_index("left_wrist"), 2] - hands[:, joint_index("left_shoulder"), 2]
    leg = hands[:, joint_index("left_ankle"), 2] - hands[:, joint_index("left_hip"), 2]
    assert np.corrcoef(arm, leg)[0, 1] < -0.8


def test_a_turn_goes_once_around_in_four_seconds(joints):
    motion = procedural_motion(Procedure.TURN, joints, frames=121, fps=FPS)
    angles = np.unwrap([heading(pose) for pose in motion.pose])
    assert angles[-1] - angles[0] == pytest.approx(2.0 * np.pi, abs=1e-6)
    assert np.linalg.norm(motion.root[:, [0, 2]], axis=1).max() < 0.5


def test_a_motion_does_not_depend_on_its_rate(joints):
    slow = procedural_motion(Procedure.SWAY, joints, frames=30, fps=15.0)
    fast = procedural_motion(Procedure.SWAY, joints, frames=60, fps=30.0)
    np.testing.assert_allclose(slow.pose, fast.pose[::2], atol=1e-12)
    np.testing.assert_allclose(slow.root, fast.root[::2], atol=5e-3)
