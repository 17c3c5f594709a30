"""Edge curves in the frame of their own chord: cubic Béziers and circular arcs.

A curve runs from (0, 0) to (1, 0) of its chord frame: x along the chord e, y along the
perpendicular (-e_y, e_x), both in units of the chord length. That map is a similarity, so a curve's
length is the chord length times a function of its control points alone.

Functions take `xp`, the array module: `jax.numpy` (default) or `numpy` for host work; what they
return is an array of that module (annotated as `Any`, with its shape in the docstring).
Checklist S3.4, S5.1, S5.2.
"""

from types import ModuleType
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

Points = Float[Array, "*batch 2"] | Float[np.ndarray, "*batch 2"]
Numbers = Float[Array, "*batch"] | Float[np.ndarray, "*batch"]
Flags = Bool[Array, "*batch"] | Bool[np.ndarray, "*batch"]

_SMALL_ANGLE = 1e-3  # below it the series of sin(u a) / sin(a) is exact to 1e-16
_LENGTH_INTERVALS = 16
_TABLE_INTERVALS = 128
_NEWTON_STEPS = 4
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_NODES = 0.5 * (_NODES + 1.0)
_WEIGHTS = 0.5 * _WEIGHTS


def elevate(control: Points, *, xp: ModuleType = jnp) -> tuple[Any, Any]:
    """The cubic control points of a quadratic curve, in the chord frame.

    Args:
        control: the quadratic's control point [chord lengths], shape (..., 2).

    Returns:
        The two control points of the same curve as a cubic, each of shape (..., 2).
    """
    first = control * (2.0 / 3.0)
    return first, first + xp.asarray([1.0 / 3.0, 0.0]).reshape((1,) * (first.ndim - 1) + (2,))


def bezier_point(first: Points, second: Points, t: Numbers, *, xp: ModuleType = jnp) -> Any:
    """Points of cubic Béziers from (0, 0) to (1, 0).

    Args:
        first, second: control points [chord lengths], shape (..., 2).
        t: curve parameter in [0, 1], shape (...).

    Returns:
        Points [chord lengths], shape (..., 2).
    """
    s = 1.0 - t
    a, b, c = 3.0 * s * s * t, 3.0 * s * t * t, t * t * t
    x = a * first[..., 0] + b * second[..., 0] + c
    y = a * first[..., 1] + b * second[..., 1]
    return xp.stack([x, y], axis=-1)


def bezier_velocity(first: Points, second: Points, t: Numbers, *, xp: ModuleType = jnp) -> Any:
    """Derivative of `bezier_point` by t [chord lengths], shape (..., 2)."""
    s = 1.0 - t
    a, b, c = 3.0 * (s * s - 2.0 * s * t), 3.0 * (2.0 * s * t - t * t), 3.0 * t * t
    x = a * first[..., 0] + b * second[..., 0] + c
    y = a * first[..., 1] + b * second[..., 1]
    return xp.stack([x, y], axis=-1)


def _chord_ratio(half_angle: Numbers, u: Numbers, xp: ModuleType) -> Any:
    """sin(u a) / sin(a), also where a vanishes."""
    straight = xp.abs(half_angle) < _SMALL_ANGLE
    safe = xp.where(straight, 1.0, half_angle)
    squared = half_angle * half_angle
    series = u * (
        1.0
        + squared * (1.0 - u * u) / 6.0
        + squared * squared * (7.0 - 10.0 * u * u + 3.0 * u**4) / 360.0
    )
    return xp.where(straight, series, xp.sin(u * safe) / xp.sin(safe))


def arc_point(height: Numbers, u: Numbers, *, xp: ModuleType = jnp) -> Any:
    """Points of circular arcs from (0, 0) to (1, 0), uniform in arc length.

    An arc is given by its signed height over the chord; its half opening angle is
    a = 2 atan(2 height). The point at fraction u of the arc lies at distance sin(u a) / sin(a)
    from the start, turned by (1 - u) a from the chord.

    Args:
        height: signed height [chord lengths], positive on the perpendicular's side, shape (...).
        u: fraction of the arc's length in [0, 1], shape (...).

    Returns:
        Points [chord lengths], shape (..., 2).
    """
    half_angle = 2.0 * xp.arctan(2.0 * height)
    ratio = _chord_ratio(half_angle, u, xp)
    direction = (1.0 - u) * half_angle
    return xp.stack([ratio * xp.cos(direction), ratio * xp.sin(direction)], axis=-1)


