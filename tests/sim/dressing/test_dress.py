"""Garments on a body: free of intersections, welded, in layers."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from dress_jax.core.errors import InputError
from dress_jax.energy.fabric import FABRICS
from dress_jax.geometry.intersection import count_intersections, minimum_distance
from dress_jax.sim.dressing import dress
from tests.sim.dressing.dressing_scenes import arranged, person, stitched, tube, tube_parts

EDGE_LENGTH = 0.06
THICKNESS = 3e-4


def put_on(pattern, body, faces):
    made, rest, _ = arranged(pattern, EDGE_LENGTH)
    return made, dress(made, rest, body, faces, fabric=FABRICS["cotton"])


def assert_free(made, dressed, body, faces) -> None:
    cloth = np.asarray(made.faces)
    counts = count_intersections(dressed.positions, cloth, body, faces)
    assert (counts.self, counts.body) == (0, 0)
    assert minimum_distance(dressed.positions, cloth, body, faces) > THICKNESS


def test_an_outfit_is_put_on_bottom_to_top_and_the_top_lies_over_the_bottom():
    body, faces = person("a")
    upper, upper_seams = tube_parts("top", 128.0, 92.0, 27.0, 25.0)
    lower, lower_seams = tube_parts("skirt", 103.0, 70.0, 27.0, 25.0)
    made, dressed = put_on(stitched({**upper, **lower}, upper_seams + lower_seams), body, faces)
    assert [fitting.panels[0] for fitting in dressed.fittings] == ["skirt_front", "top_front"]
    assert_free(made, dressed, body, faces)
    # Where the two overlap, the top is further from the body's axis.
    x = dressed.positions
    owner = np.zeros(made.vertex_count, int)
    owner[np.asarray(made.weld_map)] = np.asarray(made.panel_of_vertex)
    names = np.array(made.panel_names)[owner]
    top, skirt = (np.char.startswith(names, part) for part in ("top", "skirt"))
    overlap = skirt & (x[:, 1] > x[top, 1].min() + 0.02)
    assert overlap.sum() >= 5
    above = cKDTree(x[top]).query(x[overlap])[1]
    radius = np.hypot(x[:, 0], x[:, 2])
    assert (radius[top][above] > radius[overlap]).mean() > 0.9


@pytest.mark.slow
def test_a_wide_skirt_ends_with_the_arms_outside_of_it():
    body, faces = person("a")
    made, dressed = put_on(tube(top=105.0, bottom=90.0, half_width=20.0, flare=70.0), body, faces)
    assert dressed.fittings[0].arms_drawn_in
    assert_free(made, dressed, body, faces)
    assert len(dressed.pin_targets)


def test_a_garment_beside_the_body_is_refused_by_name():
    body, faces = person("a")
    made, rest, _ = arranged(tube(top=100.0, bottom=50.0, half_width=30.0), EDGE_LENGTH)
    with pytest.raises(InputError, match="tube_front") as error:
        dress(made, rest, body + np.array([0.3, 0.0, 0.0]), faces, fabric=FABRICS["cotton"])
    assert "body runs through" in str(error.value)
