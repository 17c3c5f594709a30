"""Seams whose two sides differ in length (checklist S11.7)."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.pattern.parameters import EdgeTable, PatternParameters, edge_lengths


def seam_length(
    parameters: PatternParameters,
    edges: EdgeTable,
    stitch_edges: Int[np.ndarray, "stitches 2"],
    *,
    ratio: Float[Array, "stitches"] | None = None,
    smoothing: float = 0.0,
) -> Float[Array, ""]:
    """Mean difference in length between the sides of a seam: 1/N_S sum |L_i - r L_j|.

    The paper's lengths are Riemann sums over finite-difference tangents; these are the same
    integrals by Gauss-Legendre quadrature.

    Args:
        parameters: the pattern's parameters.
        edges: its edge table.
        stitch_edges: the two edges of each stitch, shape (stitches, 2).
        ratio: wanted ratio r of the first side's length to the second's, shape (stitches,);
            1 where absent. Pass `seam_ratios` of the design to keep its gathers.
        smoothing: differences d well below this length s [m] count as d^2 / 2s, larger ones as
            |d| - s. A design begins with d = 0 up to rounding, where |d| has no derivative and
            its sign is noise.

    Returns:
        The mean [m]; 0 for a pattern without stitches.
    """
    if stitch_edges.shape[0] == 0:
        return jnp.zeros(())
    lengths = edge_lengths(parameters, edges)
    first, second = lengths[stitch_edges[:, 0]], lengths[stitch_edges[:, 1]]
    wanted = second if ratio is None else ratio * second
    difference = jnp.abs(first - wanted)
    if smoothing > 0.0:
        difference = jnp.sqrt(difference**2 + smoothing**2) - smoothing
    return jnp.mean(difference)


def seam_ratios(
    parameters: PatternParameters,
    edges: EdgeTable,
    stitch_edges: Int[np.ndarray, "stitches 2"],
) -> Float[Array, "stitches"]:
    """Length of each stitch's first side over its second's, shape (stitches,)."""
    lengths = edge_lengths(parameters, edges)
    return lengths[stitch_edges[:, 0]] / lengths[stitch_edges[:, 1]]
