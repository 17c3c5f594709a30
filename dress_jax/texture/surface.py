"""The draped garment as the panels' own surface: every panel vertex with its place in space.

Texture coordinates may jump at a seam, so everything here is indexed by panel vertices; the welded
vertices only lend their positions and normals (S14.4).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from dress_jax.geometry.topology import connected_components


@dataclasses.dataclass(frozen=True)
class PanelSurface:
    """A draped garment in panel vertices.

    Attributes:
        positions: in space [m], shape (p, 3).
        normals: smooth over seams, unit length, on the side from which faces run counter-clockwise,
            shape (p, 3).
        coordinates: on the flat panel [m], shape (p, 2); +y is the grain.
        faces: shape (f, 3).
        face_panels: panel of each face, shape (f,).
        vertex_panels: panel of each panel vertex, shape (p,); 0 where no face names it.
        panels: their names.
        panel_components: garment of an outfit that each panel belongs to, shape (panels,).
        components: names of the garments, from the top down.
    """

    positions: Float[np.ndarray, "p 3"]
    normals: Float[np.ndarray, "p 3"]
    coordinates: Float[np.ndarray, "p 2"]
    faces: Int[np.ndarray, "f 3"]
    face_panels: Int[np.ndarray, " f"]
    vertex_panels: Int[np.ndarray, " p"]
    panels: tuple[str, ...]
    panel_components: Int[np.ndarray, " panels"]
    components: tuple[str, ...]


def make_panel_surface(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    rest_positions: Float[np.ndarray, "p 2"],
    rest_faces: Int[np.ndarray, "f 3"],
    panels: Sequence[str],
    face_panels: Int[np.ndarray, " f"],
) -> PanelSurface:
    """The surface of a welded garment with flat panels.

    Args:
        vertices: draped positions [m], shape (n, 3).
        faces: triangles in vertices, shape (f, 3).
        rest_positions: panel coordinates [m], shape (p, 2).
        rest_faces: the same triangles in panel vertices, shape (f, 3).
        panels: their names.
        face_panels: panel of each triangle, shape (f,).

    Raises:
        ValueError: there is no face, or the arrays do not agree.
    """
    faces, rest_faces = np.asarray(faces), np.asarray(rest_faces)
    if not len(faces) or faces.shape != rest_faces.shape or len(face_panels) != len(faces):
        raise ValueError(
            f"faces {faces.shape}, rest faces {rest_faces.shape} and {len(face_panels)} face panels"
        )
    weld = np.zeros(len(rest_positions), np.int64)
    weld[rest_faces] = faces
    vertex_panels = np.zeros(len(rest_positions), np.int64)
    vertex_panels[rest_faces] = np.asarray(face_panels)[:, None]
    label = connected_components(faces, len(vertices))
    members = np.zeros(len(panels), np.int64)
    members[face_panels] = label[faces[:, 0]]
    # Only labels that a face has; from the top down, as the masks of an outfit are named.
    used = np.unique(label[faces[:, 0]])
    used = used[np.argsort([-vertices[label == k, 1].mean() for k in used], kind="stable")]
    order = {int(k): place for place, k in enumerate(used)}
    one = len(used) == 1
    return PanelSurface(
        positions=np.asarray(vertices, np.float64)[weld],
        normals=_normals(np.asarray(vertices, np.float64), faces)[weld],
        coordinates=np.asarray(rest_positions, np.float64),
        faces=rest_faces,
        face_panels=np.asarray(face_panels),
        vertex_panels=vertex_panels,
        panels=tuple(panels),
        panel_components=np.array([order.get(int(k), 0) for k in members]),
        components=("garment",) if one else tuple(f"garment-{k + 1}" for k in range(len(used))),
    )


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted; zero at vertices without a face."""
    corner = vertices[faces]
    doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(total, faces[:, k], doubled)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 0.0)
