"""Specification documents: conventions, round trips, and one error per kind of bad input."""

import copy
import json

import numpy as np
import pytest
from documents import SQUARE_VERTICES, curved, document, loop, panel, pillow, stitch

from dress_jax.core.errors import InputError
from dress_jax.geometry.rotations import rotation_angles, rotation_matrix
from dress_jax.pattern import EdgeKind, parse_specification, to_specification
from dress_jax.pattern.model import Panel, Pattern, line
from dress_jax.pattern.outline import edge_points
from dress_jax.pattern.validation import validate

ROUND_TRIP = 1e-11  # [m], 1e-9 cm


def points(pattern, name, edge, count=21):
    one = pattern.panel(name)
    return edge_points(one, one.edges[edge], np.linspace(0.0, 1.0, count))


def assert_same(first, second):
    for a, b in zip(first.panels, second.panels, strict=True):
        assert (a.name, a.label, a.extras) == (b.name, b.label, b.extras)
        np.testing.assert_allclose(a.vertices, b.vertices, atol=ROUND_TRIP)
        np.testing.assert_allclose(a.rotation, b.rotation, atol=ROUND_TRIP)
        np.testing.assert_allclose(a.translation, b.translation, atol=ROUND_TRIP)
        for i, (e, f) in enumerate(zip(a.edges, b.edges, strict=True)):
            assert (e.kind, e.start, e.end, e.label) == (f.kind, f.start, f.end, f.label)
            assert e.extras == f.extras
            np.testing.assert_allclose(
                points(first, a.name, i), points(second, a.name, i), atol=ROUND_TRIP
            )
    assert first.stitches == second.stitches
    assert first.extras == second.extras


@pytest.mark.parametrize("euler", ["zyx", "xyz"])
@pytest.mark.parametrize("centred", [False, True])
@pytest.mark.parametrize("absolute", [False, True])
def test_round_trip_keeps_everything(euler, centred, absolute):
    source = curved()
    source["properties"]["normalize_panel_translation"] = centred
    if absolute:
        source["properties"]["curvature_coords"] = "absolute"
        edges = source["pattern"]["panels"]["first"]["edges"]
        edges[1]["curvature"]["params"] = [[48.0, 12.0]]
        edges[2]["curvature"]["params"] = [[35.0, 34.0], [20.0, 42.0]]
    pattern = parse_specification(source, euler=euler)
    written = to_specification(pattern)
    again = parse_specification(json.loads(json.dumps(written)), euler=euler)
    assert_same(pattern, again)
    assert written["parameters"] == {"length": 3}
    assert written["pattern"]["panel_order"] == ["first", "second"]
    assert written["pattern"]["panels"]["first"]["fabric"] == {"name": "denim"}
    assert written["pattern"]["panels"]["first"]["edges"][3]["colour"] == "red"
    assert written["pattern"]["stitches"] == source["pattern"]["stitches"]


def test_parsing_does_not_change_the_document():
    source = curved()
    before = copy.deepcopy(source)
    to_specification(parse_specification(source))["parameters"]["length"] = 4
    assert source == before


def test_units_scale_lengths_and_not_relative_controls():
    source = curved()
    coarse = copy.deepcopy(source)
    coarse["properties"]["units_in_meter"] = 200
    a, b = parse_specification(source), parse_specification(coarse)
    # A circle's radius is a length too, so everything halves.
    np.testing.assert_allclose(b.panels[0].vertices, 0.5 * a.panels[0].vertices)
    np.testing.assert_allclose(b.panels[0].translation, 0.5 * a.panels[0].translation)
    for edge in range(5):
        np.testing.assert_allclose(points(b, "first", edge), 0.5 * points(a, "first", edge))


def test_bare_lists_are_quadratics_and_stay_bare():
    edges = loop(4)
    edges[0]["curvature"] = [0.5, -0.2]
    pattern = parse_specification(document({"a": panel(SQUARE_VERTICES, edges)}))
    assert pattern.panels[0].edges[0].kind == EdgeKind.QUADRATIC
    # Control = s + cx e + cy perp(e): (20, -8) cm; the curve's middle is half way to it.
    np.testing.assert_allclose(points(pattern, "a", 0, 3)[1], [0.20, -0.04])
    written = to_specification(pattern)["pattern"]["panels"]["a"]["edges"][0]["curvature"]
    np.testing.assert_allclose(written, [0.5, -0.2])


