"""Preview pictures."""

import numpy as np
import pytest
import trimesh
from render_scenes import front_camera, sphere

from dress_jax.core.errors import InputError
from dress_jax.render.shading import label_colors, palette, preview, shade


def test_preview_shows_garment_and_body_on_white():
    garment, body = sphere(0.6), sphere(0.4, (0.0, 0.7, 0.0))
    picture = preview((*garment, None), body, size=48)
    assert picture.shape == (48, 144, 3) and picture.dtype == np.uint8
    assert (picture[0, 0] == 255).all()
    middle = picture[:, 24].astype(int)
    blue = middle[:, 2] - middle[:, 0]
    assert blue[30] > 30 and abs(blue[8]) < 25
    # The three views of a rotation body agree.
    assert np.abs(picture[:, :48].astype(int) - picture[:, 96:]).mean() < 2


def test_colors_per_mesh_vertex_and_face():
    ball = trimesh.creation.icosphere(1, 0.6)
    positions, faces = np.asarray(ball.vertices), np.asarray(ball.faces)
    red = np.array([1.0, 0.0, 0.0])
    pictures = [
        shade(front_camera(32), [(positions, faces, colors)])
        for colors in (
            red,
            np.tile(red, (len(positions), 1)),
            np.tile(red, (len(faces), 1)),
        )
    ]
    for picture in pictures[1:]:
        assert np.abs(picture.astype(int) - pictures[0]).max() <= 1
    with pytest.raises(InputError, match="colours"):
        shade(front_camera(32), [(positions, faces, np.zeros((5, 3)))])
    with pytest.raises(InputError, match="no mesh"):
        shade(front_camera(32), [])


def test_palette():
    colors = palette(12)
    assert colors.min() >= 0 and colors.max() <= 1
    np.testing.assert_array_equal(palette(5), colors[:5])
    gap = np.linalg.norm(colors[:, None] - colors[None], axis=-1) + np.eye(12)
    assert gap.min() > 0.05
    np.testing.assert_array_equal(label_colors(np.array([2, 0])), colors[[2, 0]])
    with pytest.raises(InputError, match="negative"):
        label_colors(np.array([-1]))
