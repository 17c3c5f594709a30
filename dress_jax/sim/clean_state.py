"""Remembers the last state that the exact test found free of intersections.

A loop of warm-started solves begins each solve where the last one ended, a state that was tested
then. Nothing is left out but the test of the very same arrays.
"""

import numpy as np
from jaxtyping import Float, Int

from dress_jax.geometry.intersection import IntersectionCounts, count_intersections


class CleanState:
    """The arrays of the last clean state; copies of a simulator share one.

    A copy may differ in anything, so everything that the test looks at is compared.
    """

    def __init__(self) -> None:
        self._arrays: tuple[np.ndarray | None, ...] | None = None

    def count(
        self,
        positions: Float[np.ndarray, "n 3"],
        faces: Int[np.ndarray, "f 3"],
        body_vertices: Float[np.ndarray, "b 3"],
        body_faces: Int[np.ndarray, "k 3"],
        *,
        weld_map: Int[np.ndarray, " n"] | None = None,
    ) -> IntersectionCounts:
        """Intersections by the exact test; the last clean state, met again, is not tested again.

        Args:
            positions: of the cloth [m].
            faces: of the cloth.
            body_vertices, body_faces: the body [m].
            weld_map: as `weld_ids` of `count_intersections`.
        """
        arrays = (positions, faces, body_vertices, body_faces, weld_map)
        if self._arrays is not None and all(map(_equal, self._arrays, arrays)):
            return IntersectionCounts(0, 0)
        counts = count_intersections(*arrays[:4], weld_ids=weld_map)
        if not (counts.self or counts.body):
            # Copies: the caller may write into its arrays.
            self._arrays = tuple(None if a is None else np.array(a) for a in arrays)
        return counts


def _equal(known: np.ndarray | None, other: np.ndarray | None) -> bool:
    if known is None or other is None:
        return known is other
    return np.array_equal(known, other)
