"""Curves in the chord frame: closed forms, circle geometry, arc-length sampling."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.geometry.curves import (
    arc_length,
    arc_point,
    bezier_point,
    bezier_velocity,
    curve_point,
    elevate,
    from_chord_frame,
    relative_lengths,
    to_chord_frame,
    turning_angle,
    uniform_parameters,
)

ROUNDING = 1e-13  # a few operations on numbers of order one
QUADRATURE = 1e-9  # Gauss-Legendre, 16 x 8 nodes, smooth curves
DIFFERENCE = 1e-8  # central differences with a step of 1e-6

HEIGHTS = [-3.0, -0.5, -0.2, -1e-4, -1e-9, 0.0, 1e-9, 1e-4, 0.2, 0.5, 3.0]


def test_quadratic_is_the_textbook_formula():
    rng = np.random.default_rng(0)
    start, control, end = rng.normal(size=(3, 2))
    t = np.linspace(0.0, 1.0, 7)[:, None]
    expected = (1 - t) ** 2 * start + 2 * (1 - t) * t * control + t**2 * end
    local = to_chord_frame(start, end, control)
    first, second = elevate(local, xp=np)
    points = bezier_point(first[None], second[None], t[:, 0], xp=np)
    actual = from_chord_frame(start[None], end[None], points, xp=np)
    np.testing.assert_allclose(actual, expected, atol=ROUNDING)


def test_velocity_is_the_derivative():
    first, second = jnp.array([0.2, 0.4]), jnp.array([0.9, -0.3])
    for t in (0.0, 0.3, 1.0):
        expected = jax.jacfwd(lambda s: bezier_point(first, second, s))(t)
        np.testing.assert_allclose(
            bezier_velocity(first, second, jnp.array(t)), expected, atol=1e-14
        )


@pytest.mark.parametrize("height", HEIGHTS)
def test_arc_lies_on_one_circle_and_is_uniform(height):
    u = np.linspace(0.0, 1.0, 33)
    points = arc_point(np.full(33, height), u, xp=np)
    np.testing.assert_allclose(points[[0, -1]], [[0.0, 0.0], [1.0, 0.0]], atol=ROUNDING)
    np.testing.assert_allclose(points[16], [0.5, height], atol=ROUNDING)
    steps = np.hypot(*np.diff(points, axis=0).T)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
    if abs(height) > 1e-3:
        radius = (height**2 + 0.25) / (2.0 * height)
        distance = np.hypot(points[:, 0] - 0.5, points[:, 1] - (height - radius))
        np.testing.assert_allclose(distance, abs(radius), rtol=1e-12)
        angle = 4.0 * np.arctan(2.0 * abs(height))
        np.testing.assert_allclose(arc_length(np.array(height), xp=np), abs(radius) * angle)


@pytest.mark.parametrize("height", HEIGHTS)
def test_arc_derivative_is_smooth_through_the_straight_line(height):
    def value(h):
        return jnp.sum(arc_point(h, jnp.array(0.3)) * jnp.array([1.0, 2.0])) + arc_length(h)

    step = 1e-6
    expected = (value(height + step) - value(height - step)) / (2.0 * step)
    actual = jax.grad(value)(height)
    np.testing.assert_allclose(actual, expected, atol=DIFFERENCE * max(1.0, abs(expected)))
    assert abs(actual) > 0.1


def test_lengths_match_dense_polylines_and_closed_forms():
    arc = np.array([False, False, True, False])
    first = np.array([[0.2, 0.4], [1 / 3, 0.0], [0.5, 0.3], [0.0, 0.0]])
    second = np.array([[0.9, -0.3], [2 / 3, 0.0], [0.5, 0.3], [1.0, 0.0]])
    t = np.linspace(0.0, 1.0, 200_001)
    actual = relative_lengths(arc, first, second, xp=np)
    for i in range(4):
        flags = np.full(t.shape, arc[i])
        shape = (len(t), 2)
        a, b = np.broadcast_to(first[i], shape), np.broadcast_to(second[i], shape)
        polyline = np.sum(np.hypot(*np.diff(curve_point(flags, a, b, t, xp=np), axis=0).T))
        np.testing.assert_allclose(actual[i], polyline, rtol=QUADRATURE)
    np.testing.assert_allclose(actual[[1, 3]], 1.0, rtol=QUADRATURE)


@pytest.mark.parametrize("count", [1, 2, 7, 50])
@pytest.mark.parametrize(
    ("first", "second"),
    [((0.2, 0.9), (0.5, -0.8)), ((0.0, 0.0), (1.0, 0.0)), ((1 / 3, 0.0), (2 / 3, 0.0))],
)
def test_samples_are_uniform_in_arc_length(count, first, second):
    first, second = np.array(first), np.array(second)
    t = uniform_parameters(False, first, second, count)
    assert t[0] == 0.0 and t[-1] == 1.0 and np.all(np.diff(t) > 0.0)
    fine = np.concatenate([np.linspace(a, b, 2001)[:-1] for a, b in itertools.pairwise(t)])
    fine = np.append(fine, 1.0)
    shape = (len(fine), 2)
    points = bezier_point(
        np.broadcast_to(first, shape), np.broadcast_to(second, shape), fine, xp=np
    )
    pieces = np.hypot(*np.diff(points, axis=0).T).reshape(count, 2000).sum(axis=1)
    np.testing.assert_allclose(pieces, pieces.mean(), rtol=1e-6)  # the polyline's own error


def test_turning_of_an_arc_is_its_angle():
    # 64 chords turn by 63/64 of the arc's angle in total.
    angle = turning_angle(True, np.array([0.5, 0.5]), np.array([0.5, 0.5]))
    np.testing.assert_allclose(angle, np.pi * 63 / 64, rtol=1e-12)
    assert turning_angle(False, np.array([1 / 3, 0.0]), np.array([2 / 3, 0.0])) < 1e-12
