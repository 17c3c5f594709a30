"""Readers of AMASS, AIST++ and BVH, and motions on our skeleton (S15)."""

import os
import pickle

import numpy as np
import pytest
from motion_files import FRAMES, bvh_text, write_aist, write_amass
from scipy.spatial.transform import Rotation

from dress_jax.body.skeleton import PARENTS, joint_index
from dress_jax.core.errors import InputError
from dress_jax.io.bodies import load_default_body
from dress_jax.io.motions.bvh import parse_bvh
from dress_jax.io.motions.bvh_skeleton import joints_by_name, read_bvh
from dress_jax.io.motions.read import read_motion
from dress_jax.motion.chain import joint_places, matrices, world_rotations
from dress_jax.motion.clip import heading
from dress_jax.motion.retarget import (
    SMPL_LEG_LENGTH,
    leg_length,
    retarget,
    rotation_between,
    smpl_rest,
)


@pytest.fixture(scope="module")
def joints():
    body = load_default_body()
    return np.asarray(body.joint_template) - [0.0, np.asarray(body.template)[:, 1].min(), 0.0]


def directions(motion, joints, first, second):
    """Unit vectors from one joint to another, per frame."""
    places = joint_places(PARENTS, world_rotations(PARENTS, matrices(motion.pose)), joints)
    bone = places[:, joint_index(second)] - places[:, joint_index(first)]
    return bone / np.linalg.norm(bone, axis=1, keepdims=True)


# AMASS


@pytest.mark.parametrize(("width", "rate"), [(165, "mocap_frame_rate"), (156, "mocap_framerate")])
def test_amass_stands_up_and_keeps_its_joints(tmp_path, joints, width, rate):
    source = read_motion(write_amass(tmp_path / "walk.npz", width=width, rate=rate), same_rest=True)
    assert source.fps == 60.0
    motion = retarget(source, joints)
    # +z of the file is up here, its -y is our front.
    up = Rotation.from_rotvec(motion.pose[:, 0]).apply([0.0, 1.0, 0.0])
    np.testing.assert_allclose(up, np.tile([[0.0, 1.0, 0.0]], (FRAMES, 1)), atol=1e-12)
    angles = [heading(pose) for pose in motion.pose]
    np.testing.assert_allclose(angles, 0.1 * np.arange(FRAMES), atol=1e-12)
    scale = leg_length(joints) / SMPL_LEG_LENGTH
    expected = np.stack([np.zeros(FRAMES), np.full(FRAMES, 1.2), 0.05 * np.arange(FRAMES)], axis=1)
    np.testing.assert_allclose(motion.root, scale * expected, atol=1e-12)
    np.testing.assert_allclose(
        motion.pose[:, 4], np.tile([[0.3, 0.0, 0.0]], (FRAMES, 1)), atol=1e-9
    )
    np.testing.assert_allclose(motion.pose[:, 54, 0], 0.2, atol=1e-9)
    # SMPL-H has neither jaw nor eyes.
    assert np.abs(motion.pose[:, 22:25]).max() < 1e-12


def test_limbs_of_smpl_point_where_they_point_in_the_file(tmp_path, joints):
    """At zero pose our limbs take the directions of SMPL's rest pose, whatever ours are."""
    path = write_amass(tmp_path / "rest.npz", poses=np.zeros((FRAMES, 165)))
    motion = retarget(read_motion(path), joints)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    for name, end in (
        ("left_hip", "left_knee"),
        ("right_knee", "right_ankle"),
        ("right_shoulder", "right_elbow"),
        ("left_elbow", "left_wrist"),
    ):
        wanted = turn @ smpl_rest()[name]
        found = directions(motion, joints, name, end)
        np.testing.assert_allclose(found[0], wanted / np.linalg.norm(wanted), atol=1e-12)
    own = joints[joint_index("left_knee")] - joints[joint_index("left_hip")]
    assert (
        np.degrees(
            np.arccos(
                own
                @ smpl_rest()["left_hip"]
                / np.linalg.norm(own)
                / np.linalg.norm(smpl_rest()["left_hip"])
            )
        )
        > 2.0
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"poses": np.zeros((6, 72))}, r"\(6, 72\)"),
        ({"trans": np.zeros((5, 3))}, "6 poses"),
        ({"poses": np.full((6, 165), np.nan)}, "not finite"),
        ({"trans": np.zeros(3)}, "2 dimensions"),
        ({"mocap_frame_rate": np.array([60.0, 30.0])}, "one number"),
        ({"mocap_frame_rate": 0.0}, "rate"),
    ],
)
def test_faults_of_amass_are_named(tmp_path, change, message):
    path = write_amass(tmp_path / "bad.npz", **change)
    with pytest.raises(InputError, match=message) as caught:
        read_motion(path)
    assert "bad.npz" in str(caught.value)


