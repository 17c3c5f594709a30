"""Closed outlines in the plane: area and self-crossings (host)."""

import numpy as np
import shapely
from jaxtyping import Float, Int


def signed_area(points: Float[np.ndarray, "n 2"]) -> float:
    """Area enclosed by a closed outline, positive when it runs counter-clockwise."""
    x, y = (points - points[0]).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def self_crossings(points: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, "k 2"]:
    """Pairs of segments of a closed outline that touch where they should not.

    Segment i runs from point i to point i + 1. Neighbours may share their common point only; a
    segment that folds back onto its neighbour counts as a crossing.

    Args:
        points: corners of the outline without repeating the first one, shape (n, 2).

    Returns:
        Segment pairs (i < j), shape (k, 2); empty for a simple outline.
    """
    count = len(points)
    ring = shapely.LinearRing(points)
    if ring.is_simple:
        return np.zeros((0, 2), dtype=int)
    ends = np.stack([points, np.roll(points, -1, axis=0)], axis=1)
    segments = np.asarray(shapely.linestrings(ends))
    i, j = shapely.STRtree(segments).query(segments, predicate="intersects")
    i, j = i[i < j], j[i < j]
    gap = (j - i) % count
    neighbours = (gap == 1) | (gap == count - 1)
    shared = shapely.intersection(segments[i], segments[j])
    folded = neighbours & (shapely.length(shared) > 0)
    if count == 3:
        folded[:] = True
    keep = ~neighbours | folded
    return np.stack([i[keep], j[keep]], axis=1)
