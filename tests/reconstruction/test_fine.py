"""The fine stage: silhouettes and colours on what is not hidden (S7.6-S7.12).

Posing, drawing and their reverse compile for a while, so most tests here share one program: four
views of 128 pixels without colours.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reconstruction_scenes import person, ring, seen_landmarks

from dress_jax.core.pytree import replace
from dress_jax.reconstruction import (
    BodyViews,
    ReconstructionOptions,
    body_in_world,
    fine,
    make_body_views,
    reconstruct,
)
from dress_jax.reconstruction.losses import PaintedBody, Strengths, draw
from dress_jax.reconstruction.options import Rates
from dress_jax.reconstruction.parameters import pack
from dress_jax.render.cameras import unstack_cameras
from dress_jax.render.mesh import build_adjacency

SIZE, VIEWS = 128, 4
PIXEL = 2.5 / SIZE  # [m]
# Derivatives of a coverage hold on average over about 1.5 pixels (docs/rendering.md); the target
# lies farther away than that.
AWAY, STEP = 4.0, 1.5  # [px]
SILHOUETTE = 0.1  # relative; of some hundred pixels of outline


@jax.jit
def paint(body, adjacency, camera, parameters):
    vertices = body_in_world(body, parameters).vertices.astype(jnp.float32)
    mesh = PaintedBody(vertices, jnp.ones(vertices.shape, jnp.float32), body.faces, adjacency)
    return draw(camera, mesh, jnp.zeros(3, jnp.float32))[0]


@pytest.fixture(scope="module")
def silhouettes(body):
    """Draws the coverage of all views."""
    adjacency = jnp.asarray(build_adjacency(np.asarray(body.faces)))
    cameras = unstack_cameras(ring(VIEWS, size=SIZE))

    def drawn(parameters):
        return np.stack([paint(body, adjacency, camera, parameters) for camera in cameras])

    return drawn


def see(mapping, parameters, mask, *, noise=0.0, occluded=None):
    cameras, landmarks, ids = seen_landmarks(mapping, parameters, cameras=ring(VIEWS, size=SIZE))
    noisy = landmarks + noise * np.random.default_rng(0).normal(size=landmarks.shape)
    return make_body_views(
        cameras,
        noisy,
        np.ones(landmarks.shape[:2]),
        landmark_ids=ids,
        mask=mask,
        occluded=np.zeros(mask.shape) if occluded is None else occluded,
    )


def mask_only(body, mapping, views: BodyViews) -> fine.FineProblem:
    one, zero = jnp.float64(1.0), jnp.float64(0.0)  # of a strong type, as the package's own
    strengths = Strengths(rgb=zero, mask=one, landmark=zero, pose=zero, shape=zero, prior=zero)
    options = ReconstructionOptions(views_per_iteration=VIEWS)
    return fine.make_problem(body, mapping, views, None, strengths, options)


def value_and_slopes(problem, parameters):
    state = fine.FineState(parameters, jnp.ones((12272, 3), jnp.float32), None, jnp.asarray(0))
    arguments = fine._arguments(problem, state, np.arange(VIEWS), np.ones(VIEWS))
    terms, slopes = fine._value_and_gradient(*arguments)
    return float(terms[0]), slopes[0]


# Each moves the outline by about a pixel per unit.
MOVES = {
    "log_scale": (PIXEL / 0.8, lambda p, x: replace(p, log_scale=p.log_scale + x)),
    "translation": (PIXEL, lambda p, x: replace(p, translation=p.translation.at[1].add(x))),
    "rotation": (PIXEL / 0.5, lambda p, x: replace(p, pose=p.pose.at[0, 2].add(x))),
    "left shoulder": (PIXEL / 0.4, lambda p, x: replace(p, pose=p.pose.at[16, 2].add(x))),
    "shape": (PIXEL / 0.05, lambda p, x: replace(p, shape=p.shape.at[0].add(x))),
}


@pytest.mark.parametrize("name", MOVES)
def test_silhouettes_have_the_derivative_of_their_differences(
    body, mapping, truth, silhouettes, name
):
    """S7.7, S7.11: of scale, place, rotation, a joint and the shape, and never zero."""
    unit, move = MOVES[name]
    # A shape moves parts of the outline by less than a pixel, where the loss has its kink; against
    # an empty target it is the area, which has none.
    target = np.zeros((VIEWS, SIZE, SIZE))
    if name != "shape":
        target = silhouettes(move(truth, AWAY * unit))
    problem = mask_only(body, mapping, see(mapping, truth, target))
    _, slopes = value_and_slopes(problem, truth)
    _, along = jax.jvp(lambda x: move(truth, x), (0.0,), (1.0,))
    slope = float(jnp.vdot(pack(slopes), pack(along)))
    high, low = (value_and_slopes(problem, move(truth, s * STEP * unit))[0] for s in (1.0, -1.0))
    difference = (high - low) / (2.0 * STEP * unit)
    assert abs(difference) * unit > 1e-5
    np.testing.assert_allclose(slope, difference, rtol=SILHOUETTE)


def test_hidden_pixels_have_no_influence(body, mapping, truth, silhouettes):
    """S7.6, S7.7, S7.9: whatever the pictures show there."""
    mask = silhouettes(truth)
    occluded = np.zeros(mask.shape)
    occluded[:, 50:] = 1.0
    lies = np.where(occluded > 0.0, np.random.default_rng(0).random(mask.shape), mask)
    other = person(body, seed=3)
    found = [
        value_and_slopes(mask_only(body, mapping, see(mapping, truth, m, occluded=occluded)), other)
        for m in (mask, lies)
    ]
    assert found[0][0] == found[1][0] > 0.0
    np.testing.assert_array_equal(pack(found[0][1]), pack(found[1][1]))


def test_a_person_behind_a_skirt_is_recovered(body, mapping, truth, silhouettes):
    """S7.12 at 128 pixels: the lower half hidden, landmarks off by half a pixel (1 cm)."""
    mask = silhouettes(truth)
    occluded = np.zeros(mask.shape)
    occluded[:, 70:110, 30:100] = 1.0
    skirt = np.maximum(mask, occluded)
    views = see(mapping, truth, skirt, noise=0.5, occluded=occluded)
    options = ReconstructionOptions(fine_iterations=24, views_per_iteration=VIEWS)
    before = fine._value_and_gradient._cache_size()
    stages = []
    found = reconstruct(
        body, views, options=options, listen=lambda stage, *rest: stages.append(stage)
    )
    # One program for all steps, and for the losses before and after them.
    assert fine._value_and_gradient._cache_size() - before <= 1
    assert list(dict.fromkeys(stages)) == ["coarse", "landmarks", "fine"]
    assert found.fine_start is not None and found.fine_end is not None
    assert found.fine_end.mask < 0.8 * found.fine_start.mask
    assert found.fine_end.unfinished == 0 and found.fine_kept
    errors = {}
    for name in ("by_landmarks", "parameters"):
        here, there = (body_in_world(body, p) for p in (getattr(found, name), truth))
        errors[name] = (
            np.linalg.norm(np.asarray(here.joints - there.joints), axis=1)[:22].mean(),
            np.linalg.norm(np.asarray(here.vertices - there.vertices), axis=1).mean(),
        )
    assert errors["parameters"][0] < 0.015  # [m]
    assert errors["parameters"][1] < 0.015
    assert errors["parameters"][1] < errors["by_landmarks"][1]


def test_a_fine_stage_that_makes_it_worse_is_not_kept(body, mapping, truth, silhouettes):
    views = see(mapping, truth, silhouettes(truth))
    rates = Rates(pose=0.3, shape=2.0)  # far too long
    options = ReconstructionOptions(fine_iterations=2, views_per_iteration=VIEWS, rates=rates)
    found = reconstruct(body, views, options=options)
    assert found.fine_start is not None and found.fine_end is not None
    assert found.fine_end.total > found.fine_start.total
    assert not found.fine_kept
    np.testing.assert_array_equal(pack(found.parameters), pack(found.by_landmarks))


def test_a_held_parameter_stays_in_the_fine_stage(body, mapping, truth, silhouettes):
    start = person(body, seed=3)
    problem = mask_only(body, mapping, see(mapping, truth, silhouettes(truth)))
    options = dataclasses.replace(
        problem.options, free=dataclasses.replace(problem.options.free, shape=False, scale=False)
    )
    held = fine.make_problem(body, mapping, problem.views, None, problem.strengths, options)
    state, _ = fine.step(held, fine.init(held, start))
    np.testing.assert_array_equal(state.parameters.shape, start.shape)
    assert state.parameters.log_scale == start.log_scale
    assert np.all(np.asarray(state.parameters.translation) != np.asarray(start.translation))
    np.testing.assert_array_equal(state.parameters.pose[22:25], start.pose[22:25])  # jaw, eyes


def test_each_epoch_looks_at_every_view_once(body, mapping, truth):
    views = see(mapping, truth, np.zeros((VIEWS, SIZE, SIZE)))
    problem = dataclasses.replace(
        mask_only(body, mapping, views), options=ReconstructionOptions(views_per_iteration=3)
    )
    seen = np.concatenate([fine._batch(problem, iteration) for iteration in range(8)])
    for epoch in seen.reshape(-1, VIEWS):
        assert sorted(epoch) == list(range(VIEWS))


@pytest.mark.slow
def test_colours_are_found_and_help(body):
    """S7.6, S7.8 on the benchmark's scene, small."""
    from benchmarks.body_reconstruction.attempt import CASES, attempt

    row, _, found = attempt(body, CASES["noisy"], 1, views=6, size=SIZE, iterations=60)
    start, end = row["loss"]["start"], row["loss"]["end"]
    assert end["rgb"] < 0.7 * start["rgb"]
    assert end["mask"] < start["mask"]
    stages = row["stages"]
    assert stages["fine"]["vertices_cm"] < stages["landmarks"]["vertices_cm"]
    assert found.colors is not None
    assert np.all((found.colors >= 0.0) & (found.colors <= 1.0))
