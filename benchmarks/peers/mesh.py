"""Topology and rest shape of a cloth, as a user of numpy would write them down."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int


@dataclasses.dataclass(frozen=True)
class Rest:
    """What the energies take from the rest shape.

    Attributes:
        inverse: inverse rest edge matrices [1/m], (f, 2, 2).
        areas: of the triangles [m^2], (f,).
        hinge_weights: e^2 / (A1 + A2), (h,).
        vertex_areas: a third of the triangles around each vertex [m^2], (n,).
    """

    inverse: Float[np.ndarray, "f 2 2"]
    areas: Float[np.ndarray, " f"]
    hinge_weights: Float[np.ndarray, " h"]
    vertex_areas: Float[np.ndarray, " n"]


def edges(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "e 2"]:
    """Every edge once."""
    pairs = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    return np.unique(np.sort(pairs, axis=1), axis=0).astype(np.int32)


def hinges(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "h 6"]:
    """Inner edges: [v0, v1, v2, v3, first face, second face].

    The triangles are (v0, v1, v2) and (v1, v0, v3).
    """
    start, end, far = faces.T.ravel(), faces[:, [1, 2, 0]].T.ravel(), faces[:, [2, 0, 1]].T.ravel()
    face = np.tile(np.arange(len(faces)), 3)
    key = start.astype(np.int64) * (faces.max() + 1) + end
    twin = end.astype(np.int64) * (faces.max() + 1) + start
    order = np.argsort(key)
    place = np.minimum(np.searchsorted(key[order], twin), len(key) - 1)
    other = order[place]
    inner = (key[other] == twin) & (start < end)
    rows = [start, end, far, far[other], face, face[other]]
    return np.stack([row[inner] for row in rows], axis=1).astype(np.int32)


def rest_shape(
    rest: Float[np.ndarray, "n 2"], faces: Int[np.ndarray, "f 3"], hinge: Int[np.ndarray, "h 6"]
) -> Rest:
    """Of a cloth without seams: one rest vertex for every vertex."""
    corners = rest[faces]
    matrix = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    areas = 0.5 * np.abs(np.linalg.det(matrix))
    length = np.linalg.norm(rest[hinge[:, 1]] - rest[hinge[:, 0]], axis=1)
    vertex_areas = np.bincount(faces.ravel(), np.repeat(areas / 3.0, 3), minlength=len(rest))
    return Rest(
        inverse=np.linalg.inv(matrix),
        areas=areas,
        hinge_weights=length**2 / (areas[hinge[:, 4]] + areas[hinge[:, 5]]),
        vertex_areas=vertex_areas,
    )


def body_areas(
    vertices: Float[np.ndarray, "b 3"], faces: Int[np.ndarray, "c 3"]
) -> Float[np.ndarray, " b"]:
    """A third of the triangles around each vertex [m^2]."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return np.bincount(faces.ravel(), np.repeat(areas / 3.0, 3), minlength=len(vertices))