@pytest.mark.parametrize(
    ("large", "right", "middle"),
    # Chord (0,0)-(40,0), radius 25: the centre is 15 from the chord, so arcs rise 10 or 40.
    # right = 1 sweeps counter-clockwise, that is below a chord that runs to the right.
    [(0, 1, -10.0), (1, 1, -40.0), (0, 0, 10.0), (1, 0, 40.0)],
)
def test_circle_convention(large, right, middle):
    edges = loop(4)
    edges[0]["curvature"] = {"type": "circle", "params": [25.0, large, right]}
    vertices = [[0.0, 0.0], [40.0, 0.0], [140.0, 90.0], [-100.0, 90.0]]
    pattern = parse_specification(document({"a": panel(vertices, edges)}))
    arc = points(pattern, "a", 0, 101)
    np.testing.assert_allclose(arc[50], [0.20, 0.01 * middle], atol=ROUND_TRIP)
    centre = np.array([0.20, 0.15 if large != right else -0.15])
    np.testing.assert_allclose(np.hypot(*(arc - centre).T), 0.25, atol=ROUND_TRIP)
    turn = np.cross(np.c_[arc[:-1] - centre, np.zeros(100)], np.c_[arc[1:] - centre, np.zeros(100)])
    assert (np.sign(turn[:, 2]) == (1 if right else -1)).all()
    again = to_specification(pattern)["pattern"]["panels"]["a"]["edges"][0]["curvature"]["params"]
    np.testing.assert_allclose(again, [25.0, large, right])


@pytest.mark.parametrize("offset", [0.0, 1e-15, -1e-9, 1e-12, 1e-8, 1e-4])
def test_half_circles_survive_rounding(offset):
    edges = loop(4)
    edges[0]["curvature"] = {"type": "circle", "params": [20.0 * (1.0 + offset), 0, 1]}
    source = document({"a": panel(SQUARE_VERTICES, edges)})
    pattern = parse_specification(source)
    again = parse_specification(to_specification(pattern))
    assert_same(pattern, again)


def test_euler_orders():
    angles = np.array([20.0, -40.0, 65.0])
    x, y, z = np.radians(angles)
    rx = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    ry = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    rz = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    np.testing.assert_allclose(rotation_matrix(angles), rz @ ry @ rx, atol=1e-15)
    np.testing.assert_allclose(rotation_matrix(angles, order="xyz"), rx @ ry @ rz, atol=1e-15)
    default = parse_specification(curved()).panels[0].rotation
    np.testing.assert_allclose(default, rotation_matrix(np.array([10.0, -35.0, 70.0])))


@pytest.mark.parametrize("order", ["zyx", "xyz"])
def test_angles_of_a_matrix(order):
    rng = np.random.default_rng(3)
    special = [[0, 180, 0], [0, 90, 0], [30, -90, 0], [0, 0, 180], [90, 90, 90], [180, 0, 0]]
    for angles in [*rng.uniform(-180.0, 180.0, size=(50, 3)), *np.array(special, dtype=float)]:
        matrix = rotation_matrix(angles, order=order)
        again = rotation_matrix(rotation_angles(matrix, order=order), order=order)
        np.testing.assert_allclose(again, matrix, atol=1e-12)
    np.testing.assert_array_equal(
        rotation_angles(rotation_matrix(np.array([0.0, 180.0, 0.0]))), [0.0, 180.0, 0.0]
    )


def with_change(change):
    source = pillow()
    change(source)
    return source


def set_at(*path, value):
    def change(source):
        for key in path[:-1]:
            source = source[key]
        if value is KeyError:
            del source[path[-1]]
        else:
            source[path[-1]] = value

    return change


