"""What holds a garment that does not hang from the shoulders (S8.8, S9.10)."""

import numpy as np
from jaxtyping import Float, Int

from dress_jax.geometry.topology import boundary_loops, connected_components

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
