"""Write a pattern as a `specification.json` document in the dialect it was read from."""

import copy
from typing import Any

import numpy as np

from dress_jax.geometry.curves import from_chord_frame
from dress_jax.geometry.rotations import rotation_angles
from dress_jax.pattern.model import Dialect, Edge, EdgeKind, Panel, Pattern, Side, Stitch
from dress_jax.pattern.specification import centring_offset


def to_specification(pattern: Pattern) -> dict[str, Any]:
    """The document of a pattern: JSON types only, unknown keys as they were read.

    Args:
        pattern: the pattern; its `dialect` sets units, curvature coordinates and Euler order.

    Returns:
        A document that `parse_specification` reads back to the same pattern (1e-9 cm).
    """
    document: dict[str, Any] = copy.deepcopy(dict(pattern.extras))
    dialect = pattern.dialect
    body = document.setdefault("pattern", {})
    body["panels"] = {panel.name: _write_panel(panel, dialect) for panel in pattern.panels}
    body["stitches"] = [_write_stitch(stitch) for stitch in pattern.stitches]
    properties = document.setdefault("properties", {})
    properties["units_in_meter"] = _plain(dialect.units_in_meter)
    properties["curvature_coords"] = "absolute" if dialect.absolute_curvature else "relative"
    if dialect.centred_translation or "normalize_panel_translation" in properties:
        properties["normalize_panel_translation"] = dialect.centred_translation
    return document


def _plain(number: float) -> float | int:
    return int(number) if float(number).is_integer() else float(number)


def _write_panel(panel: Panel, dialect: Dialect) -> dict[str, Any]:
    translation = panel.translation
    if dialect.centred_translation:
        translation = translation - centring_offset(panel.vertices, panel.rotation)
    document: dict[str, Any] = {
        "translation": (translation * dialect.units_in_meter).tolist(),
        "rotation": rotation_angles(panel.rotation, order=dialect.euler).tolist(),
        "vertices": (panel.vertices * dialect.units_in_meter).tolist(),
        "edges": [_write_edge(edge, panel.vertices, dialect) for edge in panel.edges],
    }
    if panel.label:
        document["label"] = panel.label
    document.update(copy.deepcopy(dict(panel.extras)))
    return document


def _write_edge(edge: Edge, vertices: np.ndarray, dialect: Dialect) -> dict[str, Any]:
    document: dict[str, Any] = {"endpoints": [int(edge.start), int(edge.end)]}
    if edge.label:
        document["label"] = edge.label
    start, end = vertices[edge.start], vertices[edge.end]
    if edge.kind == EdgeKind.ARC:
        params = _arc_params(float(edge.controls[0, 1]), start, end, dialect.units_in_meter)
        if params is not None:
            document["curvature"] = {"type": "circle", "params": params}
    elif edge.kind != EdgeKind.LINE:
        controls = edge.controls
        if dialect.absolute_curvature:
            controls = from_chord_frame(start[None], end[None], controls, xp=np)
            controls = controls * dialect.units_in_meter
        if edge.kind == EdgeKind.QUADRATIC and dialect.bare_curvature:
            document["curvature"] = controls[0].tolist()
        else:
            name = "quadratic" if edge.kind == EdgeKind.QUADRATIC else "cubic"
            document["curvature"] = {"type": name, "params": controls.tolist()}
    document.update(copy.deepcopy(dict(edge.extras)))
    return document


def _arc_params(
    height: float, start: np.ndarray, end: np.ndarray, units: float
) -> list[float | int] | None:
    """Radius, large_arc and right of an arc; None for a flat one, which is a line."""
    if height == 0.0:
        return None
    bulge = 2.0 * abs(height)
    radius = float(np.hypot(*(end - start))) * (1.0 + bulge * bulge) / (4.0 * bulge)
    return [radius * units, int(bulge > 1.0), int(height < 0.0)]


def _write_stitch(stitch: Stitch) -> list[Any]:
    def side(item: Side) -> dict[str, Any]:
        return {"panel": item.panel, "edge": int(item.edge), **copy.deepcopy(dict(item.extras))}

    document: list[Any] = [side(stitch.first), side(stitch.second)]
    if not stitch.reversed:
        document.append("right_wrong")
    return document + copy.deepcopy(list(stitch.extras))
