"""What a draped garment is judged by: exact counts from positions alone, apart from the solver."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from dress_jax.energy.stretching import mesh_stretches
from dress_jax.geometry.intersection import count_intersections, minimum_distance
from dress_jax.io.results import DrapedState


def seam_gaps(state: DrapedState) -> Float[np.ndarray, " s"]:
    """Distance between the two sides of every sewn pair of panel vertices [m]; zero if welded."""
    first, second = (
        state.garment.vertices[state.weld_map[state.seam_vertices[:, k]]] for k in range(2)
    )
    return np.linalg.norm(first - second, axis=1)


# Stretch of the median triangle of a panel beyond which the panel is too small for the body.
TIGHT = 1.2


def tight_panels(
    stretches: Float[np.ndarray, "2 f"], face_panels: Int[np.ndarray, " f"], names: Sequence[str]
) -> dict[str, float]:
    """Panels that are stretched as a whole, and by how much their median triangle is.

    A sound drape of a garment that is too small for its wearer is strained; it is the pattern that
    is at fault, or the body, and here is where.

    Args:
        stretches: from `energy.stretching.mesh_stretches`.
        face_panels: panel of each triangle.
        names: of the panels.
    """
    medians = {
        name: float(np.median(stretches[0][face_panels == number]))
        for number, name in enumerate(names)
        if np.any(face_panels == number)
    }
    return {name: stretch for name, stretch in medians.items() if stretch > TIGHT}


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
    stretches = mesh_stretches(
        garment.vertices, garment.faces, garment.rest_positions, garment.rest_faces
    )
    strain = np.max(np.abs(stretches - 1.0), axis=0)
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
        "tight_panels": tight_panels(stretches, garment.face_panels, garment.panels),
    }
