"""Panel textures from eight views, where they are seen and where they are not."""

import dataclasses

import numpy as np
import pytest
import texture_scenes as scenes

from dress_jax.core.errors import InputError
from dress_jax.texture.atlas import atlas_coordinates, find_texels, pack_panels
from dress_jax.texture.baking import bake, outer_sides
from dress_jax.texture.filling import fill
from dress_jax.texture.tiling import Tile

# Pixels are 4.2 mm wide and edges of the checks about 1 mm, so edges are blurred by half a pixel.
MEAN_ERROR = 0.03
SMALLEST_PSNR = 27.0  # dB


@pytest.fixture(scope="module")
def texels(atlas, tube):
    return find_texels(atlas, tube)


def without(views, hidden):
    """The views with a part of the masks taken away."""
    return [dataclasses.replace(v, mask=np.where(hidden(v), 0.0, v.mask)) for v in views]


def test_panels_keep_their_shape_in_the_atlas(atlas, tube):
    """S14.4: texture coordinates are panel coordinates up to one scale and a shift per panel."""
    place = atlas_coordinates(atlas, tube) * [atlas.width, atlas.height] * atlas.texel_size
    assert place.min() > 0.0
    for panel in range(2):
        own = tube.vertex_panels == panel
        shift = place[own] - tube.coordinates[own]
        assert np.ptp(shift, axis=0).max() < 1e-12
    boxes = [place[tube.vertex_panels == panel] for panel in range(2)]
    apart = [
        (boxes[0].min(axis=0) - boxes[1].max(axis=0)).max(),
        (boxes[1].min(axis=0) - boxes[0].max(axis=0)).max(),
    ]
    assert max(apart) >= 4 * atlas.texel_size


def test_texels_lie_on_the_draped_cloth(texels, atlas, tube):
    """Their places in space, against the tube's own formula."""
    angle = np.arctan2(texels.positions[:, 2], texels.positions[:, 0])
    radius = np.hypot(texels.positions[:, 0], texels.positions[:, 2])
    assert np.abs(radius - 0.2 * (1.0 + 0.04 * np.cos(5.0 * angle))).max() < 1e-3
    height = texels.positions[:, 1] + 0.5 * scenes.HEIGHT
    assert np.abs(height - texels.coordinates[:, 1]).max() < 1e-5
    assert (texels.panel == (texels.positions[:, 2] < 0.0)).mean() > 0.995


def test_a_known_texture_comes_back(views, texels, cloth):
    sides = outer_sides(views, 2)
    np.testing.assert_array_equal(sides, 1.0)
    baked = bake(views, texels, sides)
    error = (baked.colors - cloth[texels.row, texels.column])[baked.seen]
    assert baked.seen.mean() > 0.99
    assert baked.views.max() <= 4
    assert np.abs(error).mean() < MEAN_ERROR
    assert -10.0 * np.log10((error**2).mean()) > SMALLEST_PSNR


def test_a_panel_that_faces_the_other_way_is_baked_alike(tube, views, texels):
    """Sides are found by what is seen, so the orientation of faces does not matter."""
    turned = [
        dataclasses.replace(v, seen=dataclasses.replace(v.seen, side=-v.seen.side)) for v in views
    ]
    sides = outer_sides(turned, 2)
    np.testing.assert_array_equal(sides, -1.0)
    other = dataclasses.replace(texels, normals=-texels.normals)
    first, second = bake(views, texels, -sides), bake(turned, other, sides)
    np.testing.assert_allclose(first.colors, second.colors, atol=1e-12)


def test_hidden_cloth_is_not_baked(views, texels):
    """The front view alone shows nothing of the back, and the inside of the cloth counts not."""
    baked = bake(views[:1], texels, np.ones(2))
    assert not baked.seen[texels.panel == 1].any()
    assert baked.seen[texels.panel == 0].mean() > 0.8
    grazing = np.abs(texels.normals[:, 2]) < 0.19
    assert not baked.seen[grazing].any()


def test_holes_are_filled_and_said(views, texels, atlas, cloth):
    """Nearby from neighbours, beyond from the tile at its phase; shares add up per panel."""
    row = np.mgrid[: scenes.SIZE, : scenes.SIZE][0]
    partly = without(views, lambda _: row > 110)
    baked = bake(partly, texels, np.ones(2))
    tile = Tile(
        image=scenes.checks((100, 100), 0.001, (0.05, 0.05)), size=(0.1, 0.1), corner=(0.0, 0.0)
    )
    image, shares = fill(atlas, texels, baked, 2, [tile, None])
    assert image.shape == cloth.shape
    assert shares[0].tile > 0.2 and shares[1].tile == 0.0
    assert shares[1].neighbours > shares[0].neighbours > 0.0
    for share in shares:
        assert sum(dataclasses.astuple(share)) == pytest.approx(1.0)
    far = ~baked.seen & (texels.panel == 0) & (texels.coordinates[:, 1] < 0.15)
    place = texels.coordinates[far]
    column = np.mod(np.floor(place[:, 0] / 0.001), 100).astype(int)
    line = np.mod(99 - np.floor(place[:, 1] / 0.001), 100).astype(int)
    found = image[texels.row[far], texels.column[far]]
    assert np.abs(found - tile.image[line, column]).mean() < 0.02


def test_a_panel_that_nothing_shows_gets_the_mean(views, texels, atlas):
    baked = bake(views[:1], texels, np.ones(2))
    image, shares = fill(atlas, texels, baked, 2, [None, None])
    assert shares[1].mean == 1.0
    back = texels.panel == 1
    mean = baked.colors[baked.seen].mean(axis=0)
    np.testing.assert_allclose(image[texels.row[back], texels.column[back]] - mean, 0.0, atol=1e-12)


def test_views_that_show_nothing_are_refused(views, texels):
    with pytest.raises(InputError, match="no view shows"):
        bake(without(views, lambda v: np.ones(v.mask.shape, bool)), texels, np.ones(2))


@pytest.mark.parametrize(("texel", "message"), [(0.0, "give metres"), (5e-5, "too large")])
def test_texel_sizes_that_cannot_be(tube, texel, message):
    with pytest.raises(InputError, match=message):
        pack_panels(tube, texel)
