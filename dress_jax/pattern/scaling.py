"""Versions of a pattern with other measurements, for tests and demonstrations (host)."""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from dress_jax.core.errors import InputError
from dress_jax.geometry.curves import to_chord_frame
from dress_jax.pattern.model import EdgeKind, Panel, Pattern
from dress_jax.pattern.outline import fine_outline


def scaled(pattern: Pattern, factors: Mapping[str, tuple[float, float]]) -> Pattern:
    """Stretch panels along their own x and y axes.

    A panel is scaled about the middle of its top: the centre of its outline's x range at the
    largest y. So its neckline or waist stays at its height, and length is taken off the hem.
    Curves are scaled with it; an arc in a panel whose two factors differ becomes the arc through
    its scaled ends and apex height.

    Stitches are kept as they are. Both sides of a seam keep equal lengths where both panels get
    the same factors ("*" for all), or where the factors agree along the seam.

    Args:
        pattern: the pattern.
        factors: (x factor, y factor) by panel name; "*" holds for panels without an entry.

    Raises:
        InputError: an unknown panel, or a factor that is not a positive number.
    """
    names = {panel.name for panel in pattern.panels}
    for name, pair in factors.items():
        if name != "*" and name not in names:
            raise InputError(
                f"there is no panel {name!r}",
                where=pattern.source,
                mend=f"panels are {', '.join(sorted(names))}",
            )
        if len(pair) != 2 or not all(math.isfinite(f) and f > 0.0 for f in pair):
            raise InputError(
                f"the factors of {name!r} are {pair!r}",
                where=pattern.source,
                mend="give two positive numbers",
            )
    default = factors.get("*", (1.0, 1.0))
    panels = tuple(
        _scale_panel(panel, np.array(factors.get(panel.name, default), dtype=float))
        for panel in pattern.panels
    )
    return dataclasses.replace(pattern, panels=panels)


def _scale_panel(panel: Panel, factor: np.ndarray) -> Panel:
    if np.array_equal(factor, [1.0, 1.0]):
        return panel
    outline = fine_outline(panel)[0]
    low, high = outline.min(axis=0), outline.max(axis=0)
    anchor = np.array([0.5 * (low[0] + high[0]), high[1]])
    vertices = anchor + (panel.vertices - anchor) * factor
    edges = []
    for edge in panel.edges:
        if edge.kind == EdgeKind.LINE:
            edges.append(edge)
            continue
        start, end = panel.vertices[edge.start], panel.vertices[edge.end]
        chord = end - start
        perpendicular = np.array([-chord[1], chord[0]])
        controls = start + edge.controls[:, :1] * chord + edge.controls[:, 1:] * perpendicular
        controls = anchor + (controls - anchor) * factor
        local = to_chord_frame(vertices[edge.start], vertices[edge.end], controls)
        if edge.kind == EdgeKind.ARC:
            local[:, 0] = 0.5
        edges.append(dataclasses.replace(edge, controls=local))
    return dataclasses.replace(panel, vertices=vertices, edges=tuple(edges))
