"""First vertex colours C_H: what the pictures show where the body is drawn (S7.8)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from dress_jax.core.pytree import replace
from dress_jax.reconstruction.losses import PaintedBody, draw
from dress_jax.reconstruction.views import BodyViews

_ENOUGH = 0.1  # pixels in all views together; fewer tell nothing about a vertex


@jax.jit
def seen_colors(body: PaintedBody, views: BodyViews) -> Float[Array, "n 3"]:
    """The mean colour of the pixels that each vertex is drawn in, hidden ones left out.

    A picture is linear in the vertex colours, so the transpose of drawing lays pixels back on the
    vertices; the same of ones gives the weights. Vertices that no view shows take the mean colour.

    Args:
        body: the body where it is seen; its colours are not used.
        views: with masks and colours.
    """
    black = jnp.zeros(3, jnp.float32)

    def add(totals, view):
        def painted(colors):
            return draw(view.cameras, replace(body, colors=colors), black)[1]

        _, transpose = jax.vjp(painted, jnp.zeros(body.colors.shape, jnp.float32))
        counted = (view.visible * view.mask)[:, :, None] * jnp.ones(3, jnp.float32)[None, None, :]
        (value,), (weight,) = transpose(counted * view.color), transpose(counted)
        return (totals[0] + value, totals[1] + weight), None

    empty = jnp.zeros(body.colors.shape, jnp.float32)
    (value, weight), _ = jax.lax.scan(add, (empty, empty), per_view(views))
    # Blending at outlines takes colour away from vertices too, so weights may fall below zero.
    seen = weight > _ENOUGH
    value, weight = jnp.where(seen, value, 0.0), jnp.where(seen, weight, 0.0)
    total = jnp.sum(weight, axis=0)
    mean = jnp.where(total > 0.0, jnp.sum(value, axis=0) / jnp.where(total > 0.0, total, 1.0), 0.5)
    own = value / jnp.where(seen, weight, 1.0)
    return jnp.clip(jnp.where(seen, own, mean[None, :]), 0.0, 1.0)


def per_view(views: BodyViews) -> BodyViews:
    """Views with a leading axis on every array."""
    count = views.landmarks.shape[0]
    repeated = jnp.broadcast_to(views.background[None, :], (count, 3))
    return replace(views, background=repeated)
