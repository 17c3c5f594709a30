"""A miscompilation of jax 0.10.2 on CPU that would silently corrupt positions.

A jitted, vmapped product of one shared 3x3 matrix with many rows, followed by a reduction, returns
wrong rows from a certain size on. pyproject.toml excludes that version; this holds every other.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

# The first sizes at which 0.10.2 is wrong, in float64 and in float32.
FIRST_WRONG = {jnp.float64: 16_385, jnp.float32: 32_769}


def _check(dtype, reduction):
    """Small integers, so that every product and sum is exact and nothing needs a tolerance."""
    rng = np.random.default_rng(0)
    x = rng.integers(-30, 30, (FIRST_WRONG[dtype], 3))
    matrix = np.array([[2, 0, 1], [0, 1, 0], [-1, 0, 3]])
    shared = jnp.asarray(matrix, dtype)
    reduced = jax.jit(jax.vmap(lambda row: reduction(shared @ row)))(jnp.asarray(x, dtype))
    np.testing.assert_array_equal(np.asarray(reduced), [reduction(row) for row in x @ matrix.T])


@pytest.mark.parametrize("dtype", FIRST_WRONG, ids=["float64", "float32"])
def test_squared_norm_of_a_shared_matrix_times_rows(dtype):
    _check(dtype, lambda vector: (vector**2).sum())


def test_sum_of_a_shared_matrix_times_rows_in_float64():
    _check(jnp.float64, lambda vector: vector.sum())


@pytest.mark.xfail(
    reason="0.10.1 too: the plain sum in float32 returns wrong last rows from 32,769 rows on",
    strict=False,
)
def test_sum_of_a_shared_matrix_times_rows_in_float32():
    """A second case that the 0.10.1 release already gets wrong.

    The package multiplies no rows by a shared matrix under jit in float32: it works on components.
    """
    _check(jnp.float32, lambda vector: vector.sum())
