"""From one mesh of a pattern's panels to another (host)."""

import numpy as np
import scipy.sparse
import scipy.spatial
from jaxtyping import Float, Int

from dress_jax.pattern.discretization import Discretization

_CANDIDATES = 16  # triangles around a point that are tried
_FLAT = 1e-300


def vertex_transfer(
    old: Discretization,
    old_rest: Float[np.ndarray, "P 2"],
    new: Discretization,
    new_rest: Float[np.ndarray, "Q 2"],
) -> scipy.sparse.csr_array:
    """Weights that give values at welded vertices of a new mesh from those of an old one.

    Every panel vertex is looked up in the old mesh of its panel; beside the outline, where two
    polygons follow a curve differently, the nearest point counts. A welded vertex takes the mean of
    its panel vertices.

    Args:
        old, new: meshes of the same panels.
        old_rest, new_rest: their panel vertices in the same panel coordinates [m].

    Returns:
        The weights, shape (N new, N old); rows sum to 1.
    """
    owners, new_owners = np.asarray(old.face_panel), np.asarray(new.panel_of_vertex)
    faces = np.asarray(old.rest_faces)
    corners = np.zeros((len(new_rest), 3), dtype=np.int64)
    weights = np.zeros((len(new_rest), 3))
    for panel in range(new.panel_count):
        points = np.flatnonzero(new_owners == panel)
        corners[points], weights[points] = _located(
            new_rest[points], old_rest, faces[owners == panel]
        )
    weld_old, weld_new = np.asarray(old.weld_map), np.asarray(new.weld_map)
    copies = np.bincount(weld_new, minlength=new.vertex_count)
    rows = np.repeat(weld_new, 3)
    values = weights.ravel() / copies[rows]
    shape = (new.vertex_count, old.vertex_count)
    return scipy.sparse.coo_array((values, (rows, weld_old[corners.ravel()])), shape=shape).tocsr()


def _located(
    points: Float[np.ndarray, "n 2"],
    vertices: Float[np.ndarray, "P 2"],
    faces: Int[np.ndarray, "f 3"],
) -> tuple[Int[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """The triangle of each point, and its barycentric coordinates, clipped to the triangle."""
    triangles = vertices[faces]
    count = min(_CANDIDATES, len(faces))
    _, near = scipy.spatial.cKDTree(triangles.mean(axis=1)).query(points, k=count)
    near = near.reshape(len(points), count)
    a, b, c = (triangles[near, k] for k in range(3))
    u, v, w = b - a, c - a, points[:, None, :] - a

    def cross(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0]

    doubled = cross(u, v)
    doubled = np.where(np.abs(doubled) > _FLAT, doubled, _FLAT)
    second, third = cross(w, v) / doubled, cross(u, w) / doubled
    coordinates = np.stack([1.0 - second - third, second, third], axis=-1)
    chosen = np.argmax(coordinates.min(axis=-1), axis=1)
    every = np.arange(len(points))
    inside = np.clip(coordinates[every, chosen], 0.0, 1.0)
    return faces[near[every, chosen]], inside / inside.sum(axis=1, keepdims=True)