def arc_length(height: Numbers, *, xp: ModuleType = jnp) -> Any:
    """Length of circular arcs [chord lengths]: a / sin(a), shape of `height`."""
    half_angle = 2.0 * xp.arctan(2.0 * height)
    straight = xp.abs(half_angle) < _SMALL_ANGLE
    safe = xp.where(straight, 1.0, half_angle)
    squared = half_angle * half_angle
    series = 1.0 + squared / 6.0 + 7.0 * squared * squared / 360.0
    return xp.where(straight, series, safe / xp.sin(safe))


def end_directions(arc: Flags, first: Points, second: Points, *, xp: ModuleType = jnp) -> Any:
    """Directions in which curves leave their start and reach their end, of any length.

    Where a control point coincides with its end, the other one gives the direction.

    Args:
        arc: whether the curve is an arc, shape (...).
        first, second: cubic control points; an arc's height is `first[..., 1]`, shape (..., 2).

    Returns:
        Two vectors in the chord frame, each of shape (..., 2).
    """
    unit = xp.asarray([1.0, 0.0]).reshape((1,) * (first.ndim - 1) + (2,))
    to_end, between = unit - second, second - first

    def chosen(own: Any, other: Any) -> Any:
        moving = xp.sum(own * own, axis=-1, keepdims=True) > 0.0
        return xp.where(moving, own, other)

    half_angle = 2.0 * xp.arctan(2.0 * xp.where(arc, first[..., 1], 0.0))
    rising = xp.stack([xp.cos(half_angle), xp.sin(half_angle)], axis=-1)
    falling = rising * xp.asarray([1.0, -1.0]).reshape(unit.shape)
    is_arc = arc[..., None]
    return (
        xp.where(is_arc, rising, chosen(first, second)),
        xp.where(is_arc, falling, chosen(to_end, chosen(between, unit - first))),
    )


def curve_point(
    arc: Flags, first: Points, second: Points, t: Numbers, *, xp: ModuleType = jnp
) -> Any:
    """Points of Béziers and arcs in the chord frame, chosen entry by entry.

    Args:
        arc: whether the curve is an arc, shape (...).
        first, second: cubic control points; an arc's height is `first[..., 1]`, shape (..., 2).
        t: curve parameter in [0, 1], shape (...).

    Returns:
        Points [chord lengths], shape (..., 2).
    """
    bezier = bezier_point(first, second, t, xp=xp)
    height = xp.where(arc, first[..., 1], 0.0)
    return xp.where(arc[..., None], arc_point(height, t, xp=xp), bezier)


def from_chord_frame(start: Points, end: Points, local: Points, *, xp: ModuleType = jnp) -> Any:
    """Map chord-frame points to panel coordinates.

    Args:
        start, end: ends of the chord [m], shape (..., 2).
        local: points [chord lengths], shape (..., 2).

    Returns:
        Points [m], shape (..., 2).
    """
    chord = end - start
    perpendicular = xp.stack([-chord[..., 1], chord[..., 0]], axis=-1)
    return start + local[..., 0:1] * chord + local[..., 1:2] * perpendicular


