"""Small specification documents for tests."""

import copy

SQUARE_VERTICES = [[0.0, 0.0], [40.0, 0.0], [40.0, 30.0], [0.0, 30.0]]


def loop(count):
    return [{"endpoints": [i, (i + 1) % count]} for i in range(count)]


def panel(vertices, edges=None, *, rotation=(0.0, 0.0, 0.0), translation=(0.0, 0.0, 0.0)):
    return {
        "vertices": copy.deepcopy(vertices),
        "edges": edges or loop(len(vertices)),
        "rotation": list(rotation),
        "translation": list(translation),
    }


def document(panels, stitches=(), **properties):
    return {
        "pattern": {"panels": panels, "stitches": [list(stitch) for stitch in stitches]},
        "properties": {"curvature_coords": "relative", "units_in_meter": 100, **properties},
    }


def stitch(first, second, *options):
    sides = [{"panel": name, "edge": edge} for name, edge in (first, second)]
    return [*sides, *options]


def curved():
    """One panel with every kind of edge, unknown keys everywhere and a skewed placement."""
    edges = loop(5)
    edges[0]["curvature"] = {"type": "circle", "params": [25.0, 0, 1]}
    edges[1]["curvature"] = {"type": "quadratic", "params": [[0.4, -0.2]]}
    edges[2]["curvature"] = {"type": "cubic", "params": [[0.2, -0.1], [0.7, -0.3]]}
    edges[3]["label"] = "armhole"
    edges[3]["colour"] = "red"
    first = panel(
        [[0.0, 0.0], [40.0, 0.0], [42.0, 30.0], [10.0, 35.0], [0.0, 30.0]],
        edges,
        rotation=(10.0, -35.0, 70.0),
        translation=(1.0, 90.0, 20.0),
    )
    first["label"], first["fabric"] = "body", {"name": "denim"}
    second = panel(SQUARE_VERTICES, rotation=(0.0, 180.0, 0.0), translation=(0.0, 90.0, -20.0))
    sewn = stitch(("first", 4), ("second", 1), "right_wrong")
    sewn[0]["note"] = "ease"
    result = document({"first": first, "second": second}, [sewn])
    result["parameters"] = {"length": 3}
    result["pattern"]["panel_order"] = ["first", "second"]
    return result


def pillow():
    """Two squares sewn along all four edges."""
    panels = {
        "front": panel(SQUARE_VERTICES, translation=(0.0, 0.0, 20.0)),
        "back": panel(SQUARE_VERTICES, rotation=(0.0, 180.0, 0.0), translation=(40.0, 0.0, -20.0)),
    }
    pairs = ((0, 0), (1, 3), (2, 2), (3, 1))
    return document(panels, [stitch(("front", i), ("back", j)) for i, j in pairs])
