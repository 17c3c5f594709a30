"""What a drape is judged by."""

import numpy as np
import pytest

from dress_jax.application.quality import TIGHT, drape_quality, tight_panels
from dress_jax.io.meshes import GarmentMesh
from dress_jax.io.results import DrapedState

WIDTHS = {"cuff": 1.5, "sleeve": 1.0}  # by which the panels are stretched


def _state() -> DrapedState:
    """Two square panels of two triangles each, one above the other, stretched in their width."""
    square = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]])
    rest = np.concatenate([square, square + np.array([0.0, 0.2])])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    stretch = np.repeat(list(WIDTHS.values()), 4)
    x = np.stack([stretch * rest[:, 0], rest[:, 1], np.zeros(8)], axis=1)
    garment = GarmentMesh(x, faces, rest, faces, tuple(WIDTHS), np.array([0, 0, 1, 1]))
    return DrapedState(
        garment=garment,
        weld_map=np.arange(8),
        seam_vertices=np.zeros((0, 2), int),
        seam_offset=np.zeros(1, int),
        pins=np.zeros(0, int),
        pin_targets=np.zeros((0, 3)),
        body_vertices=np.zeros((0, 3)),
        body_faces=np.zeros((0, 3), int),
        settings={},
    )


def test_a_panel_that_is_stretched_as_a_whole_is_too_small():
    quality = drape_quality(_state())
    assert quality["tight_panels"] == {"cuff": pytest.approx(WIDTHS["cuff"])}
    assert quality["max_strain"] == pytest.approx(WIDTHS["cuff"] - 1.0)


def test_a_panel_that_is_stretched_in_one_place_is_not():
    stretches = np.ones((2, 10))
    stretches[0, :4] = 2.0
    assert tight_panels(stretches, np.zeros(10, int), ("sleeve", "without triangles")) == {}
    stretches[0, :6] = TIGHT + 0.1
    assert tight_panels(stretches, np.zeros(10, int), ("sleeve",)) == {"sleeve": TIGHT + 0.1}
