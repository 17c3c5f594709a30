"""Drafted patterns, wrong-measurement versions and pictures."""

import xml.etree.ElementTree as ElementTree

import jax.numpy as jnp
import numpy as np
import pytest
from documents import curved, document, panel

from dress_jax.core.errors import InputError
from dress_jax.pattern import (
    components,
    discretize,
    drawing,
    edge_lengths,
    parse_specification,
    pattern_parameters,
    placed_positions,
    rest_positions,
    scaled,
    to_specification,
)
from dress_jax.pattern.mirror import find_mirror
from dress_jax.pattern.outline import edge_points, fine_outline, orientation
from dress_jax.pattern.templates import (
    Measurements,
    outfit,
    sleeveless_dress,
    straight_skirt,
    t_shirt,
    trousers,
)
from dress_jax.pattern.validation import validate

DRAFTS = {
    "dress": sleeveless_dress,
    "skirt": straight_skirt,
    "shirt": t_shirt,
    "trousers": trousers,
}
LENGTHS = 1e-12  # [m]


@pytest.mark.parametrize("name", DRAFTS)
def test_drafts_are_one_oriented_garment_with_matching_seams(name):
    pattern = DRAFTS[name]()
    mesh = discretize(pattern, 0.03)
    assert (components(mesh) == 0).all()
    assert all(orientation(panel) == 1 for panel in pattern.panels)
    assert mesh.seam_consistent.all()
    lengths = np.asarray(edge_lengths(pattern_parameters(pattern), mesh.edges))
    first, second = lengths[mesh.stitch_edges].T
    np.testing.assert_allclose(first, second, atol=LENGTHS)
    directed = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert np.unique(directed, axis=0, return_counts=True)[1].max() == 1


@pytest.mark.parametrize("name", DRAFTS)
def test_drafts_stand_on_both_sides_of_the_body_with_parallel_seams(name):
    pattern = DRAFTS[name](gap=0.2)
    mesh = discretize(pattern, 0.03)
    world = np.asarray(placed_positions(rest_positions(pattern_parameters(pattern), mesh), mesh))
    np.testing.assert_allclose(np.abs(world[:, 2]), 0.2, atol=1e-15)
    lowest = {"trousers": 0.09}.get(name, 0.3)
    assert world[:, 1].min() > lowest and world[:, 1].max() < 1.5
    for panel_number, one in enumerate(pattern.panels):
        a, b, c = world[mesh.rest_faces[mesh.face_panel == panel_number][0]]
        normal = np.cross(b - a, c - a)
        assert normal[2] * one.translation[2] > 0.0, one.name
    # Seams between front and back join points that face each other.
    gaps = world[mesh.seam_vertices[:, 0]] - world[mesh.seam_vertices[:, 1]]
    across = np.abs(gaps[:, 2]) > 0.1
    np.testing.assert_allclose(gaps[across][:, :2], 0.0, atol=LENGTHS)
    if name == "shirt":  # caps stand 8 cm beside their armholes
        np.testing.assert_allclose(np.abs(gaps[~across][:, 0]), 0.08, atol=LENGTHS)
        np.testing.assert_allclose(gaps[~across][:, 1], 0.0, atol=LENGTHS)


def test_measurements_set_the_girths():
    pattern = sleeveless_dress(Measurements(chest=1.0, neck_width=0.2), ease=0.1)
    front = pattern.panel("front")
    np.testing.assert_allclose(4.0 * front.vertices[2, 0], 1.1)
    lowest = edge_points(front, front.edges[4], np.array([0.5]))
    np.testing.assert_allclose(lowest, [[0.0, -0.09]], atol=LENGTHS)


def test_lengths_of_drafts_are_those_that_were_asked_for():
    m = Measurements()
    shirt = t_shirt(m, length_below_hips=0.1, sleeve_length=0.4, cuff=0.2)
    lowest = min(p.translation[1] + p.vertices[:, 1].min() for p in shirt.panels)
    assert lowest == pytest.approx(m.hips_height - 0.1)
    lengths = edge_lengths(pattern_parameters(shirt), discretize(shirt, 0.05).edges)
    cuffs = [
        float(length)
        for length, edge in zip(lengths, [e for p in shirt.panels for e in p.edges], strict=True)
        if edge.label == "cuff"
    ]
    np.testing.assert_allclose(cuffs, 0.1, atol=LENGTHS)
    skirt = straight_skirt(m, flare=1.3, length_below_knee=0.2).panel("skirt_front")
    assert skirt.vertices[0, 1] == pytest.approx(m.knee_height - 0.2 - m.waist_height)
    assert skirt.vertices[1, 0] == pytest.approx(1.3 * skirt.vertices[2, 0])
    legs = trousers(m, hem_height=0.3, hem=0.4)
    for leg in legs.panels:
        assert leg.translation[1] + leg.vertices[:, 1].min() == pytest.approx(0.3)
        hems = [edge for edge in leg.edges if edge.label == "hem"]
        ends = leg.vertices[[hems[0].start, hems[0].end]]
        assert np.linalg.norm(np.diff(ends, axis=0)) == pytest.approx(0.2)
    for wrong in ({"hem_height": 0.8}, {"hem": -0.1}):
        with pytest.raises(InputError):
            trousers(m, **wrong)


