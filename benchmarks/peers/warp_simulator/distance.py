"""Closest points of vertex-face and edge-edge pairs, as Warp functions.

The difference vector of a pair is r = sum w_i x_i. Where the closest point may slide along the
primitives, w changes by the rows of `slide`; that is all that second derivatives need.
"""

import warp as wp

d = wp.float64
v3 = wp.vec3d
v4 = wp.vec4d

# Which rows of `slide` a closest point is free to move along.
FIXED = wp.constant(0)
AB = wp.constant(1)
AC = wp.constant(2)
SECOND = wp.constant(3)
FIRST = wp.constant(4)
FACE = wp.constant(5)
BOTH = wp.constant(6)
_PARALLEL = wp.constant(wp.float64(1e-24))


@wp.struct
class Closest:
    """Weights of the four vertices, and what is free to move."""

    weights: v4
    freedom: int


@wp.func
def slide(row: int) -> v4:
    """How the weights change as the closest point moves along a primitive."""
    if row == AB:
        return v4(d(0.0), d(1.0), d(-1.0), d(0.0))
    if row == AC:
        return v4(d(0.0), d(1.0), d(0.0), d(-1.0))
    if row == SECOND:
        return v4(d(0.0), d(0.0), d(1.0), d(-1.0))
    return v4(d(-1.0), d(1.0), d(0.0), d(0.0))


@wp.func
def difference(w: v4, x0: v3, x1: v3, x2: v3, x3: v3) -> v3:
    """sum w_i x_i, from differences of near points."""
    return w[1] * (x1 - x0) + w[2] * (x2 - x0) + w[3] * (x3 - x0)


@wp.func
def vertex_face(p: v3, a: v3, b: v3, c: v3) -> Closest:
    """By the region of the face that the vertex is above."""
    result = Closest()
    ab = b - a
    ac = c - a
    ap = p - a
    d1 = wp.dot(ab, ap)
    d2 = wp.dot(ac, ap)
    if d1 <= d(0.0) and d2 <= d(0.0):
        result.weights = v4(d(1.0), d(-1.0), d(0.0), d(0.0))
        result.freedom = FIXED
        return result
    bp = p - b
    d3 = wp.dot(ab, bp)
    d4 = wp.dot(ac, bp)
    if d3 >= d(0.0) and d4 <= d3:
        result.weights = v4(d(1.0), d(0.0), d(-1.0), d(0.0))
        result.freedom = FIXED
        return result
    vc = d1 * d4 - d3 * d2
    if vc <= d(0.0) and d1 >= d(0.0) and d3 <= d(0.0):
        t = d1 / (d1 - d3)
        result.weights = v4(d(1.0), t - d(1.0), -t, d(0.0))
        result.freedom = AB
        return result
    cp = p - c
    d5 = wp.dot(ab, cp)
    d6 = wp.dot(ac, cp)
    if d6 >= d(0.0) and d5 <= d6:
        result.weights = v4(d(1.0), d(0.0), d(0.0), d(-1.0))
        result.freedom = FIXED
        return result
    vb = d5 * d2 - d1 * d6
    if vb <= d(0.0) and d2 >= d(0.0) and d6 <= d(0.0):
        t = d2 / (d2 - d6)
        result.weights = v4(d(1.0), t - d(1.0), d(0.0), -t)
        result.freedom = AC
        return result
    va = d3 * d6 - d5 * d4
    if va <= d(0.0) and d4 >= d3 and d5 >= d6:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        result.weights = v4(d(1.0), d(0.0), t - d(1.0), -t)
        result.freedom = SECOND
        return result
    normal = wp.cross(ab, ac)
    area = wp.dot(normal, normal)
    v = wp.dot(normal, wp.cross(ap, ac)) / area
    w = wp.dot(normal, wp.cross(ab, ap)) / area
    result.weights = v4(d(1.0), v + w - d(1.0), -v, -w)
    result.freedom = FACE
    return result


@wp.func
def _on_segment(q: v3, along: v3) -> d:
    """Closest parameter of the segment t along, 0 <= t <= 1, to the point q."""
    return wp.clamp(wp.dot(q, along) / wp.dot(along, along), d(0.0), d(1.0))


@wp.func
def _is_inside(t: d) -> bool:
    return t > d(0.0) and t < d(1.0)


@wp.func
def edge_edge(a0: v3, a1: v3, b0: v3, b1: v3) -> Closest:
    """The nearest of the inner closest points and the four ends."""
    result = Closest()
    u = a1 - a0
    v = b1 - b0
    w = b0 - a0
    uu = wp.dot(u, u)
    vv = wp.dot(v, v)
    normal = wp.cross(u, v)
    area = wp.dot(normal, normal)
    if area > _PARALLEL * uu * vv:
        s = wp.dot(normal, wp.cross(w, v)) / area
        t = (wp.dot(u, v) * s - wp.dot(w, v)) / vv
        if _is_inside(s) and _is_inside(t):
            result.weights = v4(d(1.0) - s, s, t - d(1.0), -t)
            result.freedom = BOTH
            return result
    best = d(1.0e300)
    for end in range(2):
        s = d(end)
        q = a0 + s * u - b0
        t = _on_segment(q, v)
        r = q - t * v
        if wp.dot(r, r) < best:
            best = wp.dot(r, r)
            result.weights = v4(d(1.0) - s, s, t - d(1.0), -t)
            result.freedom = wp.where(_is_inside(t), SECOND, FIXED)
    for end in range(2):
        t = d(end)
        q = b0 + t * v - a0
        s = _on_segment(q, u)
        r = q - s * u
        if wp.dot(r, r) < best:
            best = wp.dot(r, r)
            result.weights = v4(d(1.0) - s, s, t - d(1.0), -t)
            result.freedom = wp.where(_is_inside(s), FIRST, FIXED)
    return result
