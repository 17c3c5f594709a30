"""IoU and Chamfer distance in closed form and against brute force."""

import numpy as np
import pytest
import trimesh

from dress_jax.core.errors import InputError
from dress_jax.loss.metrics import (
    ChamferMean,
    ChamferTarget,
    chamfer_distance,
    distance_to_surface,
    iou,
    sample_surface,
)

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def test_iou():
    a, b = np.zeros((2, 4, 4)), np.zeros((2, 4, 4))
    a[0, :2], b[0, 1:3], b[1, 0, 0] = 1.0, 0.7, 0.4
    # 4 shared of 12; the 0.4 is below the threshold.
    assert iou(a, b) == pytest.approx(4 / 12)
    assert iou(a, b, threshold=0.3) == pytest.approx(4 / 13)
    # Views are taken together, not averaged: 8 shared of 9.
    a, b = np.zeros((2, 4, 4)), np.zeros((2, 4, 4))
    a[0, :2], b[0, :2], b[1, 0, 0] = 1.0, 1.0, 1.0
    assert iou(a, b) == pytest.approx(8 / 9)
    assert iou(a * 0, b * 0) == 1.0
    with pytest.raises(InputError, match="shapes"):
        iou(a, b[:1])


def test_parallel_squares():
    above = SQUARE + np.array([0, 0, 0.03])
    options = {"samples": 500}
    assert chamfer_distance(SQUARE, FACES, above, FACES, **options) == pytest.approx(3.0)
    assert chamfer_distance(SQUARE, FACES, SQUARE, FACES, **options) == pytest.approx(0, abs=1e-9)
    assert chamfer_distance(
        SQUARE, FACES, above, FACES, directions=ChamferMean.SUM, scale=1.0, **options
    ) == pytest.approx(0.06)
    assert chamfer_distance(
        SQUARE, FACES, above, FACES, squared=True, scale=1000.0, **options
    ) == pytest.approx(900.0)
    # Samples of one surface miss those of the other sideways.
    assert chamfer_distance(SQUARE, FACES, above, FACES, to=ChamferTarget.SAMPLES, **options) > 3.0


def test_one_sided_part_counts_once():
    """A square against itself with a second one 2 m away: only one direction sees it."""
    both = np.concatenate([SQUARE, SQUARE + np.array([0, 0, 2.0])])
    value = chamfer_distance(SQUARE, FACES, both, np.concatenate([FACES, FACES + 4]), samples=4000)
    assert value == pytest.approx(0.5 * 0.5 * 200.0, rel=0.05)


def test_same_seed_same_value():
    ball = trimesh.creation.icosphere(2, 0.5)
    other = np.asarray(ball.vertices) * np.array([1.0, 1.2, 1.0])
    arguments = (np.asarray(ball.vertices), ball.faces, other, ball.faces)
    first = chamfer_distance(*arguments, samples=300, seed=3)
    assert first == chamfer_distance(*arguments, samples=300, seed=3)
    assert first != chamfer_distance(*arguments, samples=300, seed=4)


def test_distance_against_brute_force():
    """Triangles of very different sizes, where the nearest centroid often misleads."""
    random = np.random.default_rng(0)
    triangles = random.normal(size=(60, 1, 3)) + random.uniform(0.01, 2.0, (60, 1, 1)) * (
        random.normal(size=(60, 3, 3))
    )
    points = random.normal(size=(80, 3)) * 2
    repeated = np.repeat(points, 60, axis=0)
    closest = trimesh.triangles.closest_point(np.tile(triangles, (80, 1, 1)), repeated)
    expected = np.linalg.norm(closest - repeated, axis=1).reshape(80, 60).min(axis=1)
    np.testing.assert_allclose(distance_to_surface(points, triangles), expected, rtol=1e-12)


def test_samples_are_uniform_by_area():
    triangles = np.array([[[0.0, 0, 0], [3, 0, 0], [0, 1, 0]], [[5.0, 0, 0], [6, 0, 0], [5, 1, 0]]])
    points = sample_surface(triangles, 20_000, np.random.default_rng(0))
    large = points[:, 0] < 4
    assert large.mean() == pytest.approx(0.75, abs=0.01)
    np.testing.assert_allclose(points[large].mean(axis=0), [1.0, 1 / 3, 0.0], atol=0.02)


def test_errors():
    with pytest.raises(InputError, match="no area"):
        chamfer_distance(SQUARE * 0, FACES, SQUARE, FACES)
    with pytest.raises(InputError, match="samples"):
        chamfer_distance(SQUARE, FACES, SQUARE, FACES, samples=0)
    with pytest.raises(InputError, match="vertices"):
        chamfer_distance(SQUARE[:, :2], FACES, SQUARE, FACES)
