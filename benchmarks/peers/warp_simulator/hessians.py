# ruff: noqa: UP018, RUF046, SIM109 (Warp reads the source: int(0) is a variable, 0 a constant)
"""Hessians of elements in closed form, as triplets of 3x3 blocks of an upper triangle.

With `exact` zero they are positive semidefinite: the membrane's clamped, Gauss-Newton for bending,
the second derivative along the distance for contact.
"""

import warp as wp

from benchmarks.peers.warp_simulator.distance import (
    AB,
    AC,
    BOTH,
    FACE,
    FIRST,
    FIXED,
    SECOND,
    d,
    difference,
    slide,
    v3,
    v4,
)
from benchmarks.peers.warp_simulator.energies import (
    deformation,
    hinge_angle,
    mollifier,
    pair_area,
)

wp.set_module_options({"enable_backward": False})

m2 = wp.mat22d
m3 = wp.mat33d
_EPSILON = wp.constant(wp.float64(1e-3))  # squared sine of nearly parallel edges


@wp.func
def _eye() -> m3:
    return wp.identity(n=3, dtype=d)


@wp.func
def _put(
    rows: wp.array(dtype=int),
    columns: wp.array(dtype=int),
    values: wp.array(dtype=m3),
    place: int,
    i: int,
    j: int,
    block: m3,
    vertex_count: int,
):
    """A block at (i, j), transposed into the upper triangle; nothing where the body takes part."""
    if i >= vertex_count or j >= vertex_count:
        rows[place] = 0
        columns[place] = 0
        values[place] = m3()
    elif i <= j:
        rows[place] = i
        columns[place] = j
        values[place] = block
    else:
        rows[place] = j
        columns[place] = i
        values[place] = wp.transpose(block)


@wp.func
def _clamped(w: m2) -> m2:
    """A symmetric matrix with its eigenvalues clamped at 2."""
    mean = d(0.5) * (w[0, 0] + w[1, 1])
    half = d(0.5) * (w[0, 0] - w[1, 1])
    radius = wp.sqrt(half * half + w[0, 1] * w[0, 1])
    high = wp.min(mean + radius, d(2.0))
    low = wp.min(mean - radius, d(2.0))
    slope = d(0.0)
    if radius > d(1e-14) * wp.abs(mean):
        slope = (high - low) / (d(2.0) * radius)
    middle = d(0.5) * (high + low)
    return m2(middle + slope * half, slope * w[0, 1], slope * w[0, 1], middle - slope * half)


@wp.func
def _shape(inverse: m2, corner: int) -> wp.vec2d:
    if corner == 0:
        return wp.vec2d(-inverse[0, 0] - inverse[1, 0], -inverse[0, 1] - inverse[1, 1])
    return wp.vec2d(inverse[corner - 1, 0], inverse[corner - 1, 1])


