"""The nearest point of a triangle mesh, exactly (host)."""

from typing import NamedTuple

import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

_FIRST_NEIGHBOURS = 8


class Nearest(NamedTuple):
    """Where points are nearest to a surface.

    Attributes:
        distance: [m], (s,).
        triangle: number of the nearest triangle, (s,).
        point: the nearest point on it [m], (s, 3).
    """

    distance: Float[np.ndarray, " s"]
    triangle: Int[np.ndarray, " s"]
    point: Float[np.ndarray, "s 3"]


def nearest_on_surface(
    points: Float[np.ndarray, "s 3"], triangles: Float[np.ndarray, "f 3 3"]
) -> Nearest:
    """The nearest point of some triangles to every point.

    Triangles are tried in the order of their centroids. A triangle whose centroid is farther than
    the best distance plus the largest circumradius about a centroid cannot be nearer, so the search
    stops there; points that have not got that far try twice as many.

    Args:
        points: [m], shape (s, 3).
        triangles: corners [m], shape (f, 3, 3), at least one.
    """
    centroids = triangles.mean(axis=1)
    radius = np.linalg.norm(triangles - centroids[:, None], axis=2).max()
    tree = cKDTree(centroids)
    best = np.full(len(points), np.inf)
    chosen, closest = np.zeros(len(points), dtype=np.int64), np.zeros((len(points), 3))
    open_points = np.arange(len(points))
    count, done = min(_FIRST_NEIGHBOURS, len(triangles)), 0
    while len(open_points):
        reach, index = tree.query(points[open_points], k=count)
        reach, index = np.reshape(reach, (-1, count)), np.reshape(index, (-1, count))
        fresh = index[:, done:]
        repeated = np.repeat(points[open_points], fresh.shape[1], axis=0)
        found = trimesh.triangles.closest_point(triangles[fresh.reshape(-1)], repeated)
        distance = np.linalg.norm(found - repeated, axis=1).reshape(fresh.shape)
        every = np.arange(len(open_points))
        first = distance.argmin(axis=1)
        nearer = distance[every, first] < best[open_points]
        own = open_points[nearer]
        best[own] = distance[every, first][nearer]
        chosen[own] = fresh[every, first][nearer]
        closest[own] = found.reshape(*fresh.shape, 3)[every, first][nearer]
        if count == len(triangles):
            break
        open_points = open_points[reach[:, -1] <= best[open_points] + radius]
        count, done = min(2 * count, len(triangles)), count
    return Nearest(best, chosen, closest)


def barycentric(
    points: Float[np.ndarray, "s 3"], triangles: Float[np.ndarray, "s 3 3"]
) -> Float[np.ndarray, "s 3"]:
    """Barycentric coordinates of points in the planes of their triangles."""
    return trimesh.triangles.points_to_barycentric(triangles, points)
