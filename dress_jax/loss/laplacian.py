"""How wrinkled a draped garment is (checklist S11.6)."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from dress_jax.geometry.topology import boundary_vertices


def interior_vertices(faces: Int[np.ndarray, "f 3"], count: int) -> Bool[np.ndarray, " n"]:
    """Whether each of `count` vertices lies inside the surface, off its boundary (host)."""
    interior = np.zeros(count, dtype=bool)
    interior[np.asarray(faces).ravel()] = True
    interior[boundary_vertices(faces)] = False
    return interior


def laplacian(
    positions: Float[Array, "n 3"],
    rest_positions: Float[Array, "p 2"],
    faces: Int[Array, "3 f"],
    rest_faces: Int[Array, "3 f"],
    interior: Bool[np.ndarray, " n"],
) -> Float[Array, ""]:
    """The L2 norm of the Laplacian of the drape: sqrt(sum_i |sum_j w_ij (x_j - x_i)|^2 / A_i).

    w are half the cotangents of the pattern's triangles and A_i a third of the area around vertex
    i, so Dx is the Laplacian over the cloth, and A |Dx|^2 its integral: flat cloth, strained evenly
    or not at all, costs nothing. On the boundary the sum is no Laplacian; those vertices are left
    out.

    Args:
        positions: draped vertices [m], shape (n, 3).
        rest_positions: panel vertices in panel coordinates [m], shape (p, 2).
        faces: vertices of each triangle, shape (3, f).
        rest_faces: panel vertices of each triangle, shape (3, f).
        interior: from `interior_vertices`, shape (n,).

    Returns:
        The norm, without unit.
    """
    corners = [rest_positions[rest_faces[k]] for k in range(3)]
    u, v = corners[1] - corners[0], corners[2] - corners[0]
    doubled = jnp.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    count = positions.shape[0]
    total = jnp.zeros_like(positions)
    area = jnp.zeros(count)
    for k in range(3):
        i, j = faces[(k + 1) % 3], faces[(k + 2) % 3]
        to_i, to_j = corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]
        # Half the cotangent at corner k, the weight of the opposite edge.
        weight = 0.5 * jnp.sum(to_i * to_j, axis=1) / doubled
        pull = weight[:, None] * (positions[j] - positions[i])
        total = total + jax.ops.segment_sum(pull, i, num_segments=count)
        total = total - jax.ops.segment_sum(pull, j, num_segments=count)
        area = area + jax.ops.segment_sum(doubled / 6.0, faces[k], num_segments=count)
    inside = jnp.asarray(interior)
    density = jnp.sum(total**2, axis=1) / jnp.where(inside, area, 1.0)
    integral = jnp.sum(jnp.where(inside, density, 0.0))
    bent = integral > 0.0
    return jnp.where(bent, jnp.sqrt(jnp.where(bent, integral, 1.0)), 0.0)
