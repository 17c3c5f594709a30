"""Read a pattern from a `specification.json` document, with validation.

The dialects of GarmentCode, the Garment-Pattern-Generator (NeuralTailor) and networks that predict
patterns (SewFormer, AIpparel) are covered. Documents are dictionaries; files belong to `io`.
Checklist S3.1, S3.2, S3.8.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dress_jax.core.errors import InputError
from dress_jax.geometry.curves import to_chord_frame
from dress_jax.geometry.rotations import rotation_matrix
from dress_jax.pattern.model import Dialect, Edge, EdgeKind, Panel, Pattern, Side, Stitch
from dress_jax.pattern.validation import MIN_CHORD, validate

_EULER_ORDERS = ("zyx", "xyz")
# Near a half circle the apex depends on the radius like a square root, so rounding in the radius
# would move it. A radius this close (relative) to half the chord means the half circle itself; the
# arc moves by less than 1e-5 of its chord, or 1e-3 where the radius was too small to reach.
_HALF_CIRCLE_ABOVE = 1e-10
_HALF_CIRCLE_BELOW = 1e-6


def parse_specification(
    document: Mapping[str, Any], *, source: str = "", euler: str = "zyx"
) -> Pattern:
    """Build a pattern from a specification document.

    Args:
        document: the parsed JSON document.
        source: name of the document for error messages.
        euler: how its rotation angles compose: "zyx" (Rz Ry Rx, what box meshes and datasets mean)
            or "xyz" (Rx Ry Rz).

    Returns:
        The pattern in metres, validated.

    Raises:
        InputError: broken structure, missing keys, wrong types, non-finite numbers, unknown units
            or curve types, open or self-crossing outlines, zero-length edges, stitches that name
            absent or already used edges. The message names source, panel, edge and the mend.
    """
    if euler not in _EULER_ORDERS:
        raise InputError(
            f"the Euler order {euler!r} is unknown", where=source, mend='use "zyx" or "xyz"'
        )
    document = _mapping(document, source or "document")
    body = _mapping(_key(document, "pattern", source), _join(source, "pattern"))
    panels = _mapping(_key(body, "panels", _join(source, "pattern")), _join(source, "panels"))
    if not panels:
        raise InputError("there are no panels", where=_join(source, "pattern"))
    dialect = _parse_dialect(document, panels, source, euler)
    stitches = _sequence(body.get("stitches", []), _join(source, "stitches"))
    extras = dict(document)
    extras["pattern"] = {key: body[key] for key in body if key not in ("panels", "stitches")}
    pattern = Pattern(
        panels=tuple(_parse_panel(name, panels[name], dialect, source) for name in panels),
        stitches=tuple(
            _parse_stitch(item, _join(source, f"stitch {i}")) for i, item in enumerate(stitches)
        ),
        source=source,
        dialect=dialect,
        extras=extras,
    )
    validate(pattern)
    return pattern


def _parse_dialect(
    document: Mapping[str, Any], panels: Mapping[str, Any], source: str, euler: str
) -> Dialect:
    where = _join(source, "properties")
    properties = _mapping(_key(document, "properties", source), where)
    units = _key(properties, "units_in_meter", where)
    if not _is_number(units) or not math.isfinite(units) or units <= 0:
        raise InputError(
            f"units_in_meter is {units!r}, not a positive number",
            where=where,
            mend="write how many file units make one metre (100 for centimetres)",
        )
    edges = [
        edge
        for panel in panels.values()
        if isinstance(panel, Mapping) and isinstance(panel.get("edges"), Sequence)
        for edge in panel["edges"]
        if isinstance(edge, Mapping) and "curvature" in edge
    ]
    coordinates = properties.get("curvature_coords", None if edges else "relative")
    if coordinates not in ("relative", "absolute"):
        raise InputError(
            f"curvature_coords is {coordinates!r}",
            where=where,
            mend='write "relative" or "absolute"',
        )
    return Dialect(
        units_in_meter=float(units),
        absolute_curvature=coordinates == "absolute",
        bare_curvature=any(not isinstance(edge["curvature"], Mapping) for edge in edges),
        euler=euler,
        centred_translation=bool(properties.get("normalize_panel_translation", False)),
    )


def _parse_panel(name: str, raw: Any, dialect: Dialect, source: str) -> Panel:
    where = _join(source, f"panel {name!r}")
    raw = _mapping(raw, where)
    units = dialect.units_in_meter
    vertices = _numbers(_key(raw, "vertices", where), (-1, 2), _join(where, "vertices")) / units
    angles = _numbers(_key(raw, "rotation", where), (3,), _join(where, "rotation"))
    shift = _numbers(_key(raw, "translation", where), (3,), _join(where, "translation")) / units
    rotation = rotation_matrix(angles, order=dialect.euler)
    if dialect.centred_translation:
        shift = shift + centring_offset(vertices, rotation)
    raw_edges = _sequence(_key(raw, "edges", where), _join(where, "edges"))
    edges = tuple(
        _parse_edge(item, vertices, dialect, _join(where, f"edge {i}"))
        for i, item in enumerate(raw_edges)
    )
    known = ("vertices", "edges", "rotation", "translation", "label")
    return Panel(
        name=str(name),
        vertices=vertices,
        edges=edges,
        rotation=rotation,
        translation=shift,
        label=_text(raw.get("label", ""), _join(where, "label")),
        extras={key: raw[key] for key in raw if key not in known},
    )


def centring_offset(vertices: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """What to add to a translation that refers to the mean m of the vertices: m - R m, shape (3,).

    Such files place a vertex v at R (v - m) + m + translation.
    """
    mean = np.append(vertices.mean(axis=0), 0.0)
    return mean - rotation @ mean


def _parse_edge(raw: Any, vertices: np.ndarray, dialect: Dialect, where: str) -> Edge:
    raw = _mapping(raw, where)
    ends = _sequence(_key(raw, "endpoints", where), _join(where, "endpoints"))
    if len(ends) != 2 or not all(_is_index(end, len(vertices)) for end in ends):
        raise InputError(
            f"endpoints are {list(ends)!r}",
            where=where,
            mend=f"write two vertex indices between 0 and {len(vertices) - 1}",
        )
    start, end = vertices[ends[0]], vertices[ends[1]]
    if float(np.hypot(*(end - start))) < MIN_CHORD:
        raise InputError(
            "the edge has no length",
            where=where,
            mend="remove it, or move its endpoints apart; split a closed curve into two edges",
        )
    kind, controls = EdgeKind.LINE, np.zeros((0, 2))
    if raw.get("curvature") is not None:
        kind, controls = _parse_curvature(raw["curvature"], start, end, dialect, where)
    return Edge(
        kind=kind,
        start=int(ends[0]),
        end=int(ends[1]),
        controls=controls,
        label=_text(raw.get("label", ""), _join(where, "label")),
        extras={key: raw[key] for key in raw if key not in ("endpoints", "curvature", "label")},
    )


def _parse_curvature(
    raw: Any, start: np.ndarray, end: np.ndarray, dialect: Dialect, where: str
) -> tuple[EdgeKind, np.ndarray]:
    where = _join(where, "curvature")
    if isinstance(raw, Mapping):
        name, values = _key(raw, "type", where), _key(raw, "params", where)
    else:
        name, values = "quadratic", [raw]
    if name == "circle":
        return EdgeKind.ARC, _arc_controls(values, start, end, dialect.units_in_meter, where)
    counts = {"quadratic": (EdgeKind.QUADRATIC, 1), "cubic": (EdgeKind.CUBIC, 2)}
    if name not in counts:
        raise InputError(
            f"the curve type {name!r} is unknown",
            where=where,
            mend="use quadratic, cubic or circle",
        )
    kind, count = counts[name]
    controls = _numbers(values, (count, 2), where)
    if dialect.absolute_curvature:
        controls = to_chord_frame(start, end, controls / dialect.units_in_meter)
    return kind, controls


def _arc_controls(
    values: Any, start: np.ndarray, end: np.ndarray, units: float, where: str
) -> np.ndarray:
    values = _sequence(values, where)
    if len(values) != 3:
        raise InputError("a circle has three numbers: radius, large_arc, right", where=where)
    radius = float(
        _numbers([float(v) if isinstance(v, bool) else v for v in values], (3,), where)[0]
    )
    if any(flag not in (0, 1) for flag in values[1:]):
        raise InputError("large_arc and right must be 0 or 1", where=where)
    radius, large, right = radius / units, bool(values[1]), bool(values[2])
    chord = float(np.hypot(*(end - start)))
    excess = 2.0 * radius / chord - 1.0
    if excess < -_HALF_CIRCLE_BELOW:
        raise InputError(
            f"a circle of radius {100 * radius:.6g} cm cannot join endpoints "
            f"{100 * chord:.6g} cm apart",
            where=where,
            mend=f"the radius must be at least {50 * chord:.6g} cm",
        )
    if excess < _HALF_CIRCLE_ABOVE:
        radius = 0.5 * chord
    root = math.sqrt((radius - 0.5 * chord) * (radius + 0.5 * chord))
    small = 0.25 * chord / (radius + root)
    height = 0.25 / small if large else small
    return np.array([[0.5, -height if right else height]])


def _parse_stitch(raw: Any, where: str) -> Stitch:
    raw = _sequence(raw, where)
    if len(raw) < 2:
        raise InputError("a stitch joins two edges", where=where, mend="give it two sides")
    sides = []
    for i, item in enumerate(raw[:2]):
        at = _join(where, f"side {i}")
        item = _mapping(item, at)
        edge = _key(item, "edge", at)
        if not isinstance(edge, int) or isinstance(edge, bool):
            raise InputError(f"the edge is {edge!r}, not an index", where=at)
        extras = {key: item[key] for key in item if key not in ("panel", "edge")}
        sides.append(Side(_text(_key(item, "panel", at), at), edge, extras))
    options = [item for item in raw[2:] if isinstance(item, str)]
    unknown = [item for item in options if item != "right_wrong"]
    if unknown:
        raise InputError(
            f"the option {unknown[0]!r} is unknown",
            where=where,
            mend='"right_wrong" is the only one',
        )
    return Stitch(
        sides[0],
        sides[1],
        reversed=not options,
        extras=tuple(item for item in raw[2:] if not isinstance(item, str)),
    )


def _join(*parts: str) -> str:
    return ", ".join(part for part in parts if part)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_index(value: Any, count: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < count


def _mapping(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"expected a dictionary, found {type(value).__name__}", where=where)
    return value


def _sequence(value: Any, where: str) -> Sequence[Any]:
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise InputError(f"expected a list, found {type(value).__name__}", where=where)
    return value


def _text(value: Any, where: str) -> str:
    if not isinstance(value, str):
        raise InputError(f"expected text, found {type(value).__name__}", where=where)
    return value


def _key(mapping: Mapping[str, Any], key: str, where: str) -> Any:
    if key not in mapping:
        raise InputError(f"the key {key!r} is missing", where=where)
    return mapping[key]


def _numbers(value: Any, shape: tuple[int, ...], where: str) -> np.ndarray:
    """A float array of one or two axes (-1: any length), finite throughout."""
    described = " x ".join("n" if size < 0 else str(size) for size in shape)
    items = list(_sequence(value, where))
    rows = [list(_sequence(item, where)) for item in items] if len(shape) == 2 else [items]
    fits = all(len(row) == shape[-1] for row in rows)
    fits = fits and (len(shape) == 1 or shape[0] in (-1, len(rows)))
    if not fits or not all(_is_number(number) for row in rows for number in row):
        raise InputError(f"expected {described} numbers", where=where)
    array = np.array(rows, dtype=float).reshape(shape)
    if not np.isfinite(array).all():
        raise InputError("a number is not finite", where=where, mend="replace NaN or infinity")
    return array
