"""What holds a garment that does not hang from the shoulders (S8.8, S9.10)."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from dress_jax.geometry.topology import boundary_loops, connected_components

SHRINK = 0.9  # of the rest lengths around the waist, while friction has to hold it
SHRINK_WIDTH = 0.06  # how far down from the waist [m]
_SHOULDER_SHARE = 0.78  # height of the shoulders over the height of the body


def waist_loops(
    positions: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    body: Float[np.ndarray, "b 3"],
) -> Int[np.ndarray, " k"]:
    """Vertices of the upper boundary loop of every component that ends below the shoulders.

    Args:
        positions: of the dressed garment [m].
        faces: welded triangles.
        body: body vertices, standing [m].
    """
    low, high = body[:, 1].min(), body[:, 1].max()
    shoulders = low + _SHOULDER_SHARE * (high - low)
    component = connected_components(faces, len(positions))
    loops = boundary_loops(faces)
    held: list[np.ndarray] = []
    for number in np.unique(component):
        if positions[component == number, 1].max() >= shoulders:
            continue
        own = [loop for loop in loops if component[loop[0]] == number]
        if own:
            held.append(max(own, key=lambda loop: float(positions[loop, 1].mean())))
    return np.concatenate(held).astype(np.int32) if held else np.zeros(0, np.int32)


def shrunk_waist(
    rest_positions: Float[np.ndarray, "p 2"],
    rest_faces: Int[np.ndarray, "f 3"],
    faces: Int[np.ndarray, "f 3"],
    loop: Int[np.ndarray, " k"],
    *,
    factor: float = SHRINK,
    width: float = SHRINK_WIDTH,
) -> Float[np.ndarray, "p 2"]:
    """A rest shape that is tighter around the waist, so that friction keeps it there (S8.8).

    Every panel is drawn together along its part of the loop, about the middle of that part; the
    change fades out with the distance from the loop.

    Args:
        rest_positions: panel coordinates [m].
        rest_faces, faces: triangles in panel vertices, and in welded vertices.
        loop: welded vertices of the waist.
        factor: of the lengths along the loop.
        width: distance from the loop at which nothing changes any more [m].
    """
    rest = np.array(rest_positions, np.float64)
    at_waist = np.zeros(len(rest), bool)
    at_waist[rest_faces[np.isin(faces, loop)]] = True
    panel = connected_components(rest_faces, len(rest))
    for number in np.unique(panel[at_waist]):
        own = np.flatnonzero(panel == number)
        waist = rest_positions[own[at_waist[own]]]
        middle = waist.mean(axis=0)
        along = np.linalg.svd(waist - middle)[2][0]
        distance = cKDTree(waist).query(rest_positions[own])[0]
        weight = np.clip(1.0 - distance / width, 0.0, 1.0)
        offset = np.sum((rest_positions[own] - middle) * along, axis=1)
        rest[own] += ((factor - 1.0) * weight * offset)[:, None] * along
    return rest
