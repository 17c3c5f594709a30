import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.solver.linear.dense import definite_inverse, lower_inverse

# Of the entries of the product with the inverse; condition numbers are below 1,000.
TOLERANCE = 1e-12
SIZES = pytest.mark.parametrize("size", [1, 16, 17, 18, 35, 96])


def _matrices(size: int) -> np.ndarray:
    rows = np.random.default_rng(size).normal(size=(3, size, size))
    return np.matmul(rows, rows.transpose(0, 2, 1)) / size + np.eye(size)


@SIZES
def test_lower_inverse_against_its_definition(size):
    lower = np.linalg.cholesky(_matrices(size))
    inverse = np.asarray(lower_inverse(jnp.asarray(lower)))
    product = np.matmul(inverse, lower)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(size), lower.shape), atol=TOLERANCE)
    assert not np.any(np.triu(inverse, 1))


@SIZES
def test_definite_inverse_against_its_definition(size):
    matrices = _matrices(size)
    inverse, sound = definite_inverse(jnp.asarray(matrices))
    assert bool(sound)
    product = np.matmul(np.asarray(inverse), matrices)
    np.testing.assert_allclose(
        product, np.broadcast_to(np.eye(size), product.shape), atol=TOLERANCE
    )
    np.testing.assert_array_equal(inverse, jnp.swapaxes(inverse, -1, -2))


@pytest.mark.parametrize("fault", [-1.0, 0.0, np.nan])
def test_one_matrix_that_is_not_definite_is_noticed(fault):
    matrices = _matrices(20)
    matrices[1, 7] = 0.0
    matrices[1, :, 7] = 0.0
    matrices[1, 7, 7] = fault
    _, sound = definite_inverse(jnp.asarray(matrices))
    assert not bool(sound)
