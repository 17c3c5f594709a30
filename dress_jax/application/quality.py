"""What a draped garment is judged by: exact counts from positions alone, apart from the solver."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from dress_jax.energy.gathers import find_gathers, gathered_triangles
from dress_jax.energy.membrane import principal_stretches
from dress_jax.geometry.intersection import count_intersections, minimum_distance
from dress_jax.io.results import DrapedState


def seam_gaps(state: DrapedState) -> Float[np.ndarray, " s"]:
    """Distance between the two sides of every sewn pair of panel vertices [m]; zero if welded."""
    first, second = (
        state.garment.vertices[state.weld_map[state.seam_vertices[:, k]]] for k in range(2)
    )
    return np.linalg.norm(first - second, axis=1)


def strains(state: DrapedState) -> Float[np.ndarray, " f"]:
    """The larger |stretch - 1| of the two principal stretches of every triangle.

    Of gathers only what their folds do not take up (`energy.gathers`).
    """
    garment = state.garment
    rest = gathered_triangles(
        jnp.asarray(garment.rest_positions),
        jnp.asarray(garment.rest_faces.T),
        find_gathers(garment.faces, garment.rest_faces, garment.rest_positions),
    )
    stretches = principal_stretches(
        jnp.asarray(garment.vertices), jnp.asarray(garment.faces.T), rest
    )
    return np.max(np.abs(np.stack([np.asarray(s) for s in stretches]) - 1.0), axis=0)


def drape_quality(state: DrapedState) -> dict[str, Any]:
    """Counts, gaps, intersections, distance and strains of a draped garment.

    Args:
        state: the garment and the body.

    Returns:
        Plain values by the names that `report.json` uses.
    """
    garment = state.garment
    body = (state.body_vertices, state.body_faces) if len(state.body_faces) else (None, None)
    crossings = count_intersections(garment.vertices, garment.faces, *body)
    strain = strains(state)
    return {
        "vertices": len(garment.vertices),
        "faces": len(garment.faces),
        "panels": len(garment.panels),
        "seams": len(state.seam_offset) - 1,
        "max_seam_gap_m": float(np.max(seam_gaps(state), initial=0.0)),
        "intersections": {"self": crossings.self, "body": crossings.body},
        "min_distance_m": minimum_distance(garment.vertices, garment.faces, *body),
        "max_strain": float(strain.max()),
        "median_strain": float(np.median(strain)),
        "strain_p99": float(np.quantile(strain, 0.99)),
    }
