"""Panels that change their share of the garment's area (checklist S11.1)."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int


def panel_areas(
    rest_positions: Float[Array, "P 2"],
    rest_faces: Int[np.ndarray, "F 3"],
    face_panel: Int[np.ndarray, "F"],
    panel_count: int,
) -> Float[Array, "panels"]:
    """Area of every panel [m^2], shape (panels,); signs of clockwise panels are removed.

    Args:
        rest_positions: panel vertices in panel coordinates [m], shape (P, 2).
        rest_faces: triangles in panel vertices, one turning direction per panel, shape (F, 3).
        face_panel: panel of each triangle, shape (F,).
        panel_count: number of panels.
    """
    a, b, c = (rest_positions[rest_faces[:, i]] for i in range(3))
    u, v = b - a, c - a
    doubled = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return 0.5 * jnp.abs(jax.ops.segment_sum(doubled, face_panel, num_segments=panel_count))


def area_ratio(
    rest_positions: Float[Array, "P 2"],
    rest_faces: Int[np.ndarray, "F 3"],
    face_panel: Int[np.ndarray, "F"],
    component: Int[np.ndarray, "panels"],
    reference_areas: Float[Array, "panels"],
) -> Float[Array, ""]:
    """1/N_P sum (A_p(X) / A_p(X0) - 1)^2 of each panel's share A_p of its component's area.

    Args:
        rest_positions: panel vertices in panel coordinates [m], shape (P, 2).
        rest_faces: triangles in panel vertices, shape (F, 3).
        face_panel: panel of each triangle, shape (F,).
        component: component of each panel (`pattern.components`), shape (panels,).
        reference_areas: areas of the panels in the reference design [m^2], shape (panels,).

    Returns:
        The mean, without unit; unchanged when a whole component is scaled.
    """
    panel_count = component.shape[0]
    areas = panel_areas(rest_positions, rest_faces, face_panel, panel_count)
    share = areas / _component_areas(areas, component)
    wanted = reference_areas / _component_areas(reference_areas, component)
    return jnp.mean((share / wanted - 1.0) ** 2)


def _component_areas(
    areas: Float[Array, "panels"], component: Int[np.ndarray, "panels"]
) -> Float[Array, "panels"]:
    """Area of the component that each panel belongs to, shape (panels,)."""
    total = jax.ops.segment_sum(areas, component, num_segments=component.shape[0])
    return total[component]
