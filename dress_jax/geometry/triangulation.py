"""Triangulate a polygon with its boundary kept exactly (checklist S5.4).

Constrained Delaunay on the boundary points and a hexagonal lattice of interior points, which are
then moved to the area-weighted centroids of their triangles a few times.
"""

from typing import Any

import numpy as np
import pythoncdt
import shapely
from jaxtyping import Float, Int

_LATTICE_MARGIN = 0.62  # interior points start this far from the boundary [edge lengths]
_MOVED_MARGIN = 0.40  # and may not be moved closer than this
_SMOOTHING_MOVES = 8
_FLAT = 1e-10  # a triangle is flat below this area [its longest edge squared]


class TriangulationError(ValueError):
    """A polygon that cannot be triangulated; `point` is where [m], shape (2,)."""

    def __init__(self, problem: str, point: np.ndarray):
        super().__init__(problem)
        self.point = point


def triangulate(
    boundary: Float[np.ndarray, "b 2"], edge_length: float
) -> tuple[Float[np.ndarray, "n 2"], Int[np.ndarray, "f 3"]]:
    """Triangulate the inside of a simple polygon.

    Args:
        boundary: corners of the outline in order, either direction [m], shape (b, 2).
        edge_length: wanted edge length inside [m].

    Returns:
        Points [m], shape (n, 2), the first b of which are the boundary's, and counter-clockwise
        triangles, shape (f, 3).

    Raises:
        TriangulationError: the outline crosses itself or a triangle has no area.
    """
    polygon = shapely.Polygon(boundary)
    interior = _lattice(polygon, edge_length)
    count = len(boundary)
    allowed = polygon.buffer(-_MOVED_MARGIN * edge_length)
    shapely.prepare(allowed)
    points = np.concatenate([boundary, interior])
    faces = constrained_delaunay(points, count)
    if len(interior):
        for _ in range(_SMOOTHING_MOVES):
            moved = _centroids(points, faces)[count:]
            inside = shapely.contains_xy(allowed, moved[:, 0], moved[:, 1])
            points[count:] = np.where(inside[:, None], moved, points[count:])
            faces = constrained_delaunay(points, count)
    _check(points, faces, count)
    return points, faces


def _lattice(polygon: shapely.Polygon, edge_length: float) -> Float[np.ndarray, "n 2"]:
    """Points of a hexagonal lattice well inside a polygon, shape (n, 2)."""
    eroded = polygon.buffer(-_LATTICE_MARGIN * edge_length)
    if eroded.is_empty:
        return np.zeros((0, 2))
    left, low, right, high = eroded.bounds
    step = edge_length * np.sqrt(0.75)
    rows = int((high - low) / step) + 1
    columns = int((right - left) / edge_length) + 2
    # Centred in the bounds, so that a mirrored panel gets a mirrored lattice.
    y = 0.5 * (low + high) + (np.arange(rows) - 0.5 * (rows - 1)) * step
    x = 0.5 * (left + right) + (np.arange(columns) - 0.5 * (columns - 1)) * edge_length
    grid_x, grid_y = np.meshgrid(x, y)
    grid_x = grid_x + np.where(np.arange(rows) % 2 == 0, 0.25, -0.25)[:, None] * edge_length
    grid_x, grid_y = grid_x.ravel(), grid_y.ravel()
    shapely.prepare(eroded)
    inside = shapely.contains_xy(eroded, grid_x, grid_y)
    return np.stack([grid_x[inside], grid_y[inside]], axis=1)


def constrained_delaunay(
    points: Float[np.ndarray, "n 2"], boundary_count: int
) -> Int[np.ndarray, "f 3"]:
    """Constrained Delaunay triangles inside the loop of the first `boundary_count` points.

    Raises:
        TriangulationError: points coincide or the loop crosses itself.
    """
    loop = np.arange(boundary_count, dtype=np.uint32)
    # The binding takes C-contiguous buffers; its type stubs do not know arrays as such.
    segments: Any = np.ascontiguousarray(np.stack([loop, np.roll(loop, -1)], axis=1))
    buffer: Any = np.ascontiguousarray(points)
    mesh = pythoncdt.Triangulation(
        pythoncdt.VertexInsertionOrder.AUTO,
        pythoncdt.IntersectingConstraintEdges.NOT_ALLOWED,
        0.0,
    )
    try:
        mesh.insert_vertices(buffer)
        mesh.insert_edges(segments)
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise TriangulationError(reason, points[:boundary_count].mean(axis=0)) from error
    mesh.erase_outer_triangles()
    return mesh.triangles_array()["vertices"].astype(np.int64)


def triangle_areas(
    points: Float[np.ndarray, "n 2"], faces: Int[np.ndarray, "f 3"]
) -> Float[np.ndarray, "f"]:
    """Signed areas, positive for counter-clockwise triangles, shape (f,)."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    ab, ac = b - a, c - a
    return 0.5 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])


def triangle_angles(
    points: Float[np.ndarray, "n d"], faces: Int[np.ndarray, "f 3"]
) -> Float[np.ndarray, "f 3"]:
    """Inner angles at the three corners [rad], shape (f, 3)."""
    angles = []
    for i in range(3):
        u = points[faces[:, (i + 1) % 3]] - points[faces[:, i]]
        v = points[faces[:, (i + 2) % 3]] - points[faces[:, i]]
        lengths = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
        angles.append(np.arccos(np.clip(np.sum(u * v, axis=1) / lengths, -1.0, 1.0)))
    return np.stack(angles, axis=1)


def _centroids(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """For each point the area-weighted mean of the centroids of its triangles."""
    areas = np.abs(triangle_areas(points, faces))
    weighted = areas[:, None] * points[faces].mean(axis=1)
    total, weight = np.zeros_like(points), np.zeros(len(points))
    for i in range(3):
        np.add.at(total, faces[:, i], weighted)
        np.add.at(weight, faces[:, i], areas)
    return total / np.where(weight > 0.0, weight, 1.0)[:, None]


def _check(points: np.ndarray, faces: np.ndarray, boundary_count: int) -> None:
    """Raise unless triangles have area and every boundary segment is an edge of one of them."""
    corners = points[faces]
    longest = np.max(np.sum((corners - np.roll(corners, -1, axis=1)) ** 2, axis=2), axis=1)
    flat = triangle_areas(points, faces) <= _FLAT * longest
    if flat.any():
        where = corners[np.argmax(flat)].mean(axis=0)
        raise TriangulationError("a triangle has no area", where)
    if not np.array_equal(np.unique(faces), np.arange(len(points))):
        missing = np.setdiff1d(np.arange(len(points)), faces)[0]
        raise TriangulationError("a point is in no triangle", points[missing])
    count = len(points)
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    keys = np.sort(directed, axis=1) @ np.array([count, 1])
    loop = np.arange(boundary_count)
    wanted = np.sort(np.stack([loop, np.roll(loop, -1)], axis=1), axis=1) @ np.array([count, 1])
    unique, uses = np.unique(keys, return_counts=True)
    if not np.array_equal(np.sort(wanted), unique[uses == 1]):
        bad = np.setxor1d(wanted, unique[uses == 1])[0]
        raise TriangulationError("the boundary is not kept", points[bad // count])
