"""Scalar squared distances for host kernels, written apart from the JAX ones.

Points are tuples or arrays of three numbers. All values are squared distances between points of the
primitives, so they are never too small by more than rounding; where a triangle is degenerate they
may be too large by a tiny fraction of its size.
"""

from dress_jax.core.native import compiled

# Squared sine below which a corner or an edge pair counts as degenerate.
_DEGENERATE = 1e-16


@compiled
def point_segment(p, a, b):
    """Squared distance of point p from segment a b."""
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    qx, qy, qz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    length = dx * dx + dy * dy + dz * dz
    t = 0.0
    if length > 0.0:
        t = min(1.0, max(0.0, (qx * dx + qy * dy + qz * dz) / length))
    rx, ry, rz = qx - t * dx, qy - t * dy, qz - t * dz
    return rx * rx + ry * ry + rz * rz


@compiled
def point_triangle(p, a, b, c):
    """Squared distance of point p from triangle a b c."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    qx, qy, qz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area = nx * nx + ny * ny + nz * nz
    scale = (ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz)
    if area > _DEGENERATE * scale:
        s = nx * (qy * vz - qz * vy) + ny * (qz * vx - qx * vz) + nz * (qx * vy - qy * vx)
        t = nx * (uy * qz - uz * qy) + ny * (uz * qx - ux * qz) + nz * (ux * qy - uy * qx)
        if s >= 0.0 and t >= 0.0 and s + t <= area:
            s /= area
            t /= area
            rx, ry, rz = qx - s * ux - t * vx, qy - s * uy - t * vy, qz - s * uz - t * vz
            return rx * rx + ry * ry + rz * rz
    return min(point_segment(p, a, b), point_segment(p, a, c), point_segment(p, b, c))


@compiled
def edge_edge(a, b, c, d):
    """Squared distance of segments a b and c d."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = d[0] - c[0], d[1] - c[1], d[2] - c[2]
    wx, wy, wz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area = nx * nx + ny * ny + nz * nz
    scale = (ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz)
    if area > _DEGENERATE * scale:
        s = nx * (wy * vz - wz * vy) + ny * (wz * vx - wx * vz) + nz * (wx * vy - wy * vx)
        t = nx * (wy * uz - wz * uy) + ny * (wz * ux - wx * uz) + nz * (wx * uy - wy * ux)
        if 0.0 <= s <= area and 0.0 <= t <= area:
            # The common perpendicular, from the plane of both directions.
            h = nx * wx + ny * wy + nz * wz
            return h * h / area
    return min(
        point_segment(a, c, d),
        point_segment(b, c, d),
        point_segment(c, a, b),
        point_segment(d, a, b),
    )
