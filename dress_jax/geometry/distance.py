"""Squared distances of the two contact stencils, with the weights of their closest points.

A stencil is an array x of shape (4, 3, ...): four points, three coordinates, any batch, or the same
as nested tuples. Vertex-face stencils hold [vertex, face corners], edge-edge stencils [edge a,
edge b]. The kernels work on one array per scalar component, which XLA on CPU turns into code many
times faster than arrays with a trailing axis of three.

With the closest points written as weights, r = sum_i w_i x_i is the difference vector and
D = |r|^2. By the envelope theorem dD = 2 r . sum_i w_i dx_i exactly, also where the weights are
badly conditioned (nearly parallel edges), so that is the derivative rule; second derivatives then
differentiate the weights. Which features are closest (a vertex, an edge, the interior) is decided
by comparing candidates, all of which are distances between points of the two primitives: a wrong
decision by rounding costs accuracy of the order of rounding, nothing else.
"""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from dress_jax.core.components import Components, cross, dot, subtract

# Squared sine below which two directions count as parallel. A triangle with such a corner, or a
# pair of such edges, is then measured through its boundary, which is off by at most the sine times
# the length. For the triangle both errors (rounding of barycentrics / sine, and the sine) are equal
# at 1e-8; the edge pair loses nothing to rounding and can go much lower.
_PARALLEL_FACE = 1e-16
_PARALLEL_EDGES = 1e-24

# A stencil as an array, or as four tuples of three components.
Stencil = Float[Array, "4 3 *n"] | tuple[Components, ...]


def _point(x: Stencil, index: int) -> Components:
    return x[index] if isinstance(x, tuple) else (x[index, 0], x[index, 1], x[index, 2])


def _along(a: Components, t: Array, d: Components) -> Components:
    """a - t d."""
    return a[0] - t * d[0], a[1] - t * d[1], a[2] - t * d[2]


def _divide(numerator: Array, denominator: Array, valid: Array) -> Array:
    """numerator / denominator where valid, else 0; both branches have finite derivatives."""
    return jnp.where(valid, numerator, 0.0) / jnp.where(valid, denominator, 1.0)


def _segment(q: Components, d: Components) -> tuple[Array, Array]:
    """Closest parameter in [0, 1] on the segment o + t d to the point o + q, and |q - t d|^2.

    Outside (0, 1) the parameter is constant, so its derivative is zero there.
    """
    numerator, length = dot(q, d), dot(d, d)
    inside = lax.stop_gradient((numerator > 0) & (numerator < length))
    end = jnp.where(lax.stop_gradient((numerator >= length) & (length > 0)), 1.0, 0.0)
    t = jnp.where(inside, _divide(numerator, length, inside), end)
    r = _along(q, t, d)
    return t, dot(r, r)


def _vertex_face_weights(x: Stencil) -> tuple[Array, Array]:
    """Barycentric coordinates (v, w) of corners b and c at the closest point of the face."""
    p, a, b, c = (_point(x, i) for i in range(4))
    ab, ac, bc = subtract(b, a), subtract(c, a), subtract(c, b)
    ap, bp = subtract(p, a), subtract(p, b)
    normal = cross(ab, ac)
    area = dot(normal, normal)
    # Cross products keep full precision for slivers, where the Gram determinant loses half of it.
    valid = lax.stop_gradient(area > _PARALLEL_FACE * dot(ab, ab) * dot(ac, ac))
    v_in = _divide(dot(normal, cross(ap, ac)), area, valid)
    w_in = _divide(dot(normal, cross(ab, ap)), area, valid)
    r = _along(_along(ap, v_in, ab), w_in, ac)
    inside = valid & (v_in >= 0) & (w_in >= 0) & (v_in + w_in <= 1)

    t_ab, d_ab = _segment(ap, ab)
    t_ac, d_ac = _segment(ap, ac)
    t_bc, d_bc = _segment(bp, bc)
    first = d_ab <= jnp.minimum(d_ac, d_bc)
    second = d_ac <= d_bc
    boundary = jnp.where(first, d_ab, jnp.where(second, d_ac, d_bc))
    v_edge = jnp.where(first, t_ab, jnp.where(second, 0.0, 1.0 - t_bc))
    w_edge = jnp.where(first, 0.0, jnp.where(second, t_ac, t_bc))
    inside = lax.stop_gradient(inside & (dot(r, r) <= boundary))
    return jnp.where(inside, v_in, v_edge), jnp.where(inside, w_in, w_edge)


