"""Panel outlines as polylines on the host."""

import math

import numpy as np
from jaxtyping import Float, Int

from dress_jax.geometry.curves import curve_point, elevate, from_chord_frame, turning_angle
from dress_jax.geometry.polygons import self_crossings, signed_area
from dress_jax.pattern.model import Edge, EdgeKind, Panel

_FINE_TURN = math.radians(4.0)  # turning per chord of a fine outline
_FINE_MIN = 6


def cubic_controls(edge: Edge) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """The control points of an edge as `geometry.curves` takes them: cubic, or an arc's apex."""
    if edge.kind == EdgeKind.LINE:
        return elevate(np.array([0.5, 0.0]), xp=np)
    if edge.kind == EdgeKind.QUADRATIC:
        return elevate(edge.controls[0], xp=np)
    return edge.controls[0], edge.controls[-1]


def edge_points(
    panel: Panel, edge: Edge, parameters: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n 2"]:
    """Points of one edge at given curve parameters [m], shape (n, 2)."""
    first, second = cubic_controls(edge)
    shape = (len(parameters), 2)
    local = curve_point(
        np.full(len(parameters), edge.kind == EdgeKind.ARC),
        np.broadcast_to(first, shape),
        np.broadcast_to(second, shape),
        parameters,
        xp=np,
    )
    start, end = panel.vertices[edge.start], panel.vertices[edge.end]
    return from_chord_frame(start[None], end[None], local, xp=np)


def fine_count(edge: Edge) -> int:
    """Chords that follow an edge closely: one for a line, else at most 4 degrees of turning."""
    if edge.kind == EdgeKind.LINE:
        return 1
    first, second = cubic_controls(edge)
    turning = turning_angle(edge.kind == EdgeKind.ARC, first, second)
    return max(_FINE_MIN, math.ceil(turning / _FINE_TURN))


def fine_outline(panel: Panel) -> tuple[Float[np.ndarray, "n 2"], Int[np.ndarray, "n"]]:
    """A panel's outline as a dense polyline.

    Returns:
        Points [m], shape (n, 2), and the edge whose segment starts at each point, shape (n,).
    """
    points, owners = [], []
    for i, edge in enumerate(panel.edges):
        count = fine_count(edge)
        points.append(edge_points(panel, edge, np.arange(count) / count))
        owners.append(np.full(count, i))
    return np.concatenate(points), np.concatenate(owners)


def crossing_edges(
    points: Float[np.ndarray, "n 2"], owners: Int[np.ndarray, "n"]
) -> tuple[tuple[int, int], np.ndarray] | None:
    """The first pair of edges of an outline that cross, and a point of the crossing [m]."""
    pairs = self_crossings(points)
    if len(pairs) == 0:
        return None
    i, j = pairs[0]
    return (int(owners[i]), int(owners[j])), points[j]


def orientation(panel: Panel) -> int:
    """+1 for a counter-clockwise loop, -1 for a clockwise one."""
    return 1 if signed_area(fine_outline(panel)[0]) > 0.0 else -1
