"""Derivatives of an energy against central differences, with two compiled programs only.

`jax.test_util.check_grads` to second order compiles several times as many.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np

# The programs run a few times on a few elements; compiling them is all the work.
UNOPTIMIZED = {"xla_backend_optimization_level": 0}


def check_energy_derivatives(energy, arguments, *, step: float, tolerance: float, seed: int = 0):
    """Check the gradient of an energy, and the derivative of the force in everything.

    Along random directions of all arguments together, which must not be zero.

    Args:
        energy: scalar function; its first argument are the positions.
        arguments: where to check, pytrees of float arrays.
        step: of the central differences, in the units of the arguments.
        tolerance: relative to the derivative's size; its error is the step squared times third
            derivatives, and rounding over the step.

    Returns:
        The gradient in every argument.
    """
    every = tuple(range(len(arguments)))
    with_gradient = jax.jit(jax.value_and_grad(energy, every), compiler_options=UNOPTIMIZED)

    @functools.partial(jax.jit, compiler_options=UNOPTIMIZED)
    def force_derivative(arguments, direction):
        return jax.jvp(lambda *a: jax.grad(energy)(*a), arguments, direction)[1]

    rng = np.random.default_rng(seed)
    # Strongly typed, so that moved arguments run the same program.
    arguments = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), tuple(arguments))
    _, gradient = with_gradient(*arguments)

    def along(tree, direction):
        parts = jax.tree.map(lambda a, b: float(jnp.vdot(a, b)), tree, direction)
        return sum(jax.tree.leaves(parts))

    # Each argument on its own, so that a large derivative in one hides nothing in another.
    for moved in every:
        direction = tuple(
            jax.tree.map(
                lambda leaf, on=k == moved: jnp.asarray(on * rng.normal(size=leaf.shape)), argument
            )
            for k, argument in enumerate(arguments)
        )

        def at(length, direction=direction):
            return with_gradient(
                *jax.tree.map(lambda leaf, d: leaf + length * d, arguments, direction)
            )

        (high, high_gradient), (low, low_gradient) = at(step), at(-step)
        first = along(gradient, direction)
        assert first != 0.0, f"no derivative in argument {moved}"
        difference = float(high - low) / (2.0 * step)
        np.testing.assert_allclose(
            first, difference, rtol=tolerance, err_msg=f"first order, argument {moved}"
        )
        second = force_derivative(arguments, direction)
        difference = (high_gradient[0] - low_gradient[0]) / (2.0 * step)
        scale = float(jnp.abs(second).max())
        assert scale != 0.0, f"no second derivative in argument {moved}"
        np.testing.assert_allclose(
            second,
            difference,
            rtol=0,
            atol=tolerance * scale,
            err_msg=f"second order, argument {moved}",
        )
    return gradient


def central_difference(function, size: float) -> float:
    """Fourth-order central difference of a scalar function at zero."""
    one, two = function(size) - function(-size), function(2 * size) - function(-2 * size)
    return float((8 * one - two) / (12 * size))


def check_slope(value, at, *, tolerance: float, step: float = 1e-6, seed: int = 2):
    """Check the gradient of a scalar function of a pytree along one random direction.

    Args:
        value: the function.
        at: where, a pytree of float arrays.
        tolerance: relative.
        step: of the central difference, in the units of the leaves.
    """
    rng = np.random.default_rng(seed)
    direction = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape)), at)
    products = jax.tree.map(lambda g, d: float(jnp.vdot(g, d)), jax.grad(value)(at), direction)
    slope = sum(jax.tree.leaves(products))
    assert abs(slope) > 1e-4

    def along(length):
        return value(jax.tree.map(lambda leaf, d: leaf + length * d, at, direction))

    np.testing.assert_allclose(slope, central_difference(along, step), rtol=tolerance)