@wp.kernel
def membrane_blocks(
    x: wp.array(dtype=v3),
    faces: wp.array(dtype=wp.vec3i),
    inverse: wp.array(dtype=m2),
    areas: wp.array(dtype=d),
    stiffness: wp.array(dtype=d),
    exact: int,
    offset: int,
    rows: wp.array(dtype=int),
    columns: wp.array(dtype=int),
    values: wp.array(dtype=m3),
):
    """2 I - (4 / tr S) t t^T - 2 (n n^T) x S^-1 in the space of F."""
    i = wp.tid()
    face = faces[i]
    x0 = x[face[0]]
    x1 = x[face[1]]
    x2 = x[face[2]]
    f1 = deformation(x0, x1, x2, inverse[i], 0)
    f2 = deformation(x0, x1, x2, inverse[i], 1)
    normal = wp.cross(f1, f2)
    ratio = wp.length(normal)
    normal = normal / ratio
    aa = wp.dot(f1, f1)
    bb = wp.dot(f2, f2)
    ab = wp.dot(f1, f2)
    trace = wp.sqrt(aa + bb + d(2.0) * ratio)
    s_inverse = m2(bb + ratio, -ab, -ab, aa + ratio) / (trace * ratio)
    r1 = s_inverse[0, 0] * f1 + s_inverse[1, 0] * f2
    r2 = s_inverse[0, 1] * f1 + s_inverse[1, 1] * f2
    twist = d(4.0) / trace
    across = d(2.0) * s_inverse
    if exact == 0:
        twist = wp.min(twist, d(2.0))
        across = _clamped(across)
    scale = stiffness[0] * areas[i]
    place = offset + 6 * i
    for p in range(3):
        gp = _shape(inverse[i], p)
        turn_p = gp[1] * r1 - gp[0] * r2
        for q in range(p, 3):
            gq = _shape(inverse[i], q)
            turn_q = gq[1] * r1 - gq[0] * r2
            block = d(2.0) * wp.dot(gp, gq) * _eye()
            block -= d(0.5) * twist * wp.outer(turn_p, turn_q)
            block -= wp.dot(gp, across * gq) * wp.outer(normal, normal)
            _put(rows, columns, values, place, face[p], face[q], scale * block, x.shape[0])
            place += 1


@wp.func
def _opposite_slope(normal: v3, length: d, d_normal: m3, d_length: v3) -> m3:
    """Derivative of -e n / |n|^2."""
    squared = wp.dot(normal, normal)
    inside = (_eye() - d(2.0) * wp.outer(normal, normal) / squared) / squared
    return -length * (inside * d_normal) - wp.outer(normal / squared, d_length)


@wp.kernel
def bending_blocks(
    x: wp.array(dtype=v3),
    hinges: wp.array(dtype=wp.vec4i),
    weights: wp.array(dtype=d),
    stiffness: wp.array(dtype=d),
    exact: int,
    offset: int,
    rows: wp.array(dtype=int),
    columns: wp.array(dtype=int),
    values: wp.array(dtype=m3),
):
    """k w (grad theta grad theta^T + theta hess theta); the last only where exact."""
    i = wp.tid()
    h = hinges[i]
    x0 = x[h[0]]
    edge = x[h[1]] - x0
    to2 = x[h[2]] - x0
    to3 = x[h[3]] - x0
    length = wp.length(edge)
    squared = length * length
    left = wp.cross(edge, to2)
    right = wp.cross(to3, edge)
    g2 = -(length / wp.dot(left, left)) * left
    g3 = -(length / wp.dot(right, right)) * right
    a2 = wp.dot(to2, edge) / squared
    a3 = wp.dot(to3, edge) / squared
    gradient = wp.matrix(shape=(4, 3), dtype=d)
    gradient[0] = -(d(1.0) - a2) * g2 - (d(1.0) - a3) * g3
    gradient[1] = -a2 * g2 - a3 * g3
    gradient[2] = g2
    gradient[3] = g3
    scale = stiffness[0] * weights[i]
    curved = scale * hinge_angle(x0, x[h[1]], x[h[2]], x[h[3]])
    e = wp.skew(edge)
    t2 = wp.skew(to2)
    t3 = wp.skew(to3)
    unit = edge / length
    along2 = (to2 - d(2.0) * a2 * edge) / squared
    along3 = (to3 - d(2.0) * a3 * edge) / squared
    shift = edge / squared
    place = offset + 10 * i
    for q in range(4):
        j2 = m3()
        j3 = m3()
        j0 = m3()
        j1 = m3()
        if exact == 1:
            d_left = m3()
            d_right = m3()
            d_length = v3()
            d2 = v3()
            d3 = v3()
            if q == 0:
                d_left = t2 - e
                d_right = e - t3
                d_length = -unit
                d2 = -along2 - shift
                d3 = -along3 - shift
            if q == 1:
                d_left = -t2
                d_right = t3
                d_length = unit
                d2 = along2
                d3 = along3
            if q == 2:
                d_left = e
                d2 = shift
            if q == 3:
                d_right = -e
                d3 = shift
            j2 = _opposite_slope(left, length, d_left, d_length)
            j3 = _opposite_slope(right, length, d_right, d_length)
            j1 = -wp.outer(g2, d2) - a2 * j2 - wp.outer(g3, d3) - a3 * j3
            j0 = -j2 - j3 - j1
        for p in range(q + 1):
            block = scale * wp.outer(gradient[p], gradient[q])
            if p == 0:
                block += curved * j0
            if p == 1:
                block += curved * j1
            if p == 2:
                block += curved * j2
            if p == 3:
                block += curved * j3
            _put(rows, columns, values, place, h[p], h[q], block, x.shape[0])
            place += 1


