"""The stages that need landmarks only: coarse from bad starts, then pose and shape (S7)."""

import dataclasses
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reconstruction_scenes import person, pinhole_ring, ring, seen_landmarks
from scipy.spatial.transform import Rotation
from smplx_file import write_smplx_file

from dress_jax.body.skeleton import joint_index
from dress_jax.core.pytree import replace
from dress_jax.io.bodies import load_body_model
from dress_jax.reconstruction import (
    Free,
    ReconstructionOptions,
    body_in_world,
    landmark_map,
    make_body_views,
    reconstruct,
)
from dress_jax.reconstruction import landmark_fit as stages
from dress_jax.reconstruction.landmarks import landmark_points
from dress_jax.reconstruction.levenberg_marquardt import Minimum
from dress_jax.reconstruction.losses import Strengths
from dress_jax.reconstruction.parameters import free_columns, make_parameters, pack

COARSE = ReconstructionOptions().coarse
# Of a strong type, as the package's own, or every stage would compile twice.
STRENGTHS = Strengths(*(jnp.float64(value) for value in (1.0, 1.0, 100.0, 5e-4, 5e-5, 1e-5)))
# Levenberg-Marquardt stops where the loss falls by less than 1e-8 of itself.
EXACT = 1e-5


def disturbed(truth, *, degrees=60.0, axis=(0.3, 0.9, -0.4), factor=1.2, shift=0.3):
    """Pose and shape as they are; rotation, scale and place wrong."""
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array(axis) / np.linalg.norm(axis))
    row = (turn * Rotation.from_rotvec(np.array(truth.pose[0]))).as_rotvec()
    return replace(
        truth,
        log_scale=truth.log_scale + np.log(factor),
        translation=truth.translation + shift,
        pose=truth.pose.at[0].set(jnp.asarray(row)),
    )


@pytest.mark.parametrize("degrees", [60.0, -60.0, 175.0])
def test_the_coarse_stage_mends_rotation_scale_and_place(mapping, truth, views, degrees):
    """S7.3, S7.13: off by 60 degrees and 20 %, and even turned away."""
    start = disturbed(truth, degrees=degrees)
    found, fit = stages.fit_coarse(mapping, views, start, truth, STRENGTHS, COARSE, iterations=60)
    np.testing.assert_allclose(pack(found), pack(truth), atol=EXACT)
    assert fit.converged and fit.iterations < 40


@pytest.mark.slow  # another kind of camera, another program; its derivative is tested by default
def test_the_coarse_stage_works_with_perspective(mapping, truth):
    cameras, landmarks, ids = seen_landmarks(mapping, truth, cameras=pinhole_ring())
    views = make_body_views(cameras, landmarks, np.ones(landmarks.shape[:2]), landmark_ids=ids)
    found, _ = stages.fit_coarse(
        mapping, views, disturbed(truth), truth, STRENGTHS, COARSE, iterations=60
    )
    np.testing.assert_allclose(pack(found), pack(truth), atol=EXACT)


@pytest.mark.parametrize("name", ["scale", "rotation", "translation"])
def test_each_part_of_the_coarse_stage_can_be_held(mapping, truth, views, name):
    start = disturbed(truth, degrees=10.0)
    free = dataclasses.replace(COARSE, **{name: False})
    found, fit = stages.fit_coarse(mapping, views, start, truth, STRENGTHS, free, iterations=30)
    held = np.asarray(pack(start)) == np.asarray(pack(found))
    np.testing.assert_array_equal(held, ~free_columns(free, 16))
    assert fit.losses[-1] < fit.losses[0]


def test_free_columns_name_what_they_hold():
    def count(**held):
        return int(free_columns(Free(**held), 16).sum())

    everything = count()
    assert everything == 1 + 3 + 3 * (55 - 3) + 16  # jaw and eyes stay
    assert everything - count(scale=False) == 1
    assert everything - count(rotation=False) == everything - count(translation=False) == 3
    assert everything - count(hands=False) == 90
    assert everything - count(pose=False) == 3 * (54 - 3)
    assert everything - count(shape=False) == 16


def test_cameras_look_at_the_person():
    for cameras in (ring(), pinhole_ring()):
        middle = stages.middle_of_view(cameras)
        assert np.linalg.norm(middle - [0.0, 0.9, 0.0]) < 0.05
    # A single orthographic line of sight: some point of it, before the eye.
    one = jax.tree.map(lambda leaf: leaf[:1], ring())
    assert np.linalg.norm(stages.middle_of_view(one)[:2] - [0.0, 0.9]) < 0.05


def test_landmarks_alone_give_pose_and_place(body, truth, views):
    """Without an estimate, and without any picture."""
    found = reconstruct(body, views)
    assert found.colors is None and found.fine_end is None
    here, there = (body_in_world(body, p) for p in (found.parameters, truth))
    joints = np.linalg.norm(np.asarray(here.joints - there.joints), axis=1)
    assert joints[:22].mean() < 0.005  # [m]; exact landmarks, shape known from them only
    assert found.landmark_error < 0.1  # [px]