@pytest.mark.parametrize("missing", ["poses", "trans", "mocap_frame_rate"])
def test_what_amass_lacks_is_named(tmp_path, missing):
    path = write_amass(tmp_path / "bad.npz")
    arrays = dict(np.load(path))
    del arrays[missing]
    np.savez(path, **arrays)
    named = "frame rate" if missing == "mocap_frame_rate" else missing
    with pytest.raises(InputError, match=named):
        read_motion(path)


# AIST++


def test_aist_is_scaled_and_stands_as_it_is(tmp_path, joints):
    source = read_motion(write_aist(tmp_path / "dance.pkl"), same_rest=True)
    assert source.fps == 60.0
    motion = retarget(source, joints)
    scale = leg_length(joints) / SMPL_LEG_LENGTH
    np.testing.assert_allclose(motion.root[0], scale * np.array([0.0, 2.0, 1.0 / 3.0]), atol=1e-6)
    np.testing.assert_allclose(
        [heading(pose) for pose in motion.pose], 0.1 * np.arange(FRAMES), atol=1e-6
    )


class _Trap:
    """Pickles as a call."""

    def __reduce__(self):
        return os.mkdir, ("trap",)


def test_a_pickle_that_wants_to_run_something_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "trap.pkl"
    path.write_bytes(pickle.dumps({"smpl_poses": _Trap()}))
    with pytest.raises(InputError, match="neither a numpy array nor a plain value"):
        read_motion(path)
    assert not (tmp_path / "trap").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"smpl_poses": np.zeros((6, 165))}, "N, 72"),
        ({"smpl_scaling": np.zeros(1)}, "not positive"),
        ({"smpl_trans": np.zeros((2, 3))}, "as many"),
        ({"smpl_trans": "none"}, "no numbers"),
    ],
)
def test_faults_of_aist_are_named(tmp_path, change, message):
    with pytest.raises(InputError, match=message):
        read_motion(write_aist(tmp_path / "bad.pkl", **change))


# BVH


def test_bvh_rotations_are_products_in_the_order_of_the_channels(tmp_path):
    path = tmp_path / "a.bvh"
    path.write_text(bvh_text(order="YZX", rows={"LeftLeg": (20.0, -30.0, 40.0)}))
    file = parse_bvh(path)
    assert file.frame_time == 0.025
    found = file.local[0, file.names.index("LeftLeg")]
    y, z, x = (
        Rotation.from_euler(axis, angle, degrees=True).as_matrix()
        for axis, angle in (("y", 20.0), ("z", -30.0), ("x", 40.0))
    )
    np.testing.assert_allclose(found, y @ z @ x, atol=1e-12)


@pytest.mark.parametrize("scale", [1.0, 0.01, 1 / 2.54])
@pytest.mark.parametrize("world", ["y up", "z up", "turned"])
def test_a_bvh_stands_and_walks_whatever_its_units_and_axes(tmp_path, joints, scale, world):
    turn = {
        "y up": np.eye(3),
        "z up": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
        "turned": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    }[world]
    way = np.array([0.0, 90.0, 0.0]) + np.arange(FRAMES)[:, None] * np.array([2.0, 0.0, 5.0])
    path = tmp_path / "a.bvh"
    path.write_text(bvh_text(turn=turn, scale=scale, root=scale * way @ turn.T))
    source = read_bvh(path)
    assert source.fps == pytest.approx(40.0)
    motion = retarget(source, joints)
    # Legs of 80 cm.
    np.testing.assert_allclose(motion.root, leg_length(joints) / 80.0 * way, rtol=1e-7, atol=1e-7)
    # At rest its legs are straight down and its arms hang; so do ours.
    for name, end in (
        ("left_hip", "left_knee"),
        ("right_knee", "right_ankle"),
        ("left_shoulder", "left_elbow"),
        ("right_elbow", "right_wrist"),
    ):
        found = directions(motion, joints, name, end)
        np.testing.assert_allclose(found, np.tile([[0.0, -1.0, 0.0]], (FRAMES, 1)), atol=1e-7)
    np.testing.assert_allclose(motion.pose[:, 0], 0.0, atol=1e-7)
    # The hands go on from the forearms: their fingers point down.
    assert directions(motion, joints, "left_wrist", "left_middle1")[0, 1] < -0.9


