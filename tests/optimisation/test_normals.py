"""Normals at pixels, their changes, and what they add to a Gauss-Newton step (S10.8, S10.9)."""

import jax.numpy as jnp
import numpy as np
import pytest
from fit_scenes import cameras

from dress_jax.core.pytree import replace
from dress_jax.optimisation.gauss_newton.normals import (
    choose_samples,
    normal_jacobian,
    normal_rows,
)
from dress_jax.optimisation.gauss_newton.residuals import Observed, Residuals
from dress_jax.render.contours import find_contours
from dress_jax.render.images import render_views
from tests.central_differences import central_difference

STRIDE = 4
SCALE, LIMIT = 0.5, 0.3


@pytest.fixture(scope="module")
def drawn(problem, state):
    """The tube as it hangs: cameras, garment, faces of the pixels, rendered normals and regions."""
    garment = replace(problem.tables.garment, positions=state.positions)
    views = cameras()
    image = render_views(views, garment, problem.tables.occluder)
    face = np.asarray(find_contours(views, garment, problem.tables.occluder).face)
    return views, garment, face, np.asarray(image.normal), np.asarray(image.mask) > 0.99


def test_sampled_normals_are_the_rendered_ones(drawn):
    views, garment, face, normal, region = drawn
    samples = choose_samples(face, normal, region, STRIDE)
    assert samples.used.sum() > 50
    rows = normal_rows(views, garment, samples)
    assert np.abs(rows.residual).max() < 1e-5  # the picture is in single precision
    assert rows.weight.sum() == pytest.approx(1.0)
    assert not rows.weight[~samples.used].any()


def test_samples_keep_off_the_ends_of_surfaces(drawn):
    _, _, face, normal, region = drawn
    samples = choose_samples(face, normal, region, 1)
    inside = (face >= 0) & region
    for view, row, column in zip(
        *np.nonzero(samples.used)[:1],
        samples.row[samples.used],
        samples.column[samples.used],
        strict=True,
    ):
        assert inside[view, row - 1 : row + 2, column - 1 : column + 2].all()
    empty = choose_samples(face, normal, np.zeros_like(region), STRIDE)
    assert not empty.used.any()


def moved_samples(drawn):
    """Samples whose target are the normals of a garment that is wider and bent."""
    views, garment, face, normal, region = drawn
    samples = choose_samples(face, normal, region, STRIDE)
    x = garment.positions
    wavy = x + 0.01 * jnp.sin(40.0 * x[:, :1]) * jnp.array([[0.2, 0.3, 1.0]])
    other = normal_rows(views, replace(garment, positions=wavy), samples)
    target = samples.target + other.residual
    return replace(samples, target=target)


def test_changes_of_normals_against_differences(drawn):
    views, garment, *_ = drawn
    samples = moved_samples(drawn)
    rng = np.random.default_rng(4)
    ways = rng.normal(size=(*garment.positions.shape, 2))
    jacobian = normal_jacobian(views, garment, samples)
    changes = jacobian.dot(ways.reshape(-1, 2)).reshape(*samples.target.shape, 2)
    weights = rng.normal(size=samples.target.shape) * samples.used[..., None]
    for k in range(2):

        def value(length, k=k):
            moved = replace(garment, positions=garment.positions + length * ways[..., k])
            return np.sum(weights * normal_rows(views, moved, samples).residual)

        slope = np.sum(weights * changes[..., k])
        assert abs(slope) > 1.0
        assert central_difference(value, 1e-6) == pytest.approx(slope, rel=1e-6)


def test_the_model_of_the_normals_has_their_gradient(drawn):
    views, garment, *_ = drawn
    samples = moved_samples(drawn)
    ways = np.random.default_rng(5).normal(size=(*garment.positions.shape, 3))
    rows = normal_rows(views, garment, samples)
    length = np.linalg.norm(rows.residual, axis=-1)[samples.used]
    assert length.max() > LIMIT > length.min()  # both branches of Huber's function
    jacobian = normal_jacobian(views, garment, samples)

    def residuals(value):
        flat, weight = value.reshape(-1, 3), rows.weight.ravel()
        return Residuals(Observed.NORMALS, flat, weight, lambda: jacobian, SCALE, LIMIT)

    model = residuals(rows.residual).model(ways.reshape(-1, 3))
    assert np.linalg.eigvalsh(model.matrix).min() > 0.0
    for k in range(3):

        def cost(length, k=k):
            moved = replace(garment, positions=garment.positions + length * ways[..., k])
            return residuals(normal_rows(views, moved, samples).residual).cost

        assert abs(model.gradient[k]) > 1e-3
        assert central_difference(cost, 1e-6) == pytest.approx(model.gradient[k], rel=1e-5)
