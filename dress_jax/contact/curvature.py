"""Exact Hessians of the barrier, in closed form.

With the closest points written as weights, r = sum_i w_i x_i and D = |r|^2 = min over the free ones
of the weights' parameters (two inside of a face or between two edges, one along an edge, none at
corners). With w_i^a the derivatives of the weights in parameter a, and r^a = sum_i w_i^a x_i, the
implicit function theorem gives the second derivative

    d2D / dx_i dx_j = 2 w_i w_j I - sum_ab c_i^a (M^-1)_ab (c_j^b)^T,
    c_i^a = 2 (w_i r^a + w_i^a r),    M_ab = 2 r^a . r^b,

an isotropic block minus at most two outer products. The barrier adds a third along r.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from dress_jax.contact.potential import (
    Contact,
    PairKind,
    closest,
    energy_scales,
    pair_barrier,
    stencils,
)
from dress_jax.core import components as c
from dress_jax.core.components import Components

_FREE = 1e-14  # of a barycentric coordinate; below, the closest point is on the opposite edge


class CurvedBlocks(NamedTuple):
    """Hessian of the pairs: block (p, q) is s0 w_p w_q I + sum_k s_k v_kp v_kq^T.

    Attributes:
        weights: w per stencil vertex, (4, m).
        isotropic: s0 [N/m], (m,).
        vectors: v per term and stencil vertex, (3, 4, 3, m).
        stiffness: s per term, (3, m).
    """

    weights: Float[Array, "4 m"]
    isotropic: Float[Array, " m"]
    vectors: Float[Array, "3 4 3 m"]
    stiffness: Float[Array, "3 m"]


def curved_blocks(positions: Float[Array, "n 3"], contact: Contact) -> CurvedBlocks:
    """The exact Hessian of pairs that no mollifier fades out.

    Args:
        positions: cloth and body vertices [m].
        contact: vertex-face pairs, or edge-edge pairs that are not nearly parallel.
    """
    points, used = stencils(positions, contact.pairs)
    weights, squared = closest(points, contact.pairs.kind)
    w = tuple(weights[p] for p in range(4))
    # The weights sum up to zero: differences from one vertex keep the accuracy of small distances.
    x = tuple(tuple(points[p, k] - points[0, k] for k in range(3)) for p in range(4))
    derivatives = pair_barrier(squared, contact)
    scale = jnp.where(used, energy_scales(points, contact), 0.0)
    r = c.combine(w, x)
    (first, has_first), (second, has_second) = _parameters(w, contact.pairs.kind)
    r1, r2 = c.combine(first, x), c.combine(second, x)
    m11 = jnp.where(has_first, 2.0 * c.dot(r1, r1), 1.0)
    ratio = 2.0 * c.dot(r1, r2) / m11
    m22 = jnp.where(has_second, 2.0 * c.dot(r2, r2) - ratio**2 * m11, 1.0)

    def mixed(p: int, changes: tuple[Array, ...], along: Components) -> Components:
        return c.add(c.scale(2.0 * w[p], along), c.scale(2.0 * changes[p], r))

    c1 = [mixed(p, first, r1) for p in range(4)]
    c2 = [c.subtract(mixed(p, second, r2), c.scale(ratio, c1[p])) for p in range(4)]
    normal = [c.scale(2.0 * w[p], r) for p in range(4)]
    force = scale * derivatives.first
    return CurvedBlocks(
        weights=weights,
        isotropic=2.0 * force,
        vectors=jnp.stack([jnp.stack([jnp.stack(v) for v in term]) for term in (normal, c1, c2)]),
        stiffness=jnp.stack([scale * derivatives.second, -force / m11, -force / m22]),
    )


def _parameters(
    w: tuple[Array, ...], kind: PairKind
) -> tuple[tuple[tuple[Array, ...], Array], tuple[tuple[Array, ...], Array]]:
    """Two parameters of the closest points: how the weights change with each, and if it is free.

    The changes along a parameter that is not free are zero.
    """
    zero = jnp.zeros_like(w[0])
    if kind is PairKind.EDGE_EDGE:
        free_a, free_b = ((t > 0.0) & (t < 1.0) for t in (w[1], -w[3]))
        one_a, one_b = (jnp.where(free, 1.0, 0.0) for free in (free_a, free_b))
        return ((-one_a, one_a, zero, zero), free_a), ((zero, zero, one_b, -one_b), free_b)
    on = [jnp.abs(w[k]) > _FREE for k in (1, 2, 3)]
    ab, ac, bc = on[0] & on[1], on[0] & on[2], on[1] & on[2]
    inside = ab & on[2]
    along_ab, along_bc = jnp.where(ab, 1.0, 0.0), jnp.where(bc & ~on[0], 1.0, 0.0)
    along_ac = jnp.where(ac & ~on[1], 1.0, 0.0)
    across = jnp.where(inside, 1.0, 0.0)
    first = (zero, along_ab + along_ac, along_bc - along_ab, -along_ac - along_bc)
    return (first, ab | ac | bc), ((zero, across, zero, -across), inside)
