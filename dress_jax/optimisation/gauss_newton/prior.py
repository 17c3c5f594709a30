"""What is likely about a pattern before any image is seen. Host side, numpy.

Images leave directions of pattern space open: only the girth of a garment shows, and not how it is
shared between front and back; a short edge in a fold hardly shows at all. The prior decides there:
panels keep their shape up to a linear map, panels change alike, and seams keep their length
differences.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Quadratic(NamedTuple):
    """q -> (q - center)^T matrix (q - center) / 2."""

    center: Float[np.ndarray, " k"]
    matrix: Float[np.ndarray, "k k"]

    def value(self, at: Float[np.ndarray, " k"]) -> float:
        """The value."""
        way = at - self.center
        return float(0.5 * way @ self.matrix @ way)

    def gradient(self, at: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """The gradient."""
        return self.matrix @ (at - self.center)


def edge_strain_matrix(
    corners: Float[np.ndarray, "V 2"],
    edges: Int[np.ndarray, "E 2"],
    panels: Int[np.ndarray, " E"],
    *,
    shape_scale: float,
    size_scale: float,
) -> Float[np.ndarray, "V V"]:
    """Mean squared strain of edges, for either coordinate of the corners' displacements.

    The strain of an edge is the difference of its ends' displacements over its length. The part of
    it that no linear map of the panel explains counts in `shape_scale`, all of it in `size_scale`.
    So short edges keep their length and direction, whatever the image says about them.

    Args:
        corners: of the initial pattern [m].
        edges: corners of every edge.
        panels: panel of every edge.
        shape_scale, size_scale: strains that cost 1/2.
    """
    count = len(edges)
    difference = np.zeros((count, len(corners)))
    difference[np.arange(count), edges[:, 0]] = -1.0
    difference[np.arange(count), edges[:, 1]] = 1.0
    lengths = np.linalg.norm(difference @ corners, axis=1)
    strain = difference / lengths[:, None]
    matrix = np.zeros((len(corners), len(corners)))
    for panel in np.unique(panels):
        own = strain[panels == panel]
        linear = own @ corners  # strains under the maps x -> (x, 0) and x -> (y, 0)
        rest = own - linear @ (np.linalg.pinv(linear) @ own)
        matrix += rest.T @ rest / shape_scale**2 + own.T @ own / size_scale**2
    return matrix / count
