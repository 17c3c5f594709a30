"""Corners of panels that turn sharp or oblique (checklist S11.2, S11.3, S11.4)."""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from dress_jax.pattern.corners import CornerTable, corner_tangents
from dress_jax.pattern.parameters import EdgeTable, PatternParameters

SMALL_ANGLE = math.radians(30.0)
"""Corners below it are widened (S11.3 leaves the threshold open)."""


def boundary_corner(
    parameters: PatternParameters, edges: EdgeTable, corners: CornerTable
) -> Float[Array, ""]:
    """Mean of 1 - d1 x d2 where a seam ends in the garment's boundary (S11.2).

    d1 and d2 are the unit tangents that arrive at and leave a corner, counter-clockwise; so a hem
    that meets its seam at a right angle costs nothing, and runs on smoothly in the next panel. Of
    the two edges at such a corner exactly one is sewn: a corner between two free edges, such as the
    point of a neckline, is a matter of design.

    Args:
        parameters: the pattern's parameters.
        edges: its edge table.
        corners: its corners.

    Returns:
        The mean, in [0, 2]; 0 for a pattern without such corners.
    """
    ends = jnp.sum(jnp.asarray(corners.free), axis=1) == 1
    arriving, leaving = corner_tangents(parameters, edges, corners)
    excess = 1.0 - jnp.asarray(corners.turn) * _cross(arriving, leaving)
    return jnp.sum(jnp.where(ends, excess, 0.0)) / jnp.maximum(jnp.sum(ends), 1)


def corner_signs(rest_positions: Float[Array, "P 2"], corners: CornerTable) -> Float[Array, "C"]:
    """Signs of the corners' cross products (V1 - V0) x (V2 - V0) in a pattern, shape (C,)."""
    return jnp.sign(_cross(*_sides(rest_positions, corners)))


def small_angle(
    rest_positions: Float[Array, "P 2"],
    corners: CornerTable,
    signs: Float[Array, "C"],
    *,
    threshold: float = SMALL_ANGLE,
) -> Float[Array, ""]:
    """Mean of -s (V1 - V0)^ x (V2 - V0)^ over corners; s is 0 above a threshold (S11.3).

    Below the threshold s is the corner's initial sign, so an angle that is about to close or has
    changed its side is pushed open to the side where it was. s carries no derivative. The value
    jumps where an angle passes the threshold.

    Args:
        rest_positions: panel vertices in panel coordinates [m], shape (P, 2).
        corners: the pattern's corners.
        signs: `corner_signs` of the initial pattern, shape (C,).
        threshold: angle [rad] above which a corner counts nothing.

    Returns:
        The mean, in [-1, 1]; negative where small angles are on their right side.
    """
    before, after = _sides(rest_positions, corners)
    cross = _cross(before, after)
    wide = jax.lax.stop_gradient(jnp.sum(before * after, axis=1) < math.cos(threshold))
    return -jnp.mean(jnp.where(wide, 0.0, signs) * cross)


def discretization_consistency(
    parameters: PatternParameters,
    rest_positions: Float[Array, "P 2"],
    edges: EdgeTable,
    corners: CornerTable,
) -> Float[Array, ""]:
    """Mean over corners of 2 - t1 . (V1 - V0)^ - t2 . (V2 - V0)^ (S11.4).

    Curves may cross beside a corner whose two segments are apart; the term keeps the end tangents
    t, which point away from the corner, along the segments.

    Args:
        parameters: the pattern's parameters.
        rest_positions: its panel vertices [m], shape (P, 2).
        edges: its edge table.
        corners: its corners.

    Returns:
        The mean, in [0, 4].
    """
    arriving, leaving = corner_tangents(parameters, edges, corners)
    before, after = _sides(rest_positions, corners)
    agreement = jnp.sum(leaving * after - arriving * before, axis=1)
    return jnp.mean(2.0 - agreement)


def _sides(
    rest_positions: Float[Array, "P 2"], corners: CornerTable
) -> tuple[Float[Array, "C 2"], Float[Array, "C 2"]]:
    """Unit vectors from every corner to the samples before and after it."""
    before, at, after = (rest_positions[corners.samples[:, k]] for k in range(3))
    return _unit(before - at), _unit(after - at)


def _unit(vectors: Float[Array, "C 2"]) -> Float[Array, "C 2"]:
    return vectors / jnp.linalg.norm(vectors, axis=1, keepdims=True)


def _cross(a: Float[Array, "C 2"], b: Float[Array, "C 2"]) -> Float[Array, "C"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
