"""Distances between a garment and a scan of it, linearized. Host, numpy.

A point of the scan pulls the nearest point of the garment straight toward itself: across the cloth
where it lies over it, along the cloth where it lies beyond its edge.
"""

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from dress_jax.geometry.nearest import barycentric, nearest_on_surface
from dress_jax.optimisation.gauss_newton.outline import Rows
from dress_jax.optimisation.scan import Scan

_TOUCHING = 1e-9  # [m]; a distance below it has no direction


def scan_rows(
    scan: Scan, positions: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "f 3"]
) -> Rows:
    """Distances with their derivatives in the positions; the mean is over points.

    Args:
        scan: what the garment is compared with.
        positions: of the garment [m].
        faces: its triangles.
    """
    found = nearest_on_surface(scan.points, positions[faces])
    corners = faces[found.triangle]
    parts = [
        _rows(
            scan.points - found.point,
            found.distance,
            corners,
            barycentric(found.point, positions[corners]),
            _face_normals(positions[corners]),
            len(positions),
        )
    ]
    if scan.complete:
        used = np.unique(faces)
        distance, nearest = cKDTree(scan.points).query(positions[used])
        parts.append(
            _rows(
                scan.points[nearest] - positions[used],
                distance,
                used[:, None],
                np.ones((len(used), 1)),
                np.tile([0.0, 0.0, 1.0], (len(used), 1)),
                len(positions),
            )
        )
    share = 1.0 / len(parts)
    return Rows(
        np.concatenate([residual for residual, _ in parts]),
        scipy.sparse.csr_array(scipy.sparse.vstack([jacobian for _, jacobian in parts])),
        np.concatenate([np.full(len(r), share / len(r)) for r, _ in parts]),
    )


def _rows(
    way: Float[np.ndarray, "m 3"],
    distance: Float[np.ndarray, " m"],
    vertices: Int[np.ndarray, "m k"],
    weights: Float[np.ndarray, "m k"],
    otherwise: Float[np.ndarray, "m 3"],
    count: int,
) -> tuple[Float[np.ndarray, " m"], scipy.sparse.csr_array]:
    """Distances, which shrink as weighted vertices move along the way."""
    apart = distance > _TOUCHING
    direction = np.where(apart[:, None], way / np.where(apart, distance, 1.0)[:, None], otherwise)
    entries = -weights[:, :, None] * direction[:, None, :]
    rows = np.broadcast_to(np.arange(len(way))[:, None, None], entries.shape)
    columns = 3 * vertices[:, :, None] + np.arange(3)
    shape = (len(way), 3 * count)
    jacobian = scipy.sparse.coo_array(
        (entries.ravel(), (rows.ravel(), np.broadcast_to(columns, entries.shape).ravel())),
        shape=shape,
    )
    return distance, jacobian.tocsr()


def _face_normals(triangles: Float[np.ndarray, "m 3 3"]) -> Float[np.ndarray, "m 3"]:
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return normal / np.where(length > 0.0, length, 1.0)