def test_an_outfit_keeps_its_garments_apart():
    both = outfit(t_shirt(), trousers())
    validate(both)
    mesh = discretize(both, 0.05)
    assert len(np.unique(components(mesh))) == 2
    assert [panel.name for panel in both.panels][:2] == ["front", "back"]
    twice = outfit(t_shirt(), sleeveless_dress())
    validate(twice)
    assert "t_shirt_front" in [panel.name for panel in twice.panels]
    assert len(find_mirror(trousers()).pairs) == 2  # the front pieces, the back pieces


def test_drafts_are_written_and_read_back():
    pattern = t_shirt()
    again = parse_specification(to_specification(pattern))
    for a, b in zip(pattern.panels, again.panels, strict=True):
        np.testing.assert_allclose(a.vertices, b.vertices, atol=1e-15)
        np.testing.assert_allclose(a.rotation, b.rotation, atol=1e-15)
    assert again.stitches == pattern.stitches


def test_bad_measurements():
    with pytest.raises(InputError, match="gap"):
        sleeveless_dress(gap=-0.2)
    with pytest.raises(InputError, match="sleeve_length"):
        t_shirt(sleeve_length=float("nan"))


def test_scaling_keeps_the_top_and_the_seams():
    pattern = sleeveless_dress()
    short = scaled(pattern, {"*": (0.9, 0.8)})
    for a, b in zip(pattern.panels, short.panels, strict=True):
        before, after = fine_outline(a)[0], fine_outline(b)[0]
        np.testing.assert_allclose(after[:, 1].max(), before[:, 1].max(), atol=LENGTHS)
        np.testing.assert_allclose(np.ptp(after, axis=0), np.ptp(before, axis=0) * [0.9, 0.8])
    mesh = discretize(short, 0.03)
    lengths = np.asarray(edge_lengths(pattern_parameters(short), mesh.edges))
    np.testing.assert_allclose(*lengths[mesh.stitch_edges].T, atol=LENGTHS)
    assert short.stitches == pattern.stitches


def test_scaling_maps_every_bezier_point():
    pattern = parse_specification(curved())
    wide = scaled(pattern, {"first": (1.5, 1.0)})
    first, other = pattern.panels[0], wide.panels[0]
    low, high = fine_outline(first)[0][:, 0].min(), fine_outline(first)[0][:, 0].max()
    middle, t = 0.5 * (low + high), np.linspace(0.0, 1.0, 9)
    for edge in (1, 2, 3, 4):  # edge 0 is an arc
        expected = edge_points(first, first.edges[edge], t)
        expected[:, 0] = middle + 1.5 * (expected[:, 0] - middle)
        actual = edge_points(other, other.edges[edge], t)
        np.testing.assert_allclose(actual, expected, atol=LENGTHS)
    np.testing.assert_array_equal(wide.panels[1].vertices, pattern.panels[1].vertices)
    assert scaled(pattern, {"*": (1.0, 1.0)}).panels[0] is pattern.panels[0]


@pytest.mark.parametrize(
    ("factors", "message"),
    [({"sleeve": (1, 1)}, "sleeve"), ({"*": (0.0, 1)}, "positive"), ({"*": (1,)}, "positive")],
)
def test_bad_factors(factors, message):
    with pytest.raises(InputError, match=message):
        scaled(sleeveless_dress(), factors)


def test_a_picture_holds_every_panel_without_overlap():
    pattern = t_shirt()
    root = ElementTree.fromstring(drawing(pattern))
    space = {"svg": "http://www.w3.org/2000/svg"}
    groups = root.findall("svg:g", space)
    assert [g.find("svg:title", space).text for g in groups] == [p.name for p in pattern.panels]
    boxes = []
    for group, one in zip(groups, pattern.panels, strict=True):
        path = group.find("svg:path", space).attrib["d"].replace("M", " ").replace("L", " ")
        points = np.array(path.replace("Z", "").split(), dtype=float).reshape(-1, 2)
        boxes.append((points.min(axis=0), points.max(axis=0)))
        size = 100.0 * np.ptp(fine_outline(one)[0], axis=0)  # one unit is one centimetre
        np.testing.assert_allclose(boxes[-1][1] - boxes[-1][0], size, atol=2e-3)
    for i, (low, high) in enumerate(boxes):
        for other_low, other_high in boxes[:i]:
            assert (low > other_high).any() or (high < other_low).any()
    width, height = (float(v) for v in root.attrib["viewBox"].split()[2:])
    assert all(low.min() > 0 and high[0] < width and high[1] < height for low, high in boxes)


def test_names_are_escaped_and_labels_optional():
    pattern = parse_specification(document({"a<b>&": panel([[0, 0], [40, 0], [40, 30], [0, 30]])}))
    assert "a<b>" not in drawing(pattern)
    root = ElementTree.fromstring(drawing(pattern, labels=False))
    texts = [e.text for e in root.iter("{http://www.w3.org/2000/svg}text")]
    assert texts == ["10 cm"]


def test_rest_positions_of_a_scaled_pattern_use_the_same_mesh():
    # The wrong pattern's parameters drive the right pattern's discretization.
    pattern = sleeveless_dress()
    mesh = discretize(pattern, 0.05)
    rest = rest_positions(pattern_parameters(scaled(pattern, {"*": (1.0, 0.8)})), mesh)
    assert jnp.isfinite(rest).all()
    np.testing.assert_allclose(np.ptp(rest[:, 1]) / np.ptp(mesh.meshed_positions[:, 1]), 0.8)
