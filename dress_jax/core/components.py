"""Vectors as tuples of component arrays.

XLA on CPU compiles arithmetic on one `(n,)` array per component an order of magnitude better than
on arrays with a trailing axis of size three, so stencil functions are written once on tuples: with
0-d components a stencil is a plain function of points, with `(n,)` components it is the kernel.
"""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

Components = tuple[Array, ...]


def split(rows: Float[Array, "n d"]) -> Components:
    """The columns of an array of row vectors, as components."""
    return tuple(rows[:, k] for k in range(rows.shape[1]))


def join(vector: Components) -> Float[Array, "n d"]:
    """Row vectors from components; the inverse of `split`."""
    return jnp.stack(vector, axis=1)


def gather(vector: Components, indices: Int[Array, " m"]) -> Components:
    """The components of the vectors with the given indices."""
    return tuple(component[indices] for component in vector)


def add(a: Components, b: Components) -> Components:
    """a + b."""
    return tuple(x + y for x, y in zip(a, b, strict=True))


def subtract(a: Components, b: Components) -> Components:
    """a - b."""
    return tuple(x - y for x, y in zip(a, b, strict=True))


def scale(factor: Array | float, a: Components) -> Components:
    """factor * a."""
    return tuple(factor * x for x in a)


def dot(a: Components, b: Components) -> Array:
    """The inner product."""
    total = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        total = total + x * y
    return total


def cross(a: Components, b: Components) -> Components:
    """The cross product of 3-vectors."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def combine(weights: Sequence[Array], vectors: Sequence[Components]) -> Components:
    """The weighted sum of vectors."""
    total = scale(weights[0], vectors[0])
    for weight, vector in zip(weights[1:], vectors[1:], strict=True):
        total = add(total, scale(weight, vector))
    return total
