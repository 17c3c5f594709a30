"""S14.1: the largest square of uniform colour inside the mask."""

import dataclasses

import numpy as np
import pytest
import texture_scenes as scenes

from dress_jax.texture.square import central_square, even_cloth, largest_side, uniform_square


def brute_force_side(allowed):
    best = 0
    for row in range(allowed.shape[0]):
        for column in range(allowed.shape[1]):
            side = best + 1
            while (
                row + side <= allowed.shape[0]
                and column + side <= allowed.shape[1]
                and allowed[row : row + side, column : column + side].all()
            ):
                best, side = side, side + 1
    return best


@pytest.mark.parametrize("seed", range(4))
def test_the_largest_square_is_that_of_brute_force(seed):
    allowed = np.random.default_rng(seed).random((24, 31)) < 0.93
    assert largest_side(allowed) == brute_force_side(allowed)
    row, column, side = central_square(allowed)
    assert side == largest_side(allowed)
    assert allowed[row : row + side, column : column + side].all()


def test_an_empty_mask_has_no_square():
    allowed = np.zeros((20, 20), bool)
    assert largest_side(allowed) == 0
    assert central_square(allowed)[2] == 0
    assert uniform_square(np.zeros((20, 20, 3)), allowed) is None


def test_a_shadow_is_left_out():
    """Half of the mask is shaded; the square lies in the even half and fills it."""
    picture = np.full((80, 120, 3), 0.7)
    picture[:, 60:] -= np.linspace(0.0, 0.5, 60)[None, :, None]
    allowed = np.zeros((80, 120), bool)
    allowed[10:70, 2:118] = True
    square = uniform_square(picture, allowed)
    assert square is not None
    assert allowed[square.row : square.row + square.side, square.column :][:, : square.side].all()
    assert square.side >= 56 and square.column + square.side <= 75
    assert square.deviation <= 0.03


def test_checks_are_uniform_and_a_border_is_not():
    y, x = np.mgrid[:90, :150]
    picture = np.repeat((((x // 3) + (y // 3)) % 2)[..., None] * 0.8, 3, axis=2)
    picture[:, 100:] = 0.1
    square = uniform_square(picture, np.ones((90, 150), bool))
    assert square is not None
    assert square.side >= 80 and square.column + square.side <= 104


def test_where_nothing_is_uniform_the_most_uniform_is_taken():
    x = np.linspace(0.0, 1.0, 60) ** 4
    picture = np.repeat(np.broadcast_to(x, (60, 60))[..., None], 3, axis=2)
    square = uniform_square(picture, np.ones((60, 60), bool), tolerance=0.0)
    assert square is not None
    assert square.side <= 22 and square.column < 10


def test_borders_of_panels_folds_and_steep_cloth_are_left_out():
    """A panel border between columns 9 and 10, a fold's jump of coordinates between columns 19 and
    20, and cloth that turns away from column 30 on."""
    column, row = np.meshgrid(np.arange(40), np.arange(12))
    place = 0.003 * np.stack([column, row], axis=-1)
    place[:, 20:, 0] += 0.02
    flat = scenes.flat_map(place, 1.0, 0.003)
    seen = dataclasses.replace(flat, panel=np.where(column < 10, 0, 1))
    cosine = np.where(column < 30, 0.9, 0.5)
    mask = np.ones((12, 40), bool)
    mask[0] = False
    allowed = even_cloth(seen, mask, cosine, smallest_cosine=0.6)
    assert not allowed[0].any()
    left_out = np.flatnonzero(~allowed[1:].any(axis=0))
    np.testing.assert_array_equal(left_out, [9, 10, 19, 20, *range(30, 40)])
    assert allowed[1:, 11:19].all()
