"""Checks that every pattern passes before it is used, with errors that name the edge at fault."""

import numpy as np

from dress_jax.core.errors import InputError
from dress_jax.geometry.polygons import signed_area
from dress_jax.pattern.model import Panel, Pattern, Side
from dress_jax.pattern.outline import crossing_edges, fine_outline

_MIN_EDGES = 3
_FLAT = 1e-9  # area over the square of the longer side of the bounding box
MIN_CHORD = 1e-6  # [m]; a shorter edge has no usable chord frame


def validate(pattern: Pattern) -> None:
    """Check loops, outlines and stitches.

    Raises:
        InputError: too few edges, zero-length edges, open loops, non-finite numbers, self-crossing
            outlines, stitches that name absent edges or use an edge twice.
    """
    names = [panel.name for panel in pattern.panels]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"two panels are called {name!r}", where=pattern.source)
    for panel in pattern.panels:
        check_loop(panel, source=pattern.source)
        check_outline(panel, source=pattern.source)
    check_stitches(pattern)


def place(source: str, panel: str, edge: int | None = None) -> str:
    """Where a fault is, in words."""
    parts = [source] if source else []
    parts.append(f"panel {panel!r}")
    if edge is not None:
        parts.append(f"edge {edge}")
    return ", ".join(parts)


def check_loop(panel: Panel, *, source: str = "") -> None:
    """Check that a panel's edges form one closed loop of finite, non-zero edges."""
    count = len(panel.edges)
    if count < _MIN_EDGES:
        raise InputError(
            f"{count} edges do not make a panel",
            where=place(source, panel.name),
            mend=f"a panel needs at least {_MIN_EDGES} edges; split a long edge in two",
        )
    if not np.isfinite(panel.vertices).all():
        raise InputError("a vertex is not finite", where=place(source, panel.name))
    for i, edge in enumerate(panel.edges):
        here = place(source, panel.name, i)
        if not np.isfinite(edge.controls).all():
            raise InputError("a control point is not finite", where=here)
        chord = panel.vertices[edge.end] - panel.vertices[edge.start]
        if float(np.hypot(*chord)) < MIN_CHORD:
            raise InputError(
                "the edge has no length",
                where=here,
                mend="remove it, or move its endpoints apart; split a closed curve into two edges",
            )
        following = panel.edges[(i + 1) % count]
        if edge.end != following.start:
            gap = panel.vertices[following.start] - panel.vertices[edge.end]
            raise InputError(
                f"the loop is open: the edge ends at vertex {edge.end}, edge {(i + 1) % count} "
                f"starts at vertex {following.start}, {100 * float(np.hypot(*gap)):.3g} cm away",
                where=here,
                mend="let both use the same vertex, or add an edge between them",
            )
    starts = [edge.start for edge in panel.edges]
    for i, start in enumerate(starts):
        if starts.index(start) != i:
            raise InputError(
                f"the loop passes vertex {start} twice",
                where=place(source, panel.name, i),
                mend="split the panel into simple loops",
            )


def check_outline(panel: Panel, *, source: str = "") -> None:
    """Check that a panel's outline does not cross itself and encloses an area."""
    points, owners = fine_outline(panel)
    found = crossing_edges(points, owners)
    if found is not None:
        raise crossing_error(panel.name, *found, source=source)
    if not abs(signed_area(points)) > _FLAT * float(np.max(np.ptp(points, axis=0))) ** 2:
        raise InputError(
            "the panel has no area",
            where=place(source, panel.name),
            mend="its corners lie on one line: move one of them away from it",
        )


def crossing_error(
    panel: str, edges: tuple[int, int], point: np.ndarray, *, source: str = ""
) -> InputError:
    """The error for an outline that crosses itself."""
    i, j = edges
    which = f"edge {i} crosses itself" if i == j else f"edges {i} and {j} cross or touch"
    x, y = 100.0 * point
    return InputError(
        f"the outline crosses itself: {which} near ({x:.2f}, {y:.2f}) cm",
        where=place(source, panel),
        mend="move the vertices or flatten the curves there",
    )


def check_stitches(pattern: Pattern) -> None:
    """Check that stitches name existing edges and use no edge twice."""
    counts = {panel.name: len(panel.edges) for panel in pattern.panels}
    used: dict[tuple[str, int], int] = {}
    for number, stitch in enumerate(pattern.stitches):
        for side in (stitch.first, stitch.second):
            where = f"{pattern.source}, stitch {number}" if pattern.source else f"stitch {number}"
            _check_side(side, counts, where)
            key = (side.panel, side.edge)
            if key in used:
                other = used[key]
                twice = "both sides of it" if other == number else f"stitch {other} as well"
                raise InputError(
                    f"panel {side.panel!r}, edge {side.edge} is in {twice}",
                    where=where,
                    mend="an edge can be in one stitch only; split the edge where two seams meet",
                )
            used[key] = number


def _check_side(side: Side, counts: dict[str, int], where: str) -> None:
    if side.panel not in counts:
        raise InputError(
            f"there is no panel {side.panel!r}",
            where=where,
            mend=f"panels are {', '.join(sorted(counts))}",
        )
    if not 0 <= side.edge < counts[side.panel]:
        raise InputError(
            f"panel {side.panel!r} has no edge {side.edge}",
            where=where,
            mend=f"its edges are 0 to {counts[side.panel] - 1}",
        )
