"""Exact Hessians of hinges, in closed form.

With the edge e = x1 - x0 and the sides q = x2 - x0 and x3 - x0, the angle theta depends on each
side through n = e x q alone. With a = q.e/|e|^2 and the sign s of the side, its derivatives are

    u = d theta/dq = s |e| n / |n|^2,               d theta/de = -sum a u,
    A = d2/dq2     = s |e| (n m^T + m n^T) / |n|^4,  m = e x n,
    d2/de dq       = -a A - u e^T / |e|^2,
    d2/de2         = sum a^2 A + (a (e u^T + u e^T) - u (q - a e)^T) / |e|^2,

the sums over both sides; the mixed derivative of the two sides is zero.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dress_jax.core import components as c
from dress_jax.core.components import Components
from dress_jax.energy.bending import hinge_angle

_SIGNS = (-1.0, 1.0)  # of x2 and x3
_NUMBERS = ((0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (2, 0), (2, 1), (2, 2))

Matrix = tuple[Array, ...]  # nine components, row by row


class HingeBlocks(NamedTuple):
    """Hessian of the hinges: stiffness g_p g_q^T plus what the angle's curvature adds.

    Attributes:
        gradient: g per stencil vertex [1/m], (4, 3, h).
        stiffness: k_b e/h [N m], (h,).
        edge: times stiffness and angle, the second derivative in e, (9, h).
        mixed: in e (rows) and each side, (2, 9, h).
        sides: in each side, (2, 9, h).
    """

    gradient: Float[Array, "4 3 h"]
    stiffness: Float[Array, " h"]
    edge: Float[Array, "9 h"]
    mixed: Float[Array, "2 9 h"]
    sides: Float[Array, "2 9 h"]


def hinge_blocks(
    positions: Components,
    hinges: Int[Array, "4 h"],
    weights: Float[Array, " h"],
    bending_stiffness: Float[Array, ""] | Float[Array, " h"],
) -> HingeBlocks:
    """The exact Hessian of `bending_energy`, hinge by hinge.

    Args:
        positions: components (3 of (n,)) of the vertices [m].
        weights: e/h of every hinge.
    """
    x = [c.gather(positions, hinges[k]) for k in range(4)]
    edge = c.subtract(x[1], x[0])
    squared = c.dot(edge, edge)
    stiffness = bending_stiffness * weights
    force = stiffness * hinge_angle(*x)
    slopes: list[Components] = []
    sides: list[Matrix] = []
    mixed: list[Matrix] = []
    shares: list[Array] = []
    total = tuple(jnp.zeros_like(squared) for _ in range(9))
    for sign, end in zip(_SIGNS, x[2:], strict=True):
        side = c.subtract(end, x[0])
        normal = c.cross(edge, side)
        area = c.dot(normal, normal)
        factor = sign * jnp.sqrt(squared) / area
        share = c.dot(side, edge) / squared
        slope = c.scale(factor, normal)
        across = c.scale(factor / area, c.cross(edge, normal))
        along = c.scale(1.0 / squared, edge)
        rest = c.scale(1.0 / squared, c.subtract(side, c.scale(share, edge)))
        curved = _plus(_outer(normal, across), _outer(across, normal))
        bent = _outer(slope, along)
        own = tuple(
            share * (share * curved[k] + bent[k] + bent[3 * j + i]) - slope[i] * rest[j]
            for k, (i, j) in enumerate(_NUMBERS)
        )
        total = _plus(total, own)
        slopes.append(slope)
        sides.append(curved)
        mixed.append(tuple(-share * a - b for a, b in zip(curved, bent, strict=True)))
        shares.append(share)
    first = c.subtract(c.scale(-shares[0], slopes[0]), c.scale(shares[1], slopes[1]))
    zeroth = c.scale(-1.0, c.add(first, c.add(slopes[0], slopes[1])))
    return HingeBlocks(
        gradient=jnp.stack([jnp.stack(g) for g in (zeroth, first, *slopes)]),
        stiffness=stiffness,
        edge=_scaled(force, total),
        mixed=jnp.stack([_scaled(force, matrix) for matrix in mixed]),
        sides=jnp.stack([_scaled(force, matrix) for matrix in sides]),
    )


def curvature_blocks(blocks: HingeBlocks) -> Float[Array, "10 9 h"]:
    """What the angle's curvature adds to the blocks of the pairs `HINGE_PAIRS`."""
    edge, (left, right) = blocks.edge, blocks.sides
    to_left, to_right = blocks.mixed
    zero_left, zero_right = -(to_left + left), -(to_right + right)
    zero_edge = -(edge + _turned(to_left) + _turned(to_right))
    corner = -(zero_edge + zero_left + zero_right)
    nothing = jnp.zeros_like(edge)
    return jnp.stack(
        [
            *(corner, zero_edge, zero_left, zero_right),
            *(edge, to_left, to_right),
            *(left, nothing),
            right,
        ]
    )


def _outer(a: Components, b: Components) -> Matrix:
    return tuple(a[i] * b[j] for i, j in _NUMBERS)


def _plus(a: Matrix, b: Matrix) -> Matrix:
    return tuple(x + y for x, y in zip(a, b, strict=True))


def _scaled(factor: Array, matrix: Matrix) -> Float[Array, "9 h"]:
    return jnp.stack([factor * component for component in matrix])


def _turned(matrix: Float[Array, "9 h"]) -> Float[Array, "9 h"]:
    """Transposed."""
    return jnp.stack([matrix[3 * j + i] for i, j in _NUMBERS])
