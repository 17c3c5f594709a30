"""Seams whose curves change (checklist S11.8)."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.pattern.parameters import EdgeTable, PatternParameters


def seam_curvature(
    parameters: PatternParameters,
    reference: PatternParameters,
    edges: EdgeTable,
    stitch_edges: Int[np.ndarray, "stitches 2"],
    *,
    smoothing: float = 0.0,
) -> Float[Array, ""]:
    """1/(2 N_S) sum |K_i - K_i0| + |K_j - K_j0| of sewn edges' controls in their chord frames.

    Args:
        parameters: the pattern's parameters.
        reference: of the initial design, also after remeshing (S21.11).
        edges: the edge table.
        stitch_edges: the two edges of each stitch, shape (stitches, 2).
        smoothing: distances d well below this one s [chord lengths] count as d^2 / 2s, larger ones
            as d - s: the design begins with d = 0, where d has no derivative.

    Returns:
        The mean [chord lengths]; 0 for a pattern without stitches.
    """
    if stitch_edges.shape[0] == 0:
        return jnp.zeros(())
    squared = jnp.sum((parameters.controls - reference.controls) ** 2, axis=1)
    sewn = stitch_edges.reshape(-1)
    first, last = edges.controls[sewn, 0], edges.controls[sewn, 1]
    # A cubic has two rows, every other edge one.
    squared = squared[first] + jnp.where(last > first, squared[last], 0.0)
    if smoothing > 0.0:
        return jnp.mean(jnp.sqrt(squared + smoothing**2) - smoothing)
    moved = squared > 0.0
    return jnp.mean(jnp.where(moved, jnp.sqrt(jnp.where(moved, squared, 1.0)), 0.0))
