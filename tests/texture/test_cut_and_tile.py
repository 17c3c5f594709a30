"""S14.1, S14.2: flat cloth from a picture, made tileable, at its physical size."""

import numpy as np
import pytest
import texture_scenes as scenes
from scipy.ndimage import gaussian_filter, map_coordinates
from texture_scenes import PERIOD, TEXEL

from dress_jax.texture.cut import cut_cloth
from dress_jax.texture.square import Square
from dress_jax.texture.tiling import find_period, flatten_light, seamless_tile, wrap_jump

PERIOD_TOLERANCE = 0.03  # relative; pixels are a tenth of a period wide


def grain_angle(image):
    """Direction of the dominant gradient [degrees] from the columns' direction."""
    gray = image.mean(axis=-1)
    down, right = np.gradient(gray)
    return 0.5 * np.degrees(
        np.arctan2(2.0 * (right * down).sum(), (right**2).sum() - (down**2).sum())
    )


def test_the_cut_shows_the_cloth_where_it_was_cut(front_cut, atlas, cloth):
    """S14.4: against the true checks at the cut's own place on the panel, to half a texel."""
    _, cut = front_cut
    assert cut.panel == 0
    count = len(cut.image)
    at = cut.texel_size * (0.5 + np.arange(count))
    across = (cut.corner[0] + at + atlas.offsets[0, 0]) / atlas.texel_size - 0.5
    up = (cut.corner[1] + at[::-1] + atlas.offsets[0, 1]) / atlas.texel_size
    grid = np.meshgrid(atlas.height - up - 0.5, across, indexing="ij")
    gray = cloth.mean(axis=-1)

    def error(right, down):
        place = [grid[0] + down, grid[1] + right]
        true = map_coordinates(gray, place, order=1, mode="nearest")
        return np.abs(cut.image.mean(axis=-1) - true)[8:-8, 8:-8].mean()

    assert error(0.0, 0.0) < 0.06
    for shift in (0.5, -0.5):
        assert error(shift, 0.0) > error(0.0, 0.0) and error(0.0, shift) > error(0.0, 0.0)


def test_checks_keep_their_periods(front_cut):
    """S14.2: the period of the cloth in metres, along and across the grain."""
    _, cut = front_cut
    tile = seamless_tile(cut.image, cut.texel_size, corner=tuple(cut.corner))
    for found, true, size in zip(tile.periods, PERIOD, tile.size, strict=True):
        assert found is not None
        assert abs(found / true - 1.0) < PERIOD_TOLERANCE
        # The tile is a whole number of periods, so that it continues itself.
        assert abs(size / true - round(size / true)) < PERIOD_TOLERANCE
    assert max(wrap_jump(tile.image)) <= 1.0


@pytest.mark.parametrize("turn", [0.0, 30.0])
def test_stripes_stand_along_the_grain_however_the_body_turns(turn):
    """A flat panel, foreshortened by a turn of the body: stripes of known period along +y."""
    size, pixel = 128, 0.003
    cosine = np.cos(np.radians(turn))
    column, row = np.meshgrid(np.arange(size), np.arange(size))
    x, y = column * pixel / cosine, (size - row) * pixel + 0.3 * column * pixel * np.sin(0.3)
    period = 0.045
    value = 0.5 + 0.4 * np.sin(2.0 * np.pi * x / period)
    picture = np.repeat(value[..., None], 3, axis=2)
    seen = scenes.flat_map(np.stack([x, y], axis=-1), cosine, pixel)
    cut = cut_cloth(picture, seen, Square(10, 10, 100, 0.0))
    assert cut is not None
    tile = seamless_tile(cut.image, cut.texel_size)
    assert tile.periods[0] is not None
    assert abs(tile.periods[0] / period - 1.0) < PERIOD_TOLERANCE
    assert tile.periods[1] is None
    assert abs(grain_angle(tile.image)) < 1.0
    assert max(wrap_jump(tile.image)) <= 1.0


def test_a_strip_too_narrow_gives_no_cut():
    column, row = np.meshgrid(np.arange(40), np.arange(40))
    place = np.stack([column * 1e-4, row * 0.003], axis=-1)
    seen = scenes.flat_map(place, 1.0, 0.003)
    assert cut_cloth(np.zeros((40, 40, 3)), seen, Square(0, 0, 30, 0.0)) is None


def test_plain_noise_tiles_without_a_seam():
    noise = gaussian_filter(np.random.default_rng(3).random((90, 100, 3)), (1.5, 1.5, 0.0))
    tile = seamless_tile(noise, TEXEL)
    assert tile.periods == (None, None)
    assert max(wrap_jump(tile.image)) <= 1.0
    # The same piece without the cut has a seam, which the measure sees.
    assert min(wrap_jump(noise)) > 1.3


@pytest.mark.parametrize("axis", [0, 1])
def test_periods_between_texels_are_found(axis):
    image = scenes.stripes((160, 160), 1.0, 17.3, axis)
    found = find_period(image, axis=axis)
    assert found is not None
    assert abs(found - 17.3) < 0.05
    assert find_period(image, axis=1 - axis) is None


def test_plain_cloth_has_no_period():
    assert find_period(np.full((40, 40, 3), 0.4), axis=0) is None


def test_shade_goes_and_the_pattern_stays():
    image = scenes.checks((150, 150), 1.0, (21.0, 34.0))
    y, x = np.meshgrid(np.linspace(-1, 1, 150), np.linspace(-1, 1, 150), indexing="ij")
    shade = 0.8 + 0.15 * x - 0.1 * y * y
    flat = flatten_light(image * shade[..., None], (21.0, 34.0))
    ratio = flat / image
    # Quadratic shade times a pattern averages to the shade; what is left is its fit's error.
    assert ratio.std() < 0.01 * ratio.mean()


def test_a_picture_too_small_is_refused():
    with pytest.raises(ValueError, match="too small"):
        seamless_tile(np.zeros((4, 40, 3)), TEXEL)
