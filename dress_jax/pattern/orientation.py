"""Which way each panel's triangles turn, so that the sewn surface has one outer side (host)."""

import numpy as np
from jaxtyping import Bool, Float, Int


def consistent_signs(
    areas: Float[np.ndarray, "panels"],
    stitched_panels: Int[np.ndarray, "stitches 2"],
    stitch_reversed: Bool[np.ndarray, "stitches"],
) -> Int[np.ndarray, "panels"]:
    """Panels whose triangles must turn against their loop.

    A default stitch (start meets end) joins panels whose triangles both follow their loops; a
    `right_wrong` stitch turns one of the two around, as for a collar. Panels are walked through
    their stitches; in each connected garment the side that holds more cloth keeps to its loops.
    Where stitches contradict each other (a one-sided surface) every panel of the garment does.

    Args:
        areas: areas of the panels [m^2], shape (panels,).
        stitched_panels: panels of both sides of each stitch, shape (stitches, 2).
        stitch_reversed: `Stitch.reversed`, shape (stitches,).

    Returns:
        +1 where triangles follow the loop, -1 where they run against it, shape (panels,).
    """
    signs = np.zeros(len(areas), dtype=np.int64)
    change = np.where(stitch_reversed, 1, -1)
    neighbours: list[list[tuple[int, int]]] = [[] for _ in areas]
    for (first, second), factor in zip(stitched_panels.tolist(), change.tolist(), strict=True):
        neighbours[first].append((second, factor))
        neighbours[second].append((first, factor))
    for seed in range(len(areas)):
        if signs[seed]:
            continue
        signs[seed] = 1
        members, waiting = [seed], [seed]
        while waiting:
            panel = waiting.pop()
            for other, factor in neighbours[panel]:
                if signs[other] == 0:
                    signs[other] = factor * signs[panel]
                    members.append(other)
                    waiting.append(other)
        contradictory = any(
            signs[other] != factor * signs[panel]
            for panel in members
            for other, factor in neighbours[panel]
        )
        if contradictory:
            signs[members] = 1
        elif float(np.sum(areas[members] * signs[members])) < 0.0:
            signs[members] *= -1
    return signs
