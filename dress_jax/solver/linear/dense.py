"""Inverses of many small or one larger dense positive-definite matrix, in JAX."""

import math

import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Bool, Float

_BASE = 17  # rows that are left to back-substitution


def definite_inverse(
    matrices: Float[Array, "k m m"],
) -> tuple[Float[Array, "k m m"], Bool[Array, ""]]:
    """The inverses of symmetric matrices, exactly symmetric, by their Cholesky factors.

    Returns:
        The inverses, and whether all matrices are positive definite.
    """
    lower = jnp.linalg.cholesky(matrices, symmetrize_input=False)
    half = lower_inverse(lower)
    inverse = jnp.matmul(jnp.swapaxes(half, -1, -2), half)
    # Where a Cholesky factorization fails it leaves entries that are not numbers.
    return inverse, jnp.all(jnp.isfinite(lower)) & jnp.all(jnp.isfinite(inverse))


def lower_inverse(lower: Float[Array, "k m m"]) -> Float[Array, "k m m"]:
    """The inverses of lower triangular matrices.

    By halves: the lower left block of the inverse of [[A, 0], [C, B]] is -B^-1 C A^-1. So most of
    the work is products, which CPU and GPU do well; a back-substitution with many columns is slow
    on a GPU, and on a CPU the threads of one library wait for each other in every small matrix.
    """
    count, size = lower.shape[0], lower.shape[-1]
    levels = max(0, math.ceil(math.log2(size / _BASE)))
    base = -(-size // 2**levels)
    rest = base * 2**levels - size
    padded = jnp.pad(lower, ((0, 0), (0, rest), (0, rest)))
    padded = padded + jnp.diag(jnp.where(jnp.arange(size + rest) < size, 0.0, 1.0))[None]
    blocks = _diagonal_blocks(padded, base).reshape(-1, base, base)
    identity = jnp.broadcast_to(jnp.eye(base), blocks.shape)
    inverse = solve_triangular(blocks, identity, lower=True).reshape(count, -1, base, base)
    for level in range(levels):
        half = base * 2**level
        below = _diagonal_blocks(padded, 2 * half)[:, :, half:, :half]
        first, second = inverse[:, 0::2], inverse[:, 1::2]
        corner = -jnp.matmul(second, jnp.matmul(below, first))
        upper = jnp.concatenate([first, jnp.zeros_like(first)], axis=-1)
        inverse = jnp.concatenate([upper, jnp.concatenate([corner, second], axis=-1)], axis=-2)
    return inverse[:, 0, :size, :size]


def _diagonal_blocks(
    matrices: Float[Array, "k m m"], size: int
) -> Float[Array, "k blocks size size"]:
    count = matrices.shape[-1] // size
    split = matrices.reshape(-1, count, size, count, size)
    return jnp.moveaxis(jnp.diagonal(split, axis1=1, axis2=3), -1, 1)
