"""What the energies take from the rest shape; the tape carries it back to the rest positions."""

import warp as wp

from benchmarks.peers.warp_simulator.distance import d

v2 = wp.vec2d


@wp.func
def _area(a: v2, b: v2, c: v2) -> d:
    u = b - a
    v = c - a
    return d(0.5) * wp.abs(u[0] * v[1] - u[1] * v[0])


@wp.kernel
def rest_triangles(
    rest: wp.array(dtype=v2),
    faces: wp.array(dtype=wp.vec3i),
    inverse: wp.array(dtype=wp.mat22d),
    areas: wp.array(dtype=d),
    vertex_areas: wp.array(dtype=d),
):
    """Inverse edge matrices, areas, and a third of them at each corner (added)."""
    i = wp.tid()
    face = faces[i]
    a = rest[face[0]]
    u = rest[face[1]] - a
    v = rest[face[2]] - a
    inverse[i] = wp.inverse(wp.mat22d(u[0], v[0], u[1], v[1]))
    area = _area(a, rest[face[1]], rest[face[2]])
    areas[i] = area
    for k in range(3):
        wp.atomic_add(vertex_areas, face[k], area / d(3.0))


@wp.kernel
def rest_hinges(
    rest: wp.array(dtype=v2), hinges: wp.array(dtype=wp.vec4i), weights: wp.array(dtype=d)
):
    """e^2 / (A1 + A2)."""
    i = wp.tid()
    h = hinges[i]
    edge = rest[h[1]] - rest[h[0]]
    areas = _area(rest[h[0]], rest[h[1]], rest[h[2]]) + _area(rest[h[0]], rest[h[1]], rest[h[3]])
    weights[i] = wp.dot(edge, edge) / areas
