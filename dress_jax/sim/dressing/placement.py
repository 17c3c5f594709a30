"""Placements that start free of intersections (S8.1)."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from dress_jax.core.errors import InputError
from dress_jax.geometry.intersection import count_intersections, edge_face_intersections
from dress_jax.geometry.topology import unique_edges
from dress_jax.pattern import Discretization

_SHIFTS = np.linspace(0.005, 0.25, 50)  # tried distances between two panels that cross [m]
_ROUNDS = 40


@dataclasses.dataclass(frozen=True)
class Placement:
    """Panels around a body, without intersections.

    Attributes:
        positions: panel vertices [m], (p, 3).
        moved_panels: names of the panels that had to be pushed apart.
    """

    positions: Float[np.ndarray, "p 3"]
    moved_panels: tuple[str, ...]


def separate_panels(
    positions: Float[np.ndarray, "p 3"], discretization: Discretization
) -> Placement:
    """Push panels that cross apart, along the line between their centres.

    Args:
        positions: placed panel vertices [m].
        discretization: of the pattern.

    Raises:
        InputError: a panel crosses itself, or two panels cannot be separated within 25 cm.
    """
    positions = np.array(positions, np.float64)
    moved: set[int] = set()
    for _ in range(_ROUNDS):
        pairs = _crossing_panels(positions, discretization)
        if not pairs:
            names = tuple(discretization.panel_names[panel] for panel in sorted(moved))
            return Placement(positions, names)
        for first, second in pairs:
            _separate(positions, discretization, first, second)
            moved |= {first, second}
    first, second = pairs[0]
    raise InputError(
        "panels cross each other as placed and pushing them apart makes them cross others",
        where=f"panels {_name(discretization, first)!r} and {_name(discretization, second)!r}",
        mend="correct the translation or rotation of these panels in the pattern file",
    )


def _name(discretization: Discretization, panel: int) -> str:
    return discretization.panel_names[panel]


def _crossing_panels(
    positions: np.ndarray, discretization: Discretization
) -> list[tuple[int, int]]:
    faces = np.asarray(discretization.rest_faces)
    edges = unique_edges(faces)
    crossings = edge_face_intersections(
        positions, edges, faces, weld_ids=np.asarray(discretization.weld_map)
    )
    owner = np.asarray(discretization.panel_of_vertex)
    pairs = np.stack([owner[edges[crossings[:, 0], 0]], owner[faces[crossings[:, 1], 0]]], axis=1)
    unique = sorted({(min(a, b), max(a, b)) for a, b in pairs.tolist()})
    for first, second in unique:
        if first == second:
            raise InputError(
                "the panel crosses itself as placed",
                where=f"panel {_name(discretization, first)!r}",
                mend="correct the outline of this panel",
            )
    return unique


def _separate(
    positions: np.ndarray, discretization: Discretization, first: int, second: int
) -> None:
    """Move two panels apart by the smallest distance of a list that frees them."""
    owner = np.asarray(discretization.panel_of_vertex)
    faces = np.asarray(discretization.rest_faces)
    parts = []
    for panel in (first, second):
        own = faces[np.asarray(discretization.face_panel) == panel]
        parts.append((owner == panel, own, unique_edges(own)))
    weld = np.asarray(discretization.weld_map)
    centres = [positions[mask].mean(axis=0) for mask, _, _ in parts]
    direction = centres[1] - centres[0]
    length = np.linalg.norm(direction)
    direction = direction / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])
    for shift in _SHIFTS:
        trial = positions.copy()
        for sign, (mask, _, _) in zip((-0.5, 0.5), parts, strict=True):
            trial[mask] += sign * shift * direction
        (_, faces_a, edges_a), (_, faces_b, edges_b) = parts
        crossings = len(edge_face_intersections(trial, edges_a, faces_b, weld_ids=weld))
        crossings += len(edge_face_intersections(trial, edges_b, faces_a, weld_ids=weld))
        if crossings == 0:
            positions[:] = trial
            return
    raise InputError(
        "the panels still cross each other after being pushed 25 cm apart",
        where=f"panels {_name(discretization, first)!r} and {_name(discretization, second)!r}",
        mend="correct the translation or rotation of these panels in the pattern file",
    )


def free_level(
    positions: Float[np.ndarray, "p 3"],
    discretization: Discretization,
    body_path: Float[np.ndarray, "levels b 3"],
    body_faces: Int[np.ndarray, "k 3"],
    *,
    least: int,
) -> int:
    """The fullest level of a contraction path, from `least` on, that touches no panel.

    Args:
        positions: placed panel vertices [m].
        body_path: from the full body to the thinnest.
        least: the fullest level that may be chosen; a thinner body leaves room for sewing.

    Raises:
        InputError: even the thinnest body crosses a panel.
    """
    faces = np.asarray(discretization.rest_faces)
    weld = np.asarray(discretization.weld_map)
    for level in range(least, len(body_path)):
        counts = count_intersections(positions, faces, body_path[level], body_faces, weld_ids=weld)
        if counts.body == 0:
            return level
    everything = np.concatenate([positions, body_path[-1]])
    offset = np.asarray(body_faces) + len(positions)
    crossed = edge_face_intersections(everything, unique_edges(offset), faces)
    hit = np.unique(np.asarray(discretization.face_panel)[crossed[:, 1]])
    names = [discretization.panel_names[panel] for panel in hit]
    raise InputError(
        "the panels run through the body as placed, even through its skeleton",
        where=f"panels {names}",
        mend="check that pattern and body stand in the same frame (metres, feet at y = 0, front "
        "towards +z) and correct the translation or rotation of these panels",
    )
