"""How far contact reaches at each vertex: less where the rest shape has small triangles.

A barrier between primitives that are no neighbours but lie closer than its reach in the flat rest
shape turns a cloth into a board. So dhat and thickness of every vertex are multiplied by a scale of
at most 1, and those of a pair by the smallest scale of its four vertices.

The closest points of two primitives of a flat mesh that share no vertex include a vertex of one of
them, and lie outside of the triangles around it. The distance of a vertex from the far sides of the
triangles around it, its clearance, is therefore a length that no such pair goes below.
"""

import numpy as np
from jaxtyping import Float, Int

from dress_jax.contact.barrier import ContactSettings
from dress_jax.core.errors import InputError

_REACH_SHARE = 0.6  # dhat + thickness over the clearance, at most
_THICKNESS_SHARE = 0.25  # thickness over the clearance, at most
_GROWTH = 0.25  # of the reach along the cloth, metres per metre


def contact_scales(
    rest_corners: Float[np.ndarray, "f 3 2"],
    faces: Int[np.ndarray, "f 3"],
    vertex_count: int,
    settings: ContactSettings,
) -> Float[np.ndarray, " n"]:
    """Factors, in (0, 1], by which dhat and thickness are multiplied at each vertex of a cloth.

    They make `dhat + thickness` at most 0.6 and the thickness at most a quarter of the clearance,
    and let the reach grow by at most a quarter of the way along the cloth. They belong to the mesh,
    not to the physics: a function of minima, without a derivative where the smallest triangle
    changes, that is evaluated once and then stays.

    Args:
        rest_corners: of the rest triangles, each in its own plane [m].
        faces: vertices of the same triangles.
        vertex_count: n.
        settings: the lengths to be scaled.

    Raises:
        InputError: a rest triangle without area.
    """
    corners = np.asarray(rest_corners, np.float64)
    faces = np.asarray(faces)
    clearance = np.full(vertex_count, np.inf)
    for k in range(3):
        own, a, b = corners[:, k], corners[:, (k + 1) % 3], corners[:, (k + 2) % 3]
        distances = _segment_distances(own, a, b)
        broken = np.flatnonzero(~(distances > 0.0))
        if len(broken):
            raise InputError(
                "the triangle has no area, or a corner that is not finite",
                where=f"rest triangle {broken[0]}",
                mend="remove it from the rest shape",
            )
        np.minimum.at(clearance, faces[:, k], distances)
    dhat, thickness = float(settings.dhat), float(settings.thickness)
    wanted = max((dhat + thickness) / _REACH_SHARE, thickness / _THICKNESS_SHARE)
    lengths = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    return _graded(
        np.minimum(1.0, clearance / wanted), faces, _GROWTH / (dhat + thickness) * lengths
    )


def _segment_distances(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances of points from segments a b, all (f, 2)."""
    along, offset = b - a, p - a
    squared = np.sum(along**2, axis=1)
    part = np.sum(offset * along, axis=1) / np.where(squared > 0.0, squared, 1.0)
    return np.linalg.norm(offset - np.clip(part, 0.0, 1.0)[:, None] * along, axis=1)


def _graded(scales: np.ndarray, faces: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """The largest field below `scales` that grows by at most `steps` along each side (f, 3)."""
    first, second = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    ends, others = np.concatenate([first, second]), np.concatenate([second, first])
    steps = np.concatenate([steps.ravel(), steps.ravel()])
    while True:
        graded = scales.copy()
        np.minimum.at(graded, ends, scales[others] + steps)
        if np.array_equal(graded, scales):
            return graded
        scales = graded
