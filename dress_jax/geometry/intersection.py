"""Exact intersection tests and distances for reports, on the host and apart from the solver.

Whether a segment meets a triangle is decided by signs of 3x3 determinants. Each sign is computed in
double precision with a proven bound on its rounding error (Shewchuk: "Adaptive Precision
Floating-Point Arithmetic and Fast Robust Geometric Predicates", 1997); pairs with an uncertain sign
are decided in rational arithmetic. Touching and overlapping in a plane count as intersecting.

Close pairs come from a uniform grid, independently of the broad phase that the solver uses.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from jaxtyping import Float, Int

from dress_jax.core.errors import InputError
from dress_jax.core.native import compiled
from dress_jax.geometry.grid import box_pairs
from dress_jax.geometry.host_distance import edge_edge, point_triangle
from dress_jax.geometry.topology import unique_edges

# Shewchuk's bound for orient3d is (7 + 56 u) u times the sum of absolute products, u = 2^-53. The
# extra covers the rounding of that sum itself and a different order of operations; the constant
# covers underflow of products.
_ORIENT_BOUND = 16.0 * 2.0**-53
_UNDERFLOW = 1e-290

_APART, _MEETS, _UNCERTAIN = 0, 1, 2


@dataclass(frozen=True)
class IntersectionCounts:
    """Numbers of intersecting edge-face pairs: `self` within the cloth, `body` with the body."""

    self: int
    body: int


def edge_face_intersections(
    positions: Float[np.ndarray, "n 3"],
    edges: Int[np.ndarray, "e 2"],
    faces: Int[np.ndarray, "f 3"],
    *,
    weld_ids: Int[np.ndarray, "n"] | None = None,
) -> Int[np.ndarray, "k 2"]:
    """All pairs of an edge and a face that have a point in common, decided exactly.

    Args:
        positions: vertices [m], shape (n, 3).
        edges: shape (e, 2).
        faces: shape (f, 3).
        weld_ids: one id per vertex; pairs that share an id (default: a vertex) are left out.

    Returns:
        Rows [edge, face], sorted, shape (k, 2).

    Raises:
        InputError: positions that are not finite, or of the wrong shape.
    """
    positions, edges, faces, weld_ids = _checked(positions, edges, faces, weld_ids)
    pairs = box_pairs(positions, edges, faces, 0.0)
    shared = (
        weld_ids[edges[pairs[:, 0]]][:, :, None] == weld_ids[faces[pairs[:, 1]]][:, None]
    ).any(axis=(1, 2))
    pairs = pairs[~shared]
    verdict = np.empty(len(pairs), np.int8)
    _filter(positions, edges, faces, pairs, verdict)
    for row in np.flatnonzero(verdict == _UNCERTAIN):
        edge, face = pairs[row]
        verdict[row] = _meets_exactly(positions[edges[edge]], positions[faces[face]])
    return pairs[verdict == _MEETS]


def count_intersections(
    cloth_positions: Float[np.ndarray, "n 3"],
    cloth_faces: Int[np.ndarray, "f 3"],
    body_positions: Float[np.ndarray, "m 3"] | None = None,
    body_faces: Int[np.ndarray, "g 3"] | None = None,
    *,
    weld_ids: Int[np.ndarray, "n"] | None = None,
) -> IntersectionCounts:
    """Intersecting edge-face pairs of the cloth with itself and (both ways) with the body.

    Args:
        cloth_positions: vertices [m], shape (n, 3).
        cloth_faces: shape (f, 3).
        body_positions: vertices [m], shape (m, 3).
        body_faces: shape (g, 3).
        weld_ids: ids of the cloth vertices; pairs within the cloth that share an id are left out.
    """
    cloth_edges = unique_edges(cloth_faces)
    within = edge_face_intersections(cloth_positions, cloth_edges, cloth_faces, weld_ids=weld_ids)
    if body_positions is None or body_faces is None:
        return IntersectionCounts(len(within), 0)
    n = len(cloth_positions)
    positions = np.concatenate([cloth_positions, body_positions])
    faces = np.asarray(body_faces) + n
    with_body = [
        edge_face_intersections(positions, cloth_edges, faces),
        edge_face_intersections(positions, unique_edges(faces), cloth_faces),
    ]
    return IntersectionCounts(len(within), sum(map(len, with_body)))


def minimum_distance(
    cloth_positions: Float[np.ndarray, "n 3"],
    cloth_faces: Int[np.ndarray, "f 3"],
    body_positions: Float[np.ndarray, "m 3"] | None = None,
    body_faces: Int[np.ndarray, "g 3"] | None = None,
    *,
    reach: float = 0.01,
    weld_ids: Int[np.ndarray, "n"] | None = None,
) -> float:
    """The smallest distance [m] of all vertex-face and edge-edge pairs that share no vertex.

    Pairs within the cloth and between cloth and body count. The search starts with pairs closer
    than `reach` and doubles it until it finds one.

    Args:
        cloth_positions: vertices [m], shape (n, 3).
        cloth_faces: shape (f, 3).
        body_positions: vertices [m], shape (m, 3).
        body_faces: shape (g, 3).
        reach: first search distance [m].
        weld_ids: ids of the cloth vertices; pairs that share an id are left out.

    Returns:
        The distance, or infinity where there is no pair at all. Zero for touching pairs, but an
        edge that passes through a face need not touch: count intersections separately.
    """
    n = len(cloth_positions)
    ids = np.arange(n) if weld_ids is None else np.asarray(weld_ids)
    positions, faces = np.asarray(cloth_positions, np.float64), np.asarray(cloth_faces)
    groups = [(np.unique(faces)[:, None], faces, 1), (unique_edges(faces), unique_edges(faces), 2)]
    if body_positions is not None and body_faces is not None and len(body_faces):
        positions = np.concatenate([positions, body_positions])
        # Body ids must not coincide with any of the cloth's.
        ids = np.concatenate([ids, ids.max(initial=0) + 1 + np.arange(len(body_positions))])
        body = np.asarray(body_faces) + n
        groups += [
            (np.unique(faces)[:, None], body, 1),
            (np.unique(body)[:, None], faces, 1),
            (unique_edges(faces), unique_edges(body), 2),
        ]
    extent = float(np.ptp(positions, axis=0).sum()) if len(positions) else 0.0
    while True:
        best = np.inf
        for first, second, sides in groups:
            checked, first, second, ids = _checked(positions, first, second, ids)
            pairs = box_pairs(checked, first, second, min(reach, best))
            best = min(best, _smallest(checked, first, second, pairs, ids, sides == 1))
        # A pair farther apart than the reach may have been found while a closer one was not.
        if best <= reach or reach > extent:
            return float(best)
        reach *= 2.0


def _checked(positions, first, second, weld_ids):
    positions = np.ascontiguousarray(positions, np.float64)
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise InputError(f"shape {positions.shape}, expected (n, 3)", where="positions")
    if not np.isfinite(positions).all():
        raise InputError("positions that are not finite", where="positions")
    arrays = []
    for rows in (first, second):
        rows = np.ascontiguousarray(rows, np.int64)
        if rows.size and (rows.min() < 0 or rows.max() >= len(positions)):
            raise InputError(
                f"indices run from {rows.min()} to {rows.max()} but there are {len(positions)} "
                "vertices",
                where="edges or faces",
            )
        arrays.append(rows)
    ids = np.arange(len(positions)) if weld_ids is None else np.asarray(weld_ids)
    if ids.shape != (len(positions),):
        raise InputError(f"shape {ids.shape}, expected ({len(positions)},)", where="weld_ids")
    return positions, arrays[0], arrays[1], ids.astype(np.int64)


@compiled
def _orientation(x, a, b, c, d):
    """Sign of det [a - d, b - d, c - d], or 2 where rounding could change it."""
    ax, ay, az = x[a, 0] - x[d, 0], x[a, 1] - x[d, 1], x[a, 2] - x[d, 2]
    bx, by, bz = x[b, 0] - x[d, 0], x[b, 1] - x[d, 1], x[b, 2] - x[d, 2]
    cx, cy, cz = x[c, 0] - x[d, 0], x[c, 1] - x[d, 1], x[c, 2] - x[d, 2]
    value = az * (bx * cy - by * cx) + bz * (cx * ay - cy * ax) + cz * (ax * by - ay * bx)
    bound = (
        abs(az) * (abs(bx * cy) + abs(by * cx))
        + abs(bz) * (abs(cx * ay) + abs(cy * ax))
        + abs(cz) * (abs(ax * by) + abs(ay * bx))
    )
    bound = _ORIENT_BOUND * bound + _UNDERFLOW
    if value > bound:
        return 1
    if value < -bound:
        return -1
    return 2


@compiled
def _filter(x, edges, faces, pairs, verdict):
    """Decide the pairs whose signs are certain."""
    for row in range(pairs.shape[0]):
        p, q = edges[pairs[row, 0], 0], edges[pairs[row, 0], 1]
        a, b, c = faces[pairs[row, 1], 0], faces[pairs[row, 1], 1], faces[pairs[row, 1], 2]
        above, below = _orientation(x, a, b, c, p), _orientation(x, a, b, c, q)
        if above != 2 and above == below:
            verdict[row] = _APART
            continue
        # The line through the edge passes the three sides of the triangle on the same hand.
        ab, bc, ca = (
            _orientation(x, p, q, a, b),
            _orientation(x, p, q, b, c),
            _orientation(x, p, q, c, a),
        )
        if (ab == 1 or bc == 1 or ca == 1) and (ab == -1 or bc == -1 or ca == -1):
            # Opposite signs: the line misses the triangle, even if other signs are uncertain.
            verdict[row] = _APART
        elif above == 2 or below == 2 or ab == 2 or bc == 2 or ca == 2:
            verdict[row] = _UNCERTAIN
        else:
            verdict[row] = _MEETS


@compiled
def _smallest(x, first, second, pairs, ids, is_vertex_face):
    """Smallest distance of the pairs that share no id."""
    best = np.inf
    for row in range(pairs.shape[0]):
        one, two = pairs[row, 0], pairs[row, 1]
        shared = False
        for i in range(first.shape[1]):
            for j in range(second.shape[1]):
                if ids[first[one, i]] == ids[second[two, j]]:
                    shared = True
        if shared:
            continue
        if is_vertex_face:
            squared = point_triangle(
                x[first[one, 0]], x[second[two, 0]], x[second[two, 1]], x[second[two, 2]]
            )
        else:
            squared = edge_edge(
                x[first[one, 0]], x[first[one, 1]], x[second[two, 0]], x[second[two, 1]]
            )
        best = min(best, squared)
    return best**0.5


_Point = tuple[Fraction, ...]


def _meets_exactly(edge: np.ndarray, face: np.ndarray) -> bool:
    """Whether a segment and a triangle, either possibly degenerate, have a point in common."""
    p, q = (tuple(Fraction(float(x)) for x in row) for row in edge)
    a, b, c = (tuple(Fraction(float(x)) for x in row) for row in face)
    normal = _cross(_minus(b, a), _minus(c, a))
    if not any(normal):
        # A degenerate triangle is the union of its sides.
        return any(_segments_meet(p, q, *side) for side in ((a, b), (b, c), (a, c)))
    above, below = _dot(normal, _minus(p, a)), _dot(normal, _minus(q, a))
    if above * below > 0:
        return False
    if above == below:  # both zero: in the plane of the triangle
        return _inside(p, (a, b, c), normal) or any(
            _segments_meet(p, q, *side) for side in ((a, b), (b, c), (c, a))
        )
    t = above / (above - below)
    hit = tuple(x + t * (y - x) for x, y in zip(p, q, strict=True))
    return _inside(hit, (a, b, c), normal)


def _minus(a: _Point, b: _Point) -> _Point:
    return tuple(x - y for x, y in zip(a, b, strict=True))


def _dot(a: _Point, b: _Point) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def _cross(a: _Point, b: _Point) -> _Point:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def _inside(point: _Point, triangle: tuple[_Point, _Point, _Point], normal: _Point) -> bool:
    """Whether a point of the triangle's plane lies in the triangle or on its boundary."""
    return all(
        _dot(normal, _cross(_minus(triangle[k - 2], triangle[k]), _minus(point, triangle[k]))) >= 0
        for k in range(3)
    )


def _segments_meet(a: _Point, b: _Point, c: _Point, d: _Point) -> bool:
    """Whether two segments, either possibly a point, have a point in common."""
    u, v, w = _minus(b, a), _minus(d, c), _minus(c, a)
    normal = _cross(u, v)
    if any(normal):
        if _dot(normal, w):
            return False
        area = _dot(normal, normal)
        s, t = _dot(normal, _cross(w, v)), _dot(normal, _cross(w, u))
        return 0 <= s <= area and 0 <= t <= area
    # Parallel, or one is a point: they meet only where an end of one lies on the other.
    return any(
        _on_segment(point, *segment)
        for point, segment in ((a, (c, d)), (b, (c, d)), (c, (a, b)), (d, (a, b)))
    )


def _on_segment(point: _Point, a: _Point, b: _Point) -> bool:
    direction, offset = _minus(b, a), _minus(point, a)
    if not any(direction):
        return not any(offset)
    if any(_cross(direction, offset)):
        return False
    return 0 <= _dot(direction, offset) <= _dot(direction, direction)
