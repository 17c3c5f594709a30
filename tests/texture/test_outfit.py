"""S14.1 for an outfit: each garment gets the tile that was cut from it."""

import numpy as np
import pytest
import texture_scenes as scenes

from dress_jax.application.texture import texture_garment, texture_report
from dress_jax.io.images import Targets
from dress_jax.io.meshes import GarmentMesh
from dress_jax.io.results import DrapedState
from dress_jax.render.cameras import cameras_to_dict
from dress_jax.render.rings import ring_cameras
from dress_jax.texture.surface import make_panel_surface
from dress_jax.texture.textured import draw_textured, tile_texture
from dress_jax.texture.tiling import Tile

ACROSS, ALONG = 0.03, 0.04  # periods of the upper garment's stripes, and of the lower one's [m]
TOLERANCE = 0.03


@pytest.mark.slow  # compiles a program for a mesh of its own size
def test_each_garment_of_an_outfit_gets_its_own_tile():
    vertices, faces, rest, rest_faces, _, face_panels = scenes.tube_arrays()
    up = np.array([0.0, 0.65, 0.0])
    garment = GarmentMesh(
        np.concatenate([vertices, vertices + up]),
        np.concatenate([faces, faces + len(vertices)]),
        np.concatenate([rest, rest]),
        np.concatenate([rest_faces, rest_faces + len(rest)]),
        ("front", "back", "upper_front", "upper_back"),
        np.concatenate([face_panels, face_panels + 2]),
    )
    surface = make_panel_surface(
        garment.vertices,
        garment.faces,
        garment.rest_positions,
        garment.rest_faces,
        garment.panels,
        garment.face_panels,
    )
    body = scenes.body(height=1.6)
    body = (body[0] + 0.5 * up, body[1])
    cloth = [
        Tile(scenes.stripes((60, 60), 0.001, ACROSS, 1), (0.06, 0.06)),
        Tile(scenes.stripes((80, 80), 0.001, ALONG, 0), (0.08, 0.08)),
    ]
    cameras = ring_cameras([0.0, 180.0], size=384, center=0.5 * up, half_extent=0.8)
    texture = tile_texture(cloth, surface)
    drawn = [draw_textured(c, surface, texture, body, lit=False) for c in cameras]
    targets = Targets(
        azimuths=(0, 180),
        cameras=tuple(cameras_to_dict(cameras)["cameras"]),
        rgb=np.stack([picture for picture, _ in drawn]),
        mask=np.stack([mask for _, mask in drawn]),
    )
    state = DrapedState(
        garment=garment,
        weld_map=np.zeros(len(garment.rest_positions), np.int64),
        seam_vertices=np.zeros((0, 2), np.int64),
        seam_offset=np.zeros(1, np.int64),
        pins=np.zeros(0, np.int64),
        pin_targets=np.zeros((0, 3)),
        body_vertices=body[0],
        body_faces=body[1],
    )
    report = texture_report(texture_garment(state, targets))
    upper, lower = (report["garments"][f"garment-{k}"] for k in (1, 2))
    assert upper["square"]["panel"] == "upper_front" and lower["square"]["panel"] == "front"
    assert abs(upper["tile"]["periods"][0] / ACROSS - 1.0) < TOLERANCE
    assert abs(lower["tile"]["periods"][1] / ALONG - 1.0) < TOLERANCE
    assert upper["tile"]["periods"][1] is None and lower["tile"]["periods"][0] is None
    # Stripes come back in their places, not only at their size.
    assert max(report["error"].values()) < 0.05
