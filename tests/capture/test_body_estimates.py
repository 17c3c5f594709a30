"""Parameters of bodies: forms of rotations, frames, and the files of three tools."""

import jax.numpy as jnp
import numpy as np
import pytest
from capture_scenes import body, magicman_body, write
from scipy.spatial.transform import Rotation

from dress_jax.body.model import forward
from dress_jax.capture.body import (
    CAMERA_TO_WORLD,
    BodyFamily,
    body_estimate,
    to_axis_angle,
    world_vertices,
)
from dress_jax.core.errors import InputError
from dress_jax.io.bodies import load_default_body
from dress_jax.io.capture.body_files import read_magicman_body, read_osx, read_smpler_x

RNG = np.random.default_rng(2)
EXACT = 1e-12
METRES = 1e-9


def test_three_forms_of_rotations_agree():
    vectors = 0.8 * RNG.normal(size=(4, 3))  # below half a turn, where they are unique
    matrices = Rotation.from_rotvec(vectors).as_matrix()
    for values in (vectors, matrices, matrices[:, :, :2]):
        np.testing.assert_allclose(to_axis_angle(values, 4, where="x"), vectors, atol=EXACT)
    # Networks give columns that are neither unit nor orthogonal.
    loose = matrices[:, :, :2] @ np.array([[2.0, 0.7], [0.0, 0.5]])
    np.testing.assert_allclose(to_axis_angle(loose, 4, where="x"), vectors, atol=EXACT)


def test_the_world_body_is_the_tools_body_turned_scaled_and_moved():
    """x = W s (v + t) + o, written out on vertices, against the converted pose."""
    model = load_default_body()
    estimate = body(RNG, scale=1.3, betas=RNG.normal(size=6))
    state = forward(
        model,
        jnp.asarray(estimate.pose),
        jnp.asarray(np.pad(estimate.betas, (0, 10))),
        jnp.asarray(estimate.transl),
    )
    expected = 1.3 * np.asarray(state.vertices) @ CAMERA_TO_WORLD.T + estimate.origin
    np.testing.assert_allclose(world_vertices(estimate, model), expected, atol=METRES)
    with pytest.raises(InputError, match="20 shape coefficients, the model 16"):
        world_vertices(body(RNG, betas=np.zeros(20)), model)


def test_poses_of_the_relatives_are_placed_by_joint():
    pose = RNG.normal(size=(52, 3))
    found = body_estimate(pose, np.zeros(10), np.zeros(3), family=BodyFamily.SMPLH)
    np.testing.assert_array_equal(found.pose[:22], pose[:22])
    np.testing.assert_array_equal(found.pose[25:], pose[22:])
    assert not found.pose[22:25].any()
    short = body_estimate(pose[:24], np.zeros(10), np.zeros(3), family=BodyFamily.SMPL)
    np.testing.assert_array_equal(short.pose[:22], pose[:22])
    assert not short.pose[22:].any()
    full = RNG.normal(size=(55, 3))
    whole = body_estimate(full, np.zeros(10), np.zeros(3), family=BodyFamily.SMPLX)
    np.testing.assert_array_equal(whole.pose, full)
    with pytest.raises(InputError, match="smpl has 24 joints"):
        body_estimate(pose, np.zeros(10), np.zeros(3), family=BodyFamily.SMPL)


def smpler_x():
    shapes = {"global_orient": (1, 3), "body_pose": (21, 3), "jaw_pose": (1, 3)}
    shapes |= {"left_hand_pose": (15, 3), "right_hand_pose": (15, 3), "leye_pose": (1, 3)}
    shapes |= {"reye_pose": (1, 3), "betas": (1, 10), "expression": (1, 10), "transl": (1, 3)}
    return {name: RNG.normal(size=shape) for name, shape in shapes.items()}


def test_smpler_x_is_turned_out_of_the_cameras_frame(tmp_path):
    values = smpler_x()
    values["global_orient"] = np.array([[np.pi, 0.0, 0.0]])  # upright before the camera
    values["transl"] = np.array([[0.2, -0.3, 4.0]])
    np.savez(tmp_path / "p.npz", **values)
    found = read_smpler_x(tmp_path / "p.npz").body
    assert found is not None
    for name in ("body_pose", "left_hand_pose", "right_hand_pose"):
        np.testing.assert_array_equal(getattr(found, name), values[name])
    np.testing.assert_array_equal(found.right_eye_pose, values["reye_pose"][0])
    up = found.to_world @ Rotation.from_rotvec(found.global_orient).as_matrix()
    np.testing.assert_allclose(up, np.eye(3), atol=EXACT)
    np.testing.assert_allclose(found.to_world @ found.transl, [0.2, 0.3, -4.0], atol=EXACT)
    del values["betas"]
    np.savez(tmp_path / "less.npz", **values)
    with pytest.raises(InputError, match=r"less\.npz: holds no 'betas'"):
        read_smpler_x(tmp_path / "less.npz")
    np.savez(tmp_path / "odd.npz", **{**smpler_x(), "body_pose": np.zeros((23, 3))})
    with pytest.raises(InputError, match=r"odd\.npz, body_pose: has shape \(69,\)"):
        read_smpler_x(tmp_path / "odd.npz")


def test_magicmans_body_keeps_its_rotations_and_its_frame(tmp_path):
    vectors = 0.7 * RNG.normal(size=(53, 3))
    path = write(tmp_path / "smplx_refined.json", magicman_body(vectors))
    found = read_magicman_body(path, unit=1.25, floor=0.9)
    expected = np.concatenate([vectors[:23], np.zeros((2, 3)), vectors[23:]])
    np.testing.assert_allclose(found.pose, expected, atol=EXACT)
    assert found.scale == pytest.approx(1.0) and found.betas[3] == 3.0
    # (v + trans) scale diag(1, -1, -1), in units of 1.25 m, for a vertex v
    vertex = np.array([0.3, -0.5, 0.2])
    unit = (vertex + np.array([0.1, 0.2, 0.3])) * 0.8 * [1.0, -1.0, -1.0]
    world = found.to_world @ (found.scale * (vertex + found.transl)) + found.origin
    np.testing.assert_allclose(world, 1.25 * unit + [0.0, 0.9, 0.0], atol=EXACT)
    broken = write(tmp_path / "b.json", {**magicman_body(vectors), "body_pose": [0.0] * 7})
    with pytest.raises(InputError, match=r"b\.json, body_pose: holds 7 numbers for 21 joints"):
        read_magicman_body(broken)


def test_osx_is_a_mesh_of_smplx_vertices(tmp_path):
    rows = [f"v {x} {2 * x} 3" for x in range(10475)]
    (tmp_path / "o.obj").write_text("\n".join([*rows, "f 1 2 3"]))
    found = read_osx(tmp_path / "o.obj").body_mesh
    assert found is not None
    np.testing.assert_array_equal(found.vertices[2], [2.0, -4.0, -3.0])
    (tmp_path / "small.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match=r"small\.obj: has 3 vertices, SMPL-X has 10475"):
        read_osx(tmp_path / "small.obj")
