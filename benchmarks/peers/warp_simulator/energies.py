"""Energy kernels, differentiated by Warp's tape.

Contact takes the weights of the closest points as they are: by the envelope theorem the gradient
needs nothing of how they change.
"""

import warp as wp

from benchmarks.peers.warp_simulator.distance import d, difference, v3, v4

_PARALLEL_SINE_SQUARED = wp.constant(wp.float64(1e-3))


@wp.func
def deformation(x0: v3, x1: v3, x2: v3, inverse: wp.mat22d, column: int) -> v3:
    """A column of F."""
    return inverse[0, column] * (x1 - x0) + inverse[1, column] * (x2 - x0)


@wp.func
def hinge_angle(x0: v3, x1: v3, x2: v3, x3: v3) -> d:
    """Signed angle [rad] at the edge (x0, x1)."""
    edge = x1 - x0
    left = wp.cross(edge, x2 - x0)
    right = wp.cross(x3 - x0, edge)
    sine = wp.dot(wp.cross(left, right), edge) / wp.length(edge)
    return wp.atan2(sine, wp.dot(left, right))


@wp.func
def barrier(squared: d, dhat: d, thickness: d) -> d:
    """-(z - 1)^2 ln z, with z from 0 at the thickness to 1 at dhat beyond it."""
    z = (squared - thickness * thickness) / (dhat * dhat + d(2.0) * dhat * thickness)
    if z >= d(1.0):
        return d(0.0)
    return -(z - d(1.0)) * (z - d(1.0)) * wp.log(z)


@wp.func
def mollifier(x0: v3, x1: v3, x2: v3, x3: v3) -> d:
    """Fades nearly parallel edges out."""
    u = x1 - x0
    v = x3 - x2
    n = wp.cross(u, v)
    ratio = wp.dot(n, n) / (_PARALLEL_SINE_SQUARED * wp.dot(u, u) * wp.dot(v, v))
    if ratio >= d(1.0):
        return d(1.0)
    return (d(2.0) - ratio) * ratio


@wp.func
def pair_area(areas: wp.array(dtype=d), pair: wp.vec4i, is_edge: int) -> d:
    """The area that a pair stands for [m^2]."""
    if is_edge == 1:
        return d(0.125) * (areas[pair[0]] + areas[pair[1]] + areas[pair[2]] + areas[pair[3]])
    return d(0.5) * areas[pair[0]]


@wp.kernel
def vertex_energy(
    x: wp.array(dtype=v3),
    start: wp.array(dtype=v3),
    velocity: wp.array(dtype=v3),
    areas: wp.array(dtype=d),
    pins: wp.array(dtype=d),
    targets: wp.array(dtype=v3),
    density: wp.array(dtype=d),
    gravity: d,
    inverse_step: d,
    total: wp.array(dtype=d),
):
    """Inertia, weight and pins."""
    i = wp.tid()
    mass = density[0] * areas[i]
    motion = inverse_step * (x[i] - start[i]) - velocity[i]
    pull = x[i] - targets[i]
    value = d(0.5) * mass * wp.dot(motion, motion) + d(0.5) * pins[i] * wp.dot(pull, pull)
    fall = (x[i] - start[i])[1]
    wp.atomic_add(total, 0, value - mass * gravity * fall)


@wp.kernel
def membrane_energy(
    x: wp.array(dtype=v3),
    faces: wp.array(dtype=wp.vec3i),
    inverse: wp.array(dtype=wp.mat22d),
    areas: wp.array(dtype=d),
    stiffness: wp.array(dtype=d),
    total: wp.array(dtype=d),
):
    """A k |F - R|^2."""
    i = wp.tid()
    face = faces[i]
    x0 = x[face[0]]
    x1 = x[face[1]]
    x2 = x[face[2]]
    f1 = deformation(x0, x1, x2, inverse[i], 0)
    f2 = deformation(x0, x1, x2, inverse[i], 1)
    squared = wp.dot(f1, f1) + wp.dot(f2, f2)
    ratio = wp.length(wp.cross(f1, f2))
    density = squared - d(2.0) * wp.sqrt(squared + d(2.0) * ratio) + d(2.0)
    wp.atomic_add(total, 0, stiffness[0] * areas[i] * density)


@wp.kernel
def bending_energy(
    x: wp.array(dtype=v3),
    hinges: wp.array(dtype=wp.vec4i),
    weights: wp.array(dtype=d),
    stiffness: wp.array(dtype=d),
    total: wp.array(dtype=d),
):
    """k/2 theta^2 e^2 / (A1 + A2)."""
    i = wp.tid()
    h = hinges[i]
    angle = hinge_angle(x[h[0]], x[h[1]], x[h[2]], x[h[3]])
    wp.atomic_add(total, 0, d(0.5) * stiffness[0] * weights[i] * angle * angle)


@wp.kernel
def contact_energy(
    x: wp.array(dtype=v3),
    pairs: wp.array(dtype=wp.vec4i),
    is_edge: wp.array(dtype=int),
    closest: wp.array(dtype=v4),
    areas: wp.array(dtype=d),
    scale: d,
    dhat: d,
    thickness: d,
    total: wp.array(dtype=d),
):
    """scale w m b(d) of the pairs; scale is the barrier's stiffness times dhat."""
    i = wp.tid()
    p = pairs[i]
    r = difference(closest[i], x[p[0]], x[p[1]], x[p[2]], x[p[3]])
    value = scale * pair_area(areas, p, is_edge[i]) * barrier(wp.dot(r, r), dhat, thickness)
    if is_edge[i] == 1:
        value *= mollifier(x[p[0]], x[p[1]], x[p[2]], x[p[3]])
    wp.atomic_add(total, 0, value)
