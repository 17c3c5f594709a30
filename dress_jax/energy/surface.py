"""Faults of the index arrays of a cloth, named with triangle, panel and edge."""

import numpy as np
from jaxtyping import Int

from dress_jax.core.errors import InputError
from dress_jax.energy.panels import FacePanels, triangle_place


def check_faces(faces: Int[np.ndarray, "f 3"], count: int, panels: FacePanels | None) -> None:
    """Check that triangles describe a surface.

    Raises:
        InputError: an index out of range, a triangle that names a vertex twice, or an edge with
            more than two triangles; the message names panel, triangle and edge.
    """
    outside = np.flatnonzero(((faces < 0) | (faces >= count)).any(axis=1))
    if len(outside):
        raise InputError(
            f"names vertices {faces[outside[0]].tolist()}, but there are {count}",
            where=triangle_place(int(outside[0]), panels),
            mend="indices count from 0",
        )
    twice = np.flatnonzero((faces == np.roll(faces, -1, axis=1)).any(axis=1))
    if len(twice):
        raise InputError(
            f"names a vertex twice: {faces[twice[0]].tolist()}",
            where=triangle_place(int(twice[0]), panels),
            mend="remove the triangle, or do not weld its corners",
        )
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    unique, owner, uses = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    crowded = np.flatnonzero(uses > 2)
    if len(crowded):
        a, b = unique[crowded[0]].tolist()
        at = np.flatnonzero(owner.ravel() == crowded[0]) // 3
        raise InputError(
            f"edge ({a}, {b}) belongs to {len(at)} triangles, more than two",
            where="; ".join(triangle_place(int(face), panels) for face in at),
            mend="a cloth has at most two sides at an edge: take one of them out of the seam",
        )


def check_indices(name: str, indices: Int[np.ndarray, "*k"], count: int) -> None:
    """Check that vertices of a list exist.

    Raises:
        InputError: one does not.
    """
    outside = indices[(indices < 0) | (indices >= count)]
    if len(outside):
        raise InputError(
            f"there is no vertex {outside[0]}, but only {count} vertices",
            where=name,
            mend="indices count from 0",
        )