FRONT = ("pattern", "panels", "front")
EDGE = (*FRONT, "edges", 1)
STITCH = ("pattern", "stitches", 1)
BAD = {
    "no pattern": (set_at("pattern", value=KeyError), "'pattern' is missing"),
    "pattern is a list": (set_at("pattern", value=[]), "expected a dictionary"),
    "no panels": (set_at("pattern", "panels", value={}), "no panels"),
    "no properties": (set_at("properties", value=KeyError), "'properties' is missing"),
    "no units": (set_at("properties", "units_in_meter", value=KeyError), "units_in_meter"),
    "text units": (set_at("properties", "units_in_meter", value="cm"), "units_in_meter"),
    "zero units": (set_at("properties", "units_in_meter", value=0), "units_in_meter"),
    "curvature frame": (
        set_at("properties", "curvature_coords", value="polar"),
        "curvature_coords",
    ),
    "panel is null": (set_at(*FRONT, value=None), "'front'.*expected a dictionary"),
    "no vertices": (set_at(*FRONT, "vertices", value=KeyError), "'vertices' is missing"),
    "3D vertices": (set_at(*FRONT, "vertices", 0, value=[0.0, 0.0, 0.0]), "n x 2 numbers"),
    "text vertex": (set_at(*FRONT, "vertices", 0, value=["0", 0.0]), "n x 2 numbers"),
    "NaN vertex": (set_at(*FRONT, "vertices", 0, value=[float("nan"), 0.0]), "not finite"),
    "NaN control": (set_at(*EDGE, "curvature", value=[float("nan"), 0.0]), "not finite"),
    "short rotation": (set_at(*FRONT, "rotation", value=[0.0]), "rotation.*expected 3 numbers"),
    "infinite translation": (set_at(*FRONT, "translation", value=[0, 1e999, 0]), "not finite"),
    "one endpoint": (set_at(*EDGE, "endpoints", value=[1]), "edge 1.*endpoints"),
    "absent endpoint": (set_at(*EDGE, "endpoints", value=[1, 9]), "edge 1.*endpoints"),
    "real endpoint": (set_at(*EDGE, "endpoints", value=[1, 2.0]), "edge 1.*endpoints"),
    "open loop": (set_at(*EDGE, "endpoints", value=[1, 3]), "front.*edge 1.*loop is open.*40 cm"),
    "equal vertices": (set_at(*FRONT, "vertices", 2, value=[40.0, 0.0]), "edge 1.*no length"),
    "two edges": (set_at(*FRONT, "edges", value=loop(2)), "2 edges do not make"),
    "crossing": (
        set_at(*FRONT, "vertices", value=[[0, 0], [40, 30], [40, 0], [0, 30]]),
        "'front'.*edges 0 and 2 cross",
    ),
    "curve type": (
        set_at(*EDGE, "curvature", value={"type": "spline", "params": []}),
        "'spline' is unknown",
    ),
    "control count": (
        set_at(*EDGE, "curvature", value={"type": "cubic", "params": [[0.1, 0.2]]}),
        "2 x 2 numbers",
    ),
    "small circle": (
        set_at(*EDGE, "curvature", value={"type": "circle", "params": [14.0, 0, 1]}),
        "edge 1.*cannot join.*at least 15 cm",
    ),
    "circle flags": (
        set_at(*EDGE, "curvature", value={"type": "circle", "params": [20.0, 2, 1]}),
        "must be 0 or 1",
    ),
    "one-sided stitch": (set_at(*STITCH, value=[{"panel": "front", "edge": 0}]), "joins two"),
    "stitch panel": (set_at(*STITCH, 0, "panel", value="side"), "stitch 1.*no panel 'side'"),
    "stitch edge": (set_at(*STITCH, 0, "edge", value=4), "stitch 1.*no edge 4"),
    "stitch edge type": (set_at(*STITCH, 0, "edge", value=1.5), "stitch 1.*not an index"),
    "edge sewn twice": (set_at(*STITCH, 0, "edge", value=0), "stitch 1.*stitch 0 as well"),
    "edge sewn to itself": (
        set_at("pattern", "stitches", value=[stitch(("front", 0), ("front", 0))]),
        "both sides",
    ),
    "stitch option": (set_at(*STITCH, value=stitch(("front", 1), ("back", 3), "zip")), "'zip'"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_documents_name_the_fault(name):
    change, message = BAD[name]
    with pytest.raises(InputError, match=message) as caught:
        parse_specification(with_change(change), source="shirt.json")
    assert "shirt.json" in str(caught.value)


def test_unknown_euler_order():
    with pytest.raises(InputError, match="zyx"):
        parse_specification(pillow(), euler="yzx")


def test_a_curve_that_crosses_itself_is_named():
    source = pillow()
    source["pattern"]["panels"]["front"]["edges"][2]["curvature"] = {
        "type": "cubic",
        "params": [[3.0, -0.4], [-2.0, -0.4]],
    }
    with pytest.raises(InputError, match=r"'front'.*edge 2 crosses itself"):
        parse_specification(source)


def test_every_trial_pattern_survives_a_round_trip(shared_data):
    paths = sorted((shared_data / "patterns").rglob("*.json"))
    paths = [path for path in paths if "pec" in path.name or "templates" in path.parts]
    count = 0
    for path in paths[::8]:
        if path.name.startswith("template_spec"):  # JSON with comments
            continue
        pattern = parse_specification(json.loads(path.read_text()), source=path.name)
        assert_same(pattern, parse_specification(to_specification(pattern), source=path.name))
        count += 1
    assert count > 10


def test_a_panel_without_area_is_named():
    """Its corners are all but on one line, and the outline does not cross itself."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 1e-12]])
    edges = (line(0, 1), line(1, 2), line(2, 0))
    panel = Panel("front", corners, edges, np.eye(3), np.zeros(3))
    with pytest.raises(InputError, match="panel 'front': the panel has no area"):
        validate(Pattern((panel,)))