def _edge_edge_weights(x: Stencil) -> tuple[Array, Array]:
    """Parameters (s, t) of the closest points on the edges a and b.

    Parallel edges: the first of the endpoint cases a0, a1, b0, b1 with the smallest distance.
    """
    a0, a1, b0, b1 = (_point(x, i) for i in range(4))
    u, v, w = subtract(a1, a0), subtract(b1, b0), subtract(b0, a0)
    uu, vv = dot(u, u), dot(v, v)
    normal = cross(u, v)
    area = dot(normal, normal)
    valid = lax.stop_gradient((area > _PARALLEL_EDGES * uu * vv) & (uu > 0) & (vv > 0))
    # s from cross products, t by projecting that point: then r is accurate to rounding of the
    # coordinates however small the angle, because an error of s moves r by only sin(angle) of it.
    s_in = _divide(dot(normal, cross(w, v)), area, valid)
    t_in = _divide(dot(u, v) * s_in - dot(w, v), vv, valid)
    r = _along((-w[0], -w[1], -w[2]), -s_in, u)
    r = _along(r, t_in, v)
    inside = valid & (s_in >= 0) & (s_in <= 1) & (t_in >= 0) & (t_in <= 1)

    t_0, d_a0 = _segment(subtract(a0, b0), v)
    t_1, d_a1 = _segment(subtract(a1, b0), v)
    s_0, d_b0 = _segment(subtract(b0, a0), u)
    s_1, d_b1 = _segment(subtract(b1, a0), u)
    best = jnp.minimum(jnp.minimum(d_a0, d_a1), jnp.minimum(d_b0, d_b1))
    is_a0, is_a1, is_b0 = d_a0 <= best, d_a1 <= best, d_b0 <= best
    s_end = jnp.where(is_a0, 0.0, jnp.where(is_a1, 1.0, jnp.where(is_b0, s_0, s_1)))
    t_end = jnp.where(is_a0, t_0, jnp.where(is_a1, t_1, jnp.where(is_b0, 0.0, 1.0)))
    inside = lax.stop_gradient(inside & (dot(r, r) <= best))
    return jnp.where(inside, s_in, s_end), jnp.where(inside, t_in, t_end)


def _vertex_face_difference(x: Stencil, v: Array, w: Array) -> Components:
    # Differences of nearby points first: they are exact, so r keeps its relative accuracy.
    p, a, b, c = (_point(x, i) for i in range(4))
    return _along(_along(subtract(p, a), v, subtract(b, a)), w, subtract(c, a))


def _edge_edge_difference(x: Stencil, s: Array, t: Array) -> Components:
    a0, a1, b0, b1 = (_point(x, i) for i in range(4))
    return _along(_along(subtract(a0, b0), -s, subtract(a1, a0)), t, subtract(b1, b0))


@jax.custom_jvp
def vertex_face_squared(x: Stencil) -> Float[Array, "*n"]:
    """Squared distance of vertices x[0] from faces x[1:].

    Args:
        x: stencils [m], shape (4, 3, ...), or four tuples of three components.

    Returns:
        Squared distances [m^2]. First and second derivatives are finite everywhere.
    """
    r = _vertex_face_difference(x, *_vertex_face_weights(x))
    return dot(r, r)


@vertex_face_squared.defjvp
def _vertex_face_squared_jvp(primals, tangents):
    (x,), (dx,) = primals, tangents
    v, w = _vertex_face_weights(x)
    r = _vertex_face_difference(x, v, w)
    return dot(r, r), 2.0 * dot(r, _vertex_face_difference(dx, v, w))


@jax.custom_jvp
def edge_edge_squared(x: Stencil) -> Float[Array, "*n"]:
    """Squared distance of the segments x[0] x[1] and x[2] x[3].

    Args:
        x: stencils [m], shape (4, 3, ...), or four tuples of three components.

    Returns:
        Squared distances [m^2]. First and second derivatives are finite everywhere; for parallel
        edges they are those of the endpoint case chosen.
    """
    r = _edge_edge_difference(x, *_edge_edge_weights(x))
    return dot(r, r)


@edge_edge_squared.defjvp
def _edge_edge_squared_jvp(primals, tangents):
    (x,), (dx,) = primals, tangents
    s, t = _edge_edge_weights(x)
    r = _edge_edge_difference(x, s, t)
    return dot(r, r), 2.0 * dot(r, _edge_edge_difference(dx, s, t))


def _rows(*rows: Array) -> Array:
    # Stacking would be fused with what computes the rows and repeat that for each of them.
    array = jnp.zeros((len(rows), *rows[0].shape), rows[0].dtype)
    for k, row in enumerate(rows):
        array = array.at[k].set(row)
    return array


def vertex_face_closest(
    x: Stencil,
) -> tuple[Float[Array, "4 *n"], Float[Array, "*n"]]:
    """Weights w with difference vector sum_i w_i x_i (+1, minus barycentrics), and its square.

    Args:
        x: stencils [m], shape (4, 3, ...), or four tuples of three components.

    Returns:
        Weights, shape (4, ...), and squared distances [m^2], shape (...).
    """
    v, w = _vertex_face_weights(x)
    return _rows(jnp.ones_like(v), v + w - 1.0, -v, -w), vertex_face_squared(x)


def edge_edge_closest(
    x: Stencil,
) -> tuple[Float[Array, "4 *n"], Float[Array, "*n"]]:
    """Weights w with difference vector sum_i w_i x_i (1 - s, s, t - 1, -t), and its square.

    Args:
        x: stencils [m], shape (4, 3, ...), or four tuples of three components.

    Returns:
        Weights, shape (4, ...), and squared distances [m^2], shape (...).
    """
    s, t = _edge_edge_weights(x)
    return _rows(1.0 - s, s, t - 1.0, -t), edge_edge_squared(x)


def point_triangle_squared_distance(
    p: Float[Array, "3"], a: Float[Array, "3"], b: Float[Array, "3"], c: Float[Array, "3"]
) -> Float[Array, ""]:
    """Squared distance [m^2] of point p from triangle a b c; positions [m], each of shape (3,)."""
    return vertex_face_squared(jnp.stack([p, a, b, c]))


def edge_edge_squared_distance(
    a0: Float[Array, "3"], a1: Float[Array, "3"], b0: Float[Array, "3"], b1: Float[Array, "3"]
) -> Float[Array, ""]:
    """Squared distance [m^2] of segments a0 a1 and b0 b1; positions [m], each of shape (3,)."""
    return edge_edge_squared(jnp.stack([a0, a1, b0, b1]))