def to_chord_frame(start: np.ndarray, end: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Inverse of `from_chord_frame` on the host; the chord must not vanish."""
    chord = end - start
    perpendicular = np.stack([-chord[..., 1], chord[..., 0]], axis=-1)
    squared = np.sum(chord * chord, axis=-1)
    offset = points - start
    along = np.sum(offset * chord, axis=-1) / squared
    across = np.sum(offset * perpendicular, axis=-1) / squared
    return np.stack([along, across], axis=-1)


def _bezier_speed(first: Points, second: Points, t: Numbers, xp: ModuleType) -> Any:
    velocity = bezier_velocity(first, second, t, xp=xp)
    squared = velocity[..., 0] ** 2 + velocity[..., 1] ** 2
    moving = squared > 0.0
    return xp.where(moving, xp.sqrt(xp.where(moving, squared, 1.0)), 0.0)


def relative_lengths(arc: Flags, first: Points, second: Points, *, xp: ModuleType = jnp) -> Any:
    """Arc lengths [chord lengths] of curves; Gauss-Legendre on 16 intervals, arcs in closed form.

    Args:
        arc: whether the curve is an arc, shape (n,).
        first, second: control points [chord lengths], shape (n, 2).

    Returns:
        Lengths [chord lengths], shape (n,).
    """
    starts = np.arange(_LENGTH_INTERVALS)[:, None]
    t = xp.asarray(((starts + _NODES[None, :]) / _LENGTH_INTERVALS).reshape(1, -1))
    weights = xp.asarray(np.tile(_WEIGHTS, _LENGTH_INTERVALS) / _LENGTH_INTERVALS)
    speed = _bezier_speed(first[:, None, :], second[:, None, :], t, xp)
    height = xp.where(arc, first[..., 1], 0.0)
    return xp.where(arc, arc_length(height, xp=xp), speed @ weights)


def uniform_parameters(
    arc: bool, first: Float[np.ndarray, "2"], second: Float[np.ndarray, "2"], count: int
) -> Float[np.ndarray, "count_plus_1"]:
    """Curve parameters that cut one curve into `count` pieces of equal arc length (S5.1).

    The cumulative length is tabulated by Gauss-Legendre quadrature and inverted by Newton's method
    inside the table's interval.

    Args:
        arc: whether the curve is an arc (its parameter is arc length already).
        first, second: control points [chord lengths], shape (2,).
        count: number of pieces.

    Returns:
        Parameters from 0 to 1, shape (count + 1,).
    """
    uniform = np.arange(count + 1) / count
    if arc or count == 1:
        return uniform
    knots = np.arange(_TABLE_INTERVALS + 1) / _TABLE_INTERVALS
    width = 1.0 / _TABLE_INTERVALS
    speed = _bezier_speed(first, second, knots[:-1, None] + width * _NODES[None, :], np)
    table = np.concatenate([[0.0], np.cumsum(speed @ _WEIGHTS) * width])
    target = uniform[1:-1] * table[-1]
    cell = np.clip(np.searchsorted(table, target, side="right") - 1, 0, _TABLE_INTERVALS - 1)
    low, high = knots[cell], knots[cell + 1]
    share = (target - table[cell]) / np.maximum(table[cell + 1] - table[cell], 1e-300)
    t = low + share * width
    for _ in range(_NEWTON_STEPS):
        inside = low[:, None] + (t - low)[:, None] * _NODES[None, :]
        reached = table[cell] + (_bezier_speed(first, second, inside, np) @ _WEIGHTS) * (t - low)
        here = np.maximum(_bezier_speed(first, second, t, np), 1e-12)
        t = np.clip(t - (reached - target) / here, low, high)
    return np.concatenate([[0.0], t, [1.0]])


def turning_angle(arc: bool, first: np.ndarray, second: np.ndarray) -> float:
    """Total absolute turning of a curve's tangent [rad], measured on 64 chords (host)."""
    t = np.arange(65) / 64.0
    flags = np.full(t.shape, arc)
    points = curve_point(
        flags, np.broadcast_to(first, (65, 2)), np.broadcast_to(second, (65, 2)), t, xp=np
    )
    steps = np.diff(points, axis=0)
    steps = steps[np.hypot(steps[:, 0], steps[:, 1]) > 0.0]
    cross = steps[:-1, 0] * steps[1:, 1] - steps[:-1, 1] * steps[1:, 0]
    dot = np.sum(steps[:-1] * steps[1:], axis=1)
    return float(np.sum(np.abs(np.arctan2(cross, dot))))
