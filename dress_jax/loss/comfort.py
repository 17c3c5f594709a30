"""How much a draped garment is strained (checklist S11.5)."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dress_jax.core import components as c
from dress_jax.energy.gathers import Gathers, gathered_triangles
from dress_jax.energy.membrane import MembraneModel, membrane_energy


def comfort(
    positions: Float[Array, "n 3"],
    rest_positions: Float[Array, "p 2"],
    faces: Int[Array, "3 f"],
    rest_faces: Int[Array, "3 f"],
    gathers: Gathers,
) -> Float[Array, ""]:
    """The integral of ||F - R(F)||^2 over the pattern, with R the rotation closest to F.

    A garment that is too small is stretched everywhere, so the term keeps patterns from shrinking.

    Args:
        positions: draped vertices [m], shape (n, 3).
        rest_positions: panel vertices in panel coordinates [m], shape (p, 2).
        faces: vertices of each triangle, shape (3, f).
        rest_faces: panel vertices of each triangle, shape (3, f).
        gathers: seam edges whose folds are no strain.

    Returns:
        The integral [m^2]; an ARAP energy with a stiffness of 1.
    """
    rest = gathered_triangles(rest_positions, rest_faces, gathers)
    one = jnp.ones((), positions.dtype)
    return membrane_energy(c.split(positions), faces, rest, one, one, MembraneModel.ARAP)
