import ipctk
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.contact.barrier import barrier, barrier_derivatives, contact_settings

DHAT, THICKNESS = 3e-3, 4e-4
SETTINGS = contact_settings(dhat=DHAT, thickness=THICKNESS)
REACH = DHAT**2 + 2.0 * DHAT * THICKNESS  # s^, the range of s = d^2 - xi^2
# Fractions of the range, from all but touching to beyond the end.
FRACTIONS = np.array([1e-9, 1e-4, 0.01, 0.2, 0.7, 0.99, 1.0 - 1e-6, 1.0 + 1e-6, 1.5, 40.0])
# z = s / s^ loses the digits that d^2 shares with xi^2: 2e-16 d^2 / s.
CANCELLATION = 4e-16 * (1.0 + THICKNESS**2 / (FRACTIONS * REACH))


def _squared(fractions):
    return jnp.asarray(THICKNESS**2 + np.asarray(fractions) * REACH)


def test_value_and_derivatives_against_autodiff():
    squared = _squared(FRACTIONS)
    derivatives = barrier_derivatives(squared, SETTINGS)
    first = jax.jit(jax.vmap(jax.grad(lambda d: barrier(d, SETTINGS))))(squared)
    second = jax.jit(jax.vmap(jax.hessian(lambda d: barrier(d, SETTINGS))))(squared)
    # Both evaluate the same z, so they agree to rounding of the largest term.
    np.testing.assert_allclose(derivatives.value, barrier(squared, SETTINGS), rtol=1e-14)
    np.testing.assert_allclose(derivatives.first * REACH, first * REACH, rtol=1e-12, atol=1e-20)
    np.testing.assert_allclose(
        derivatives.second * REACH**2, second * REACH**2, rtol=1e-12, atol=1e-15
    )
    inside = FRACTIONS < 1.0
    assert np.all(derivatives.first[inside] < 0.0)
    assert np.all(derivatives.second[inside] > 0.0)
    for member in derivatives:
        np.testing.assert_array_equal(np.asarray(member)[~inside], 0.0)


def test_central_differences():
    """The derivatives are those of the value, not merely of each other."""
    squared = _squared([0.01, 0.2, 0.7, 0.99])
    step = 1e-5 * np.array([0.01, 0.2, 0.7, 0.99]) * REACH
    sides = [barrier_derivatives(squared + sign * step, SETTINGS) for sign in (1, -1)]
    centre = barrier_derivatives(squared, SETTINGS)
    for k in (0, 1):
        difference = (np.asarray(sides[0][k]) - np.asarray(sides[1][k])) / (2.0 * step)
        # Step^2 of the series is 1e-10; rounding of the value over the step is the rest.
        np.testing.assert_allclose(difference, centre[k + 1], rtol=1e-6)


def test_against_ipctk():
    """ipctk's barrier of (s, s^) over s^^2: ours is its shape without a unit.

    ipctk evaluates -(s - s^)^2 ln(s / s^) and is called with squared distances, as its potentials
    do.
    """
    oracle = ipctk.ClampedLogBarrier()
    s = np.asarray(_squared(FRACTIONS)) - THICKNESS**2
    mine = barrier_derivatives(_squared(FRACTIONS), SETTINGS)
    functions = (oracle, oracle.first_derivative, oracle.second_derivative)
    for order, (function, values) in enumerate(zip(functions, mine, strict=True)):
        expected = np.array([function(d, REACH) for d in s]) / REACH**2
        # At the far end every order is a power of (1 - z), which rounding of z changes.
        near_end = CANCELLATION / np.maximum(abs(1.0 - FRACTIONS), 1e-9)
        relative = 1e-13 + 3.0 * (near_end + CANCELLATION / FRACTIONS)
        error = abs(np.asarray(values) - expected)
        assert np.all(error <= relative * abs(expected)), (order, error / abs(expected))


def test_twice_continuously_differentiable_at_dhat():
    """Value, slope and curvature vanish as (1 - z)^3, (1 - z)^2 and 1 - z."""
    for eps in (1e-2, 1e-3, 1e-4):
        inside = barrier_derivatives(_squared([1.0 - eps]), SETTINGS)
        assert abs(inside.value[0]) < 1.1 * eps**3
        assert abs(inside.first[0]) * REACH < 3.3 * eps**2
        assert abs(inside.second[0]) * REACH**2 < 6.6 * eps
    end = barrier_derivatives(jnp.asarray([(DHAT + THICKNESS) ** 2 * (1.0 + 1e-12)]), SETTINGS)
    assert all(float(member[0]) == 0.0 for member in end)


def test_infinite_at_and_below_the_thickness():
    below = jnp.asarray([THICKNESS**2, 0.5 * THICKNESS**2, 0.0])
    np.testing.assert_array_equal(barrier(below, SETTINGS), np.inf)
    np.testing.assert_array_equal(barrier_derivatives(below, SETTINGS).value, np.inf)
    near = barrier(_squared([1e-3, 1e-6, 1e-9]), SETTINGS)
    assert np.all(np.diff(near) > 0.0) and float(near[-1]) > 20.0  # -ln(1e-9) = 20.7


def test_decreasing_and_convex():
    value = np.asarray(barrier(_squared(np.linspace(1e-4, 1.2, 400)), SETTINGS))
    assert np.all(np.diff(value) <= 0.0) and np.all(np.diff(value, 2) >= -1e-15)


@pytest.mark.parametrize("thickness", [0.0, 1e-4])
def test_shape_depends_on_the_fraction_only(thickness):
    """With or without thickness, in any unit."""
    settings = contact_settings(dhat=0.5, thickness=100.0 * thickness)
    reach = 0.5**2 + 2.0 * 0.5 * 100.0 * thickness
    z = np.linspace(0.1, 0.9, 5)
    value = barrier(jnp.asarray((100.0 * thickness) ** 2 + z * reach), settings)
    np.testing.assert_allclose(value, -((z - 1.0) ** 2) * np.log(z), rtol=1e-13)