@wp.kernel
def vertex_blocks(
    areas: wp.array(dtype=d),
    density: wp.array(dtype=d),
    pins: wp.array(dtype=d),
    inverse_step: d,
    offset: int,
    rows: wp.array(dtype=int),
    columns: wp.array(dtype=int),
    values: wp.array(dtype=m3),
):
    """Inertia and pins."""
    i = wp.tid()
    rows[offset + i] = i
    columns[offset + i] = i
    value = density[0] * areas[i] * inverse_step * inverse_step + pins[i]
    values[offset + i] = value * _eye()


@wp.func
def _row(freedom: int, index: int) -> int:
    """The row of `slide` that a freedom has first or second."""
    if freedom == FACE:
        return wp.where(index == 0, AB, AC)
    if freedom == BOTH:
        return wp.where(index == 0, FIRST, SECOND)
    return freedom


@wp.func
def _sign(vertex: int, second: int) -> d:
    """How an edge's vector changes with a vertex of the pair."""
    if second == 1:
        return wp.where(vertex == 3, d(1.0), wp.where(vertex == 2, d(-1.0), d(0.0)))
    return wp.where(vertex == 1, d(1.0), wp.where(vertex == 0, d(-1.0), d(0.0)))


@wp.kernel
def contact_blocks(
    x: wp.array(dtype=v3),
    pairs: wp.array(dtype=wp.vec4i),
    is_edge: wp.array(dtype=int),
    closest: wp.array(dtype=v4),
    freedom: wp.array(dtype=int),
    areas: wp.array(dtype=d),
    scale: d,
    dhat: d,
    thickness: d,
    vertex_count: int,
    exact: int,
    offset: int,
    rows: wp.array(dtype=int),
    columns: wp.array(dtype=int),
    values: wp.array(dtype=m3),
):
    """Of scale w m b(D): along the distance, or exact with sliding and mollifier."""
    i = wp.tid()
    pair = pairs[i]
    w = closest[i]
    x0 = x[pair[0]]
    x1 = x[pair[1]]
    x2 = x[pair[2]]
    x3 = x[pair[3]]
    r = difference(w, x0, x1, x2, x3)
    squared = wp.dot(r, r)
    reach = dhat * dhat + d(2.0) * dhat * thickness
    z = (squared - thickness * thickness) / reach
    log = wp.log(z)
    short = z - d(1.0)
    b0 = -short * short * log
    b1 = (d(-2.0) * short * log - short * short / z) / reach
    b2 = (d(-2.0) * log - d(4.0) * short / z + (short / z) * (short / z)) / (reach * reach)
    area = scale * pair_area(areas, pair, is_edge[i])
    m = d(1.0)
    if is_edge[i] == 1:
        m = mollifier(x0, x1, x2, x3)
    place = offset + 10 * i
    if exact == 0:
        along = area * m * wp.max(d(2.0) * b1 + d(4.0) * squared * b2, d(0.0)) / squared
        for p in range(4):
            for q in range(p, 4):
                block = along * w[p] * w[q] * wp.outer(r, r)
                _put(rows, columns, values, place, pair[p], pair[q], block, vertex_count)
                place += 1
        return

    free = freedom[i]
    count = wp.where(free == FIXED, 0, wp.where(free == FACE or free == BOTH, 2, 1))
    first = _row(free, 0)
    second = _row(free, 1)
    s0 = slide(first)
    s1 = slide(second)
    k0 = difference(s0, x0, x1, x2, x3)
    k1 = difference(s1, x0, x1, x2, x3)
    i00 = d(0.0)
    i01 = d(0.0)
    i11 = d(0.0)
    if count == 1:
        i00 = d(0.5) / wp.dot(k0, k0)
    if count == 2:
        h00 = d(2.0) * wp.dot(k0, k0)
        h01 = d(2.0) * wp.dot(k0, k1)
        h11 = d(2.0) * wp.dot(k1, k1)
        determinant = h00 * h11 - h01 * h01
        i00 = h11 / determinant
        i01 = -h01 / determinant
        i11 = h00 / determinant

    # Mollifier: ratio = (1 - cos^2) / epsilon, m = (2 - ratio) ratio.
    u = x1 - x0
    v = x3 - x2
    lu = wp.length(u)
    lv = wp.length(v)
    uh = u / lu
    vh = v / lv
    cos = wp.dot(uh, vh)
    faded = int(0)
    ratio = (d(1.0) - cos * cos) / _EPSILON
    if is_edge[i] == 1 and ratio < d(1.0):
        faded = 1
    cu = (vh - cos * uh) / lu
    cv = (uh - cos * vh) / lv
    slope = (d(2.0) - d(2.0) * ratio) * d(-2.0) * cos / _EPSILON  # dm = slope dcos
    # d2m = bend dcos dcos^T + slope d2cos
    bend = (d(2.0) - d(2.0) * ratio) * d(-2.0) / _EPSILON
    bend -= d(2.0) * (d(2.0) * cos / _EPSILON) * (d(2.0) * cos / _EPSILON)
    huu = (d(3.0) * cos * wp.outer(uh, uh) - wp.outer(vh, uh) - wp.outer(uh, vh) - cos * _eye()) / (
        lu * lu
    )
    hvv = (d(3.0) * cos * wp.outer(vh, vh) - wp.outer(vh, uh) - wp.outer(uh, vh) - cos * _eye()) / (
        lv * lv
    )
    huv = (_eye() - wp.outer(vh, vh) - wp.outer(uh, uh - cos * vh)) / (lu * lv)

    for p in range(4):
        cp0 = d(2.0) * (w[p] * k0 + s0[p] * r)
        cp1 = d(2.0) * (w[p] * k1 + s1[p] * r)
        dp = d(2.0) * w[p] * r
        mp = _sign(p, 0) * cu + _sign(p, 1) * cv
        for q in range(p, 4):
            cq0 = d(2.0) * (w[q] * k0 + s0[q] * r)
            cq1 = d(2.0) * (w[q] * k1 + s1[q] * r)
            dq = d(2.0) * w[q] * r
            block = d(2.0) * w[p] * w[q] * _eye()
            block -= i00 * wp.outer(cp0, cq0) + i11 * wp.outer(cp1, cq1)
            block -= i01 * (wp.outer(cp0, cq1) + wp.outer(cp1, cq0))
            block = m * (b2 * wp.outer(dp, dq) + b1 * block)
            if faded == 1:
                mq = _sign(q, 0) * cu + _sign(q, 1) * cv
                block += slope * b1 * (wp.outer(dp, mq) + wp.outer(mp, dq))
                curve = _sign(p, 0) * _sign(q, 0) * huu + _sign(p, 1) * _sign(q, 1) * hvv
                curve += _sign(p, 0) * _sign(q, 1) * huv
                curve += _sign(p, 1) * _sign(q, 0) * wp.transpose(huv)
                block += b0 * (bend * wp.outer(mp, mq) + slope * curve)
            _put(rows, columns, values, place, pair[p], pair[q], area * block, vertex_count)
            place += 1