def test_a_lifted_arm_of_a_bvh_is_lifted(tmp_path, joints):
    path = tmp_path / "a.bvh"
    path.write_text(bvh_text(rows={"LeftArm": (90.0, 0.0, 0.0)}))
    motion = retarget(read_bvh(path), joints)
    np.testing.assert_allclose(
        directions(motion, joints, "left_elbow", "left_wrist")[0], [1.0, 0.0, 0.0], atol=1e-7
    )


@pytest.mark.parametrize(
    ("names", "ours"),
    [
        (
            ("mixamorig:Hips", "mixamorig:LeftUpLeg", "mixamorig:LeftLeg"),
            {"pelvis": 0, "left_hip": 1, "left_knee": 2},
        ),
        (
            ("hip", "lThigh", "lShin", "lFoot", "rCollar", "rShldr"),
            {"pelvis": 0, "left_hip": 1, "left_knee": 2, "left_ankle": 3},
        ),
        (
            ("Hips", "LeftHip", "LeftKnee", "LeftAnkle", "LeftShoulder", "LeftElbow", "LeftWrist"),
            {
                "pelvis": 0,
                "left_hip": 1,
                "left_knee": 2,
                "left_ankle": 3,
                "left_shoulder": 4,
                "left_elbow": 5,
                "left_wrist": 6,
            },
        ),
        (
            ("Hips", "Spine", "LeftCollar", "LeftShoulder", "Head_end"),
            {"pelvis": 0, "spine1": 1, "left_collar": 2, "left_shoulder": 3},
        ),
    ],
)
def test_usual_names_are_understood(names, ours):
    found = joints_by_name(names)
    assert ours.items() <= found.items()


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda t: t.replace("HIERARCHY", "H"), "HIERARCHY"),
        (lambda t: t.replace("Frames: 6", "Frames: 7"), "frame 7 of 7"),
        (lambda t: t.replace("Frame Time: 0.025", "Frame Time: fast"), "line"),
        (lambda t: t.replace("Zrotation Xrotation", "Wrotation Xrotation", 1), "unknown channels"),
        (lambda t: t.replace("LeftUpLeg", "LeftThingy"), "left_hip"),
        (lambda t: t.replace("  End Site", "  Something", 1), "not expected"),
        (lambda t: t.rsplit("\n", 2)[0] + "\n1 2 3\n", "channels"),
    ],
)
def test_faults_of_a_bvh_are_named(tmp_path, edit, message):
    path = tmp_path / "bad.bvh"
    path.write_text(bvh_text(edit=edit))
    with pytest.raises(InputError, match=message) as caught:
        read_bvh(path)
    assert "bad.bvh" in str(caught.value)


def test_an_unknown_ending_names_what_is_known():
    with pytest.raises(InputError, match=r"walk, turn, sway.*\.bvh"):
        read_motion("dance.fbx")


def test_the_smallest_rotation_between_directions():
    rng = np.random.default_rng(1)
    for a, b in rng.normal(size=(10, 2, 3)):
        turn = rotation_between(a, b)
        np.testing.assert_allclose(turn @ a / np.linalg.norm(a), b / np.linalg.norm(b), atol=1e-12)
        angle = np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))
        assert Rotation.from_matrix(turn).magnitude() == pytest.approx(angle, abs=1e-7)
    np.testing.assert_allclose(rotation_between([0, 2, 0], [0, -1, 0]) @ [0, 1, 0], [0, -1, 0])
