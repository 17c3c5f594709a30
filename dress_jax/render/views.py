"""Losses over many views with the memory of one."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def mean_over_views(
    loss: Callable[[Any, Any], Float[Array, ""]], operands: Any, views: Any
) -> Float[Array, ""]:
    """The mean over views of `loss(operands, view)`.

    The gradient with respect to `operands` is computed view by view along with the value and summed
    up, so that no view's images outlive it. Views are data and get no gradient.

    Args:
        loss: scalar loss of one view; a function that keeps its identity between calls, or every
            call compiles anew. Arrays that vary belong in `operands` or `views`.
        operands: pytree of what the loss depends on, such as meshes.
        views: pytree with a leading axis of views, such as stacked cameras and target images.

    Returns:
        The mean, shape ().
    """
    return _mean(loss, operands, views)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _mean(loss, operands, views):
    return jnp.mean(jax.lax.map(lambda view: loss(operands, view), views))


def _mean_forward(loss, operands, views):
    leaves, tree = jax.tree.flatten(operands)
    real = [jnp.issubdtype(jnp.result_type(leaf), jnp.floating) for leaf in leaves]

    def of_real(values, view):
        values = iter(values)
        merged = [next(values) if r else leaf for r, leaf in zip(real, leaves, strict=True)]
        return loss(jax.tree.unflatten(tree, merged), view)

    inputs = [jnp.asarray(leaf) for r, leaf in zip(real, leaves, strict=True) if r]

    def body(total, view):
        value, slopes = jax.value_and_grad(of_real)(inputs, view)
        return [t + s for t, s in zip(total, slopes, strict=True)], value

    total, values = jax.lax.scan(body, [jnp.zeros_like(i) for i in inputs], views)
    count = values.shape[0]
    return jnp.mean(values), ([t / count for t in total], operands, views)


def _mean_backward(loss, residuals, cotangent):
    del loss
    slopes, operands, views = residuals
    slopes = iter(slopes)

    def pull(leaf):
        if jnp.issubdtype(jnp.result_type(leaf), jnp.floating):
            slope = next(slopes)
            return cotangent.astype(slope.dtype) * slope
        return None

    leaves, tree = jax.tree.flatten(operands)
    del views
    return jax.tree.unflatten(tree, [pull(leaf) for leaf in leaves]), None


_mean.defvjp(_mean_forward, _mean_backward)
