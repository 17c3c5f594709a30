"""The connected garments of a pattern, bottom to top (S8.3, S8.4)."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from dress_jax.pattern import Discretization, components
from dress_jax.sim.dressing.joining import Surface


@dataclasses.dataclass(frozen=True)
class Component:
    """One connected garment.

    Attributes:
        surface: its triangles in vertices of its own, from 0.
        vertices: number of each of them in the whole outfit, (n,).
        panels: names.
    """

    surface: Surface
    vertices: Int[np.ndarray, " n"]
    face_panel: Int[np.ndarray, " f"]
    panels: tuple[str, ...]


def split_components(
    discretization: Discretization,
    rest_positions: Float[np.ndarray, "p 2"],
    placed: Float[np.ndarray, "p 3"],
) -> tuple[Component, ...]:
    """The connected garments of a pattern from the lowest to the highest.

    Args:
        discretization: of the pattern.
        rest_positions: panel coordinates [m].
        placed: panel vertices around the body [m].
    """
    faces = np.asarray(discretization.faces)
    rest_faces = np.asarray(discretization.rest_faces)
    face_panel = np.asarray(discretization.face_panel)
    weld = np.asarray(discretization.weld_map)
    label = components(discretization)
    found = []
    for number in range(int(label.max()) + 1):
        own = label[face_panel] == number
        vertices, compact = np.unique(faces[own], return_inverse=True)
        place = np.full(discretization.vertex_count, -1)
        place[vertices] = np.arange(len(vertices))
        surface = Surface(
            faces=compact.reshape(-1, 3).astype(np.int32),
            rest_faces=rest_faces[own],
            weld_map=place[weld],
            rest_positions=rest_positions,
            placed=placed,
            vertex_count=len(vertices),
            edge_length=discretization.edge_length,
        )
        names = tuple(
            name
            for name, owner in zip(discretization.panel_names, label, strict=True)
            if owner == number
        )
        found.append(Component(surface, vertices, face_panel[own], names))

    def height(component: Component) -> float:
        return float(placed[np.unique(component.surface.rest_faces), 1].mean())

    return tuple(sorted(found, key=height))
