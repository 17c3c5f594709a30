"""Views with fewer pixels show the same."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from capture_scenes import SIZE, landmarks, view

from dress_jax.capture.reduction import reduced_view, reduction_factor
from dress_jax.core.errors import InputError
from dress_jax.render.cameras import project

RNG = np.random.default_rng(5)
POINTS = np.array([[0.2, 1.1, 0.3], [-0.4, 0.2, -0.1]])
PIXELS = 1e-4  # cameras are single precision where pictures are
ROUNDING = 0.5 + 1e-9  # of 255


@pytest.mark.parametrize("factor", [2, 3, 5])
def test_a_reduced_view_shows_points_where_the_whole_one_does(factor):
    whole = dataclasses.replace(view(RNG, "a"), landmarks=landmarks(RNG))
    small = reduced_view(whole, factor)
    size = -(-SIZE // factor)
    assert (small.camera.height, small.camera.width) == (size, size)
    before, after = (project(v.camera, jnp.asarray(POINTS)) for v in (whole, small))
    for old, new in zip(before[:2], after[:2], strict=True):
        np.testing.assert_allclose((np.asarray(old) + 0.5) / factor - 0.5, new, atol=PIXELS)
    old, new = whole.landmarks.points, small.landmarks.points
    np.testing.assert_allclose((old + 0.5) / factor - 0.5, new)
    np.testing.assert_array_equal(whole.landmarks.confidence, small.landmarks.confidence)


def test_pixels_are_means_of_blocks():
    whole = view(RNG, "a")
    small = reduced_view(whole, 4)
    for name in ("rgb", "matte", "mask", "hidden"):
        block = getattr(whole, name)[8:12, 20:24].astype(float).mean(axis=(0, 1))
        np.testing.assert_allclose(getattr(small, name)[2, 5], block, atol=ROUNDING, err_msg=name)
    assert set(small.parts) == set(whole.parts)
    length = np.linalg.norm(small.normal, axis=-1)
    assert (np.isclose(length, 1.0, atol=1e-6) | (length == 0.0)).all() and not small.normal[
        0
    ].any()
    # The last rows continue the picture where its size is no multiple.
    ragged = reduced_view(whole, 5)
    block = whole.mask[45:48, :5].astype(float)
    block = np.concatenate([block, block[-1:], block[-1:]]).mean()
    assert abs(ragged.mask[-1, 0] - block) <= ROUNDING


def test_the_factor_is_the_smallest_that_fits():
    views = (view(RNG, "a"),)
    factors = [reduction_factor(views, side) for side in (SIZE + 1, SIZE, SIZE - 1, 10, 1)]
    assert factors == [1, 1, 2, 5, SIZE]
    assert reduced_view(views[0], 1) is views[0]
    with pytest.raises(InputError, match="size of the views: is 0 px"):
        reduction_factor(views, 0)
