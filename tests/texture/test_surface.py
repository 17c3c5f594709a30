"""The garment in panel vertices, and the garments of an outfit."""

import numpy as np
import pytest
import texture_scenes as scenes

from dress_jax.texture.surface import make_panel_surface
from dress_jax.texture.textured import tile_texture
from dress_jax.texture.tiling import Tile


def outfit():
    """Two tubes, the second above the first."""
    vertices, faces, rest, rest_faces, _, face_panels = scenes.tube_arrays()
    return make_panel_surface(
        np.concatenate([vertices, vertices + np.array([0.0, 1.0, 0.0])]),
        np.concatenate([faces, faces + len(vertices)]),
        np.concatenate([rest, rest]),
        np.concatenate([rest_faces, rest_faces + len(rest)]),
        ("front", "back", "upper_front", "upper_back"),
        np.concatenate([face_panels, face_panels + 2]),
    )


def test_panel_vertices_lie_on_their_welded_ones():
    vertices, faces, rest, rest_faces, *_ = scenes.tube_arrays()
    tube = scenes.tube()
    np.testing.assert_array_equal(tube.positions[rest_faces], vertices[faces])
    np.testing.assert_array_equal(tube.coordinates, rest)
    away = np.sum(tube.normals * tube.positions * np.array([1.0, 0.0, 1.0]), axis=1)
    assert away.min() > 0.15  # outward, on a tube of 0.2 m
    np.testing.assert_allclose(np.linalg.norm(tube.normals, axis=1), 1.0)


def test_garments_are_named_from_the_top_down():
    """As the masks of an outfit are, so that each garment finds its own (S14.1)."""
    surface = outfit()
    assert surface.components == ("garment-1", "garment-2")
    np.testing.assert_array_equal(surface.panel_components, [1, 1, 0, 0])
    assert scenes.tube().components == ("garment",)


def test_each_garment_repeats_its_own_tile():
    """S14.2: coordinates are panel coordinates over the tile's size in metres."""
    surface = outfit()
    gray = np.full((4, 4, 3), 0.5)
    tiles = [Tile(gray, (0.1, 0.2), corner=(0.03, 0.0)), Tile(gray, (0.05, 0.05))]
    texture = tile_texture(tiles, surface)
    assert texture.names == ("tile-garment-1", "tile-garment-2") and texture.repeat
    np.testing.assert_array_equal(texture.panel_images, [1, 1, 0, 0])
    upper = surface.vertex_panels >= 2
    expected = (surface.coordinates - np.array([0.03, 0.0])) / np.array([0.1, 0.2])
    np.testing.assert_allclose(texture.coordinates[upper], expected[upper])
    np.testing.assert_allclose(texture.coordinates[~upper], surface.coordinates[~upper] / 0.05)


def test_arrays_that_do_not_agree_are_refused():
    vertices, faces, rest, rest_faces, panels, face_panels = scenes.tube_arrays()
    with pytest.raises(ValueError, match="rest faces"):
        make_panel_surface(vertices, faces[1:], rest, rest_faces, panels, face_panels)
