# ruff: noqa: UP018, RUF046 (Warp reads the source: int(0) is a variable, 0 a constant)
"""Broad phase by Warp's bounding volume hierarchies, active pairs, and ACCD."""

import warp as wp

from benchmarks.peers.warp_simulator.distance import (
    Closest,
    d,
    difference,
    edge_edge,
    v3,
    v4,
    vertex_face,
)

_ETA = wp.constant(wp.float64(0.1))

wp.set_module_options({"enable_backward": False})


@wp.func
def _bounds(low: v3, high: v3, margin: d, sign: d) -> wp.vec3:
    """A corner of a box in single precision, no smaller for it."""
    corner = wp.where(sign > d(0.0), high, low)
    extra = margin + d(1e-6) * (d(1.0) + wp.length(corner))
    moved = corner + sign * v3(extra, extra, extra)
    return wp.vec3(float(moved[0]), float(moved[1]), float(moved[2]))


@wp.kernel
def swept_boxes(
    x: wp.array(dtype=v3),
    motion: wp.array(dtype=v3),
    primitives: wp.array2d(dtype=int),
    margin: d,
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
):
    """Boxes around primitives during their motion."""
    i = wp.tid()
    first = primitives[i, 0]
    low = wp.min(x[first], x[first] + motion[first])
    high = wp.max(x[first], x[first] + motion[first])
    for k in range(1, primitives.shape[1]):
        j = primitives[i, k]
        low = wp.min(low, wp.min(x[j], x[j] + motion[j]))
        high = wp.max(high, wp.max(x[j], x[j] + motion[j]))
    lowers[i] = _bounds(low, high, margin, d(-1.0))
    uppers[i] = _bounds(low, high, margin, d(1.0))


@wp.kernel
def vertex_face_candidates(
    tree: wp.uint64,
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    cloth: int,
    pairs: wp.array(dtype=wp.vec4i),
    count: wp.array(dtype=int),
):
    """Vertices whose boxes meet those of faces; nothing within the body."""
    i = wp.tid()
    query = wp.bvh_query_aabb(tree, lowers[i], uppers[i])
    j = int(0)
    while wp.bvh_query_next(query, j):
        a = faces[j, 0]
        b = faces[j, 1]
        c = faces[j, 2]
        if a != i and b != i and c != i and (i < cloth or a < cloth):
            place = wp.atomic_add(count, 0, 1)
            if place < pairs.shape[0]:
                pairs[place] = wp.vec4i(i, a, b, c)


@wp.kernel
def edge_edge_candidates(
    tree: wp.uint64,
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
    edges: wp.array2d(dtype=int),
    cloth: int,
    pairs: wp.array(dtype=wp.vec4i),
    count: wp.array(dtype=int),
):
    """Edges whose boxes meet, each pair once; nothing within the body."""
    i = wp.tid()
    a0 = edges[i, 0]
    a1 = edges[i, 1]
    query = wp.bvh_query_aabb(tree, lowers[i], uppers[i])
    j = int(0)
    while wp.bvh_query_next(query, j):
        if j > i:
            b0 = edges[j, 0]
            b1 = edges[j, 1]
            apart = a0 != b0 and a0 != b1 and a1 != b0 and a1 != b1
            if apart and (a0 < cloth or b0 < cloth):
                place = wp.atomic_add(count, 0, 1)
                if place < pairs.shape[0]:
                    pairs[place] = wp.vec4i(a0, a1, b0, b1)


@wp.func
def closest_points(is_edge: int, x0: v3, x1: v3, x2: v3, x3: v3) -> Closest:
    """Of either kind of pair."""
    if is_edge == 1:
        return edge_edge(x0, x1, x2, x3)
    return vertex_face(x0, x1, x2, x3)


@wp.kernel
def active_pairs(
    x: wp.array(dtype=v3),
    pairs: wp.array(dtype=wp.vec4i),
    pair_is_edge: int,
    reach: d,
    found: wp.array(dtype=wp.vec4i),
    is_edge: wp.array(dtype=int),
    closest: wp.array(dtype=v4),
    freedom: wp.array(dtype=int),
    count: wp.array(dtype=int),
):
    """The pairs closer than the reach, with their closest points."""
    i = wp.tid()
    p = pairs[i]
    near = closest_points(pair_is_edge, x[p[0]], x[p[1]], x[p[2]], x[p[3]])
    r = difference(near.weights, x[p[0]], x[p[1]], x[p[2]], x[p[3]])
    if wp.dot(r, r) < reach * reach:
        place = wp.atomic_add(count, 0, 1)
        found[place] = p
        is_edge[place] = pair_is_edge
        closest[place] = near.weights
        freedom[place] = near.freedom


@wp.kernel
def earliest_contact(
    x: wp.array(dtype=v3),
    motion: wp.array(dtype=v3),
    pairs: wp.array(dtype=wp.vec4i),
    pair_is_edge: int,
    thickness: d,
    earliest: wp.array(dtype=d),
):
    """Additive continuous collision detection; a pair stops once it has passed the best so far."""
    i = wp.tid()
    p = pairs[i]
    m0 = motion[p[0]]
    m1 = motion[p[1]]
    m2 = motion[p[2]]
    m3 = motion[p[3]]
    mean = d(0.25) * (m0 + m1 + m2 + m3)
    m0 -= mean
    m1 -= mean
    m2 -= mean
    m3 -= mean
    rate = d(0.0)
    if pair_is_edge == 1:
        rate = wp.max(wp.length(m0), wp.length(m1)) + wp.max(wp.length(m2), wp.length(m3))
    else:
        rate = wp.length(m0) + wp.max(wp.length(m1), wp.max(wp.length(m2), wp.length(m3)))
    if rate == d(0.0):
        return
    x0 = x[p[0]]
    x1 = x[p[1]]
    x2 = x[p[2]]
    x3 = x[p[3]]
    near = closest_points(pair_is_edge, x0, x1, x2, x3)
    gap = wp.length(difference(near.weights, x0, x1, x2, x3)) - thickness
    goal = _ETA * gap
    time = d(0.0)
    following = (d(1.0) - _ETA) * gap / rate
    first = int(1)
    while following < earliest[0]:
        y0 = x0 + following * m0
        y1 = x1 + following * m1
        y2 = x2 + following * m2
        y3 = x3 + following * m3
        near = closest_points(pair_is_edge, y0, y1, y2, y3)
        gap = wp.length(difference(near.weights, y0, y1, y2, y3)) - thickness
        if gap < goal:
            # The first advance is safe by the triangle inequality, whatever rounding says.
            wp.atomic_min(earliest, 0, wp.where(first == 1, following, time))
            return
        time = following
        first = 0
        following = time + (d(1.0) - _ETA) * gap / rate