def test_an_estimate_is_kept_where_landmarks_say_nothing(body, mapping, truth, views):
    """S7.10: the landmarks of one arm only; the rest keeps the estimate."""
    arm = [k for k, number in enumerate(mapping.indices) if number in (5, 7, 9)]
    confidence = np.zeros(views.confidence.shape)
    confidence[:, arm] = 1.0
    seen = replace(views, confidence=jnp.asarray(confidence))
    estimate = make_parameters(
        body,
        pose=np.asarray(truth.pose) + 0.05,
        scale=truth.scale,
        translation=np.asarray(truth.translation),
    )
    found = reconstruct(body, seen, estimate=estimate)
    legs = [1, 2, 4, 5, 7, 8]
    np.testing.assert_allclose(
        found.parameters.pose[jnp.array(legs)], estimate.pose[jnp.array(legs)], atol=1e-6
    )


def test_landmark_programs_are_compiled_once(body, mapping, truth, views):
    before = (stages._residuals._cache_size(), stages._jacobian._cache_size())
    for seed in (1, 2):
        start = disturbed(person(body, seed=seed))
        for free in (COARSE, Free()):
            stages.fit_landmarks(mapping, views, start, truth, STRENGTHS, free, iterations=3)
    after = (stages._residuals._cache_size(), stages._jacobian._cache_size())
    assert after[0] - before[0] <= 1 and after[1] - before[1] <= 1


@pytest.fixture(scope="module")
def smplx_body(tmp_path_factory):
    """A synthetic file of the same keys."""
    path = write_smplx_file(tmp_path_factory.mktemp("smplx") / "body.npz")
    return load_body_model(path, shape_components=10)


def test_landmarks_of_an_smplx_file_lie_where_those_of_the_body_lie(smplx_body, body, mapping):
    """S7.1: the rules find the same points on the same surface."""
    here = np.asarray(landmark_points(landmark_map(smplx_body), make_parameters(smplx_body)))
    there = np.asarray(landmark_points(mapping, make_parameters(body)))
    surface = np.array(mapping.point) >= 55
    # Shifted by the pelvis, which is regressed from the surface; joints are approximate.
    shift = np.median(here[surface] - there[surface], axis=0)
    np.testing.assert_allclose((here - there - shift)[surface], 0.0, atol=1e-9)
    assert np.linalg.norm(here - there - shift, axis=1).max() < 0.06  # [m]


@pytest.mark.slow  # correctives and other shapes are another program
def test_an_smplx_file_is_reconstructed_too(smplx_body):
    """S7.1."""
    model = smplx_body
    mapping = landmark_map(model)
    truth = make_parameters(
        model,
        pose=np.asarray(person(model).pose),
        shape=0.3 * np.ones(10),
        translation=np.array([0.0, 0.9, 0.0]),
    )
    cameras, landmarks, ids = seen_landmarks(mapping, truth)
    views = make_body_views(cameras, landmarks, np.ones(landmarks.shape[:2]), landmark_ids=ids)
    estimate = disturbed(truth, degrees=40.0)
    found = reconstruct(model, views, estimate=estimate)
    np.testing.assert_allclose(
        body_in_world(model, found.parameters).joints, body_in_world(model, truth).joints, atol=1e-3
    )


@pytest.mark.parametrize("bent_is_better", [True, False])
def test_one_view_begins_standing_and_bent(mapping, body, truth, monkeypatch, bent_is_better):
    """It does not tell a leg bent forward from one bent back; what fits the landmarks decides."""
    knee = joint_index("left_knee")
    begins = []

    def fit(mapping, views, begin, *rest, iterations):
        begins.append(begin)
        loss = -float(begin.pose[knee, 0]) if bent_is_better else float(begin.pose[knee, 0])
        return begin, Minimum(np.zeros(0), loss, (loss,), 0, True)

    # The package shows the function of the same name instead of its module.
    workflow = sys.modules["dress_jax.reconstruction.reconstruct"]
    monkeypatch.setattr(workflow, "fit_coarse", fit)
    monkeypatch.setattr(workflow, "fit_landmarks", fit)
    for count, estimate, expected in ((1, None, 2), (1, truth, 1), (2, None, 1)):
        begins.clear()
        cameras, landmarks, ids = seen_landmarks(mapping, truth, cameras=ring(count))
        views = make_body_views(cameras, landmarks, np.ones(landmarks.shape[:2]), landmark_ids=ids)
        found = reconstruct(body, views, estimate=estimate)
        assert len(begins) == 1 + expected  # the coarse stage and those after it
        angles = [float(b.pose[knee, 0]) for b in begins[1:]]
        if expected == 2:
            assert angles[1] > angles[0] + 0.5
            best = max(angles) if bent_is_better else min(angles)
            assert float(found.parameters.pose[knee, 0]) == best
