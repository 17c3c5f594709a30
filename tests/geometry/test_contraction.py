"""Contraction onto the curve skeleton: closed forms on a capsule, figures on a real body."""

import numpy as np
import pytest

from dress_jax.geometry.contraction import curve_skeleton

# The thinnest level keeps about 1 / (1 + RING_STRENGTH) of a ring; discretization doubles it.
THIN = 0.15


def elliptic_capsule(*, half_width=0.15, half_depth=0.09, height=1.6, rings=80, around=48):
    """A closed upright tube with elliptic sections and rounded ends."""
    levels = np.linspace(0.0, 1.0, rings + 2)[1:-1]
    profile = np.minimum(1.0, np.sqrt(np.sin(np.pi * levels)) * 1.3)
    angles = 2.0 * np.pi * np.arange(around) / around
    x = half_width * profile[:, None] * np.cos(angles)
    z = half_depth * profile[:, None] * np.sin(angles)
    y = np.broadcast_to(height * levels[:, None], x.shape)
    body = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    vertices = np.concatenate([body, [[0.0, 0.0, 0.0], [0.0, height, 0.0]]])
    k = np.arange(around)
    following = (k + 1) % around
    faces = []
    for ring in range(rings - 1):
        low, high = ring * around, (ring + 1) * around
        faces.append(np.stack([low + k, high + k, high + following], axis=1))
        faces.append(np.stack([low + k, high + following, low + following], axis=1))
    bottom, top, last = len(body), len(body) + 1, (rings - 1) * around
    faces.append(np.stack([np.full(around, bottom), k, following], axis=1))
    faces.append(np.stack([last + k, np.full(around, top), last + following], axis=1))
    return vertices, np.concatenate(faces)


def test_an_elliptic_tube_collapses_onto_its_axis():
    vertices, faces = elliptic_capsule()
    targets = curve_skeleton(vertices, faces).targets
    middle = np.abs(vertices[:, 1] - 0.8) < 0.6
    radius = np.hypot(vertices[middle, 0], vertices[middle, 2])
    thin = np.hypot(targets[middle, 0], targets[middle, 2])
    assert (thin < THIN * radius).all()
    # Along the axis nothing shortens: ends stay and rings keep their height.
    assert np.ptp(targets[:, 1]) > 0.97 * np.ptp(vertices[:, 1])
    assert np.abs(targets[middle, 1] - vertices[middle, 1]).max() < 0.04


def test_the_result_scales_and_moves_with_the_body():
    vertices, faces = elliptic_capsule(rings=30, around=24)
    targets = curve_skeleton(vertices, faces).targets
    moved = curve_skeleton(100.0 * vertices + 7.0, faces).targets
    np.testing.assert_allclose(moved, 100.0 * targets + 7.0, atol=1e-5)


def test_split_vertices_move_together_and_other_components_follow():
    vertices, faces = elliptic_capsule(rings=30, around=24)
    rng = np.random.default_rng(0)
    split = vertices[faces].reshape(-1, 3)  # every corner its own vertex
    bead = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.01]])
    bead += vertices[200] * 0.9
    bead_faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    order = rng.permutation(len(split) + 4)
    place = np.argsort(order)
    everything = np.concatenate([split, bead])[order]
    corner_faces = np.arange(len(split)).reshape(-1, 3)
    all_faces = place[np.concatenate([corner_faces, bead_faces + len(split)])]
    targets = curve_skeleton(everything, all_faces).targets[place]
    welded = curve_skeleton(vertices, faces).targets
    np.testing.assert_allclose(targets[: len(split)], welded[faces].reshape(-1, 3), atol=1e-9)
    expected = welded[200] - vertices[200]
    np.testing.assert_allclose(targets[len(split) :] - bead, [expected] * 4, atol=0.02)


def test_unusable_bodies_are_refused():
    vertices, faces = elliptic_capsule(rings=6, around=6)
    with pytest.raises(ValueError, match="positive area"):
        curve_skeleton(vertices, faces[:0])
    with pytest.raises(ValueError, match="finite"):
        curve_skeleton(np.where(vertices > 1.0, np.nan, vertices), faces)


def test_figures_on_a_real_body(shared_data):
    trimesh = pytest.importorskip("trimesh")
    body = trimesh.load(shared_data / "bodies" / "mean_all.obj", process=False)
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces)
    targets = curve_skeleton(vertices, faces).targets
    x, y = vertices[:, 0], vertices[:, 1]
    head, hand, foot = y > 1.5, x > x.max() - 0.15, (y < 0.08) & (x > 0)
    for part in (head, hand, foot):
        assert np.linalg.norm(targets[part].mean(axis=0) - vertices[part].mean(axis=0)) < 0.05
    for level, side in [(1.1, 0.2), (1.0, 0.2), (0.9, 0.25)]:
        ring = (np.abs(y - level) < 0.01) & (np.abs(x) < side)
        before = np.linalg.norm((vertices[ring] - vertices[ring].mean(axis=0))[:, [0, 2]], axis=1)
        after = np.linalg.norm((targets[ring] - targets[ring].mean(axis=0))[:, [0, 2]], axis=1)
        assert after.mean() < THIN * before.mean()
