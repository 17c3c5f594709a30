"""Image losses in closed form, on their own regions (S10, S21.12)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.core.errors import InputError
from dress_jax.loss.image import (
    color_loss,
    decode_normals,
    encode_normals,
    image_loss,
    mask_loss,
    normal_loss,
)

ZERO = jnp.zeros((2, 4, 4, 3))
LEFT = jnp.zeros((2, 4, 4)).at[:, :, :2].set(1.0)


def test_mean_over_region_channels_and_views():
    target = ZERO.at[0, :, :2, 0].set(0.6).at[:, :, 2:].set(9.0)
    # View 0: one of three channels differs by 0.6 in the region; view 1: nothing.
    assert float(mask_loss(ZERO, target, LEFT)) == pytest.approx(0.5 * 0.6 / 3)
    assert float(color_loss(ZERO, target, LEFT)) == pytest.approx(0.1)
    assert float(normal_loss(ZERO, target, LEFT)) == pytest.approx(0.05)
    assert float(mask_loss(ZERO[0], target[0], LEFT[0] > 0)) == pytest.approx(0.2)


def test_pixels_outside_a_region_do_not_count():
    target = ZERO.at[:, :, 2:].set(7.0)
    value, slope = jax.value_and_grad(lambda a: mask_loss(a, target, LEFT))(ZERO + 0.5)
    assert float(value) == pytest.approx(0.5)
    assert not slope[:, :, 2:].any() and slope[:, :, :2].all()


def test_views_without_region_contribute_zero():
    region = LEFT.at[1].set(0.0)
    value, slope = jax.value_and_grad(lambda a: color_loss(a, ZERO + 1.0, region))(ZERO)
    assert float(value) == pytest.approx(0.5)
    assert np.isfinite(slope).all() and not slope[1].any()


def test_weights_and_terms():
    one, region = ZERO + 1.0, jnp.ones((2, 4, 4))
    total, terms = image_loss(
        mask=(ZERO, one, region), color=(ZERO, one, region), normal=(ZERO, one, region)
    )
    assert float(total) == pytest.approx(1.0 + 0.1 + 0.05)
    assert {k: float(v) for k, v in terms.items()} == {"mask": 1.0, "color": 1.0, "normal": 0.5}
    total, terms = image_loss(mask=(ZERO, one, region), mask_weight=2.0)
    assert float(total) == pytest.approx(2.0) and set(terms) == {"mask"}


def test_shapes_are_checked():
    with pytest.raises(InputError, match="disagree"):
        mask_loss(ZERO, ZERO[:1], LEFT)
    with pytest.raises(InputError, match="disagree"):
        mask_loss(ZERO, ZERO, LEFT[:, :3])


def test_normal_images():
    vector = np.random.default_rng(0).normal(size=(5, 6, 3))
    vector /= np.linalg.norm(vector, axis=-1, keepdims=True)
    image = encode_normals(jnp.asarray(vector))
    assert image.min() >= 0 and image.max() <= 1
    np.testing.assert_allclose(decode_normals(image), vector, atol=1e-12)
    np.testing.assert_array_equal(decode_normals(jnp.full((1, 3), 0.5)), np.zeros((1, 3)))
