"""Points of seams and hems whose place is known, in space or in a picture (host)."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy.sparse
from jaxtyping import Float

from dress_jax.core.errors import InputError
from dress_jax.pattern import Discretization, Pattern
from dress_jax.pattern.discretization import samples_of_edge


@dataclasses.dataclass(frozen=True)
class Landmark:
    """One point of a pattern's edge, and where it is seen.

    Either `position`, or `view` and `pixel`.

    Attributes:
        panel: name.
        edge: number of the edge in its panel.
        at: fraction of the edge's length from its start, in [0, 1].
        position: in the frame of the body [m], (3,).
        view: number of a picture.
        pixel: column and row in it [px]; pixel centres lie at whole numbers.
    """

    panel: str
    edge: int
    at: float
    position: tuple[float, float, float] | None = None
    view: int | None = None
    pixel: tuple[float, float] | None = None


def check_landmarks(landmarks: Sequence[Landmark], pattern: Pattern, views: int) -> None:
    """Refuse landmarks that are on no edge or in no picture.

    Args:
        landmarks: to check.
        pattern: that they are on.
        views: number of pictures.

    Raises:
        InputError: names the landmark and what is wrong with it.
    """
    edges = {panel.name: len(panel.edges) for panel in pattern.panels}
    for number, mark in enumerate(landmarks):
        where = f"landmark {number}"
        if mark.panel not in edges:
            raise InputError(
                f"there is no panel {mark.panel!r}", where=where, mend=f"panels: {sorted(edges)}"
            )
        if not 0 <= mark.edge < edges[mark.panel]:
            last = edges[mark.panel] - 1
            raise InputError(
                f"panel {mark.panel!r} has no edge {mark.edge}",
                where=where,
                mend=f"its edges are 0 to {last}",
            )
        if not 0.0 <= mark.at <= 1.0:
            raise InputError(f"'at' is {mark.at}", where=where, mend="give 0 (start) to 1 (end)")
        in_space, in_picture = mark.position is not None, mark.pixel is not None
        if in_space == in_picture or in_picture != (mark.view is not None):
            raise InputError("a landmark has either a position, or a view and a pixel", where=where)
        seen = np.asarray(mark.position if in_space else mark.pixel, float)
        wanted = 3 if in_space else 2
        if seen.shape != (wanted,) or not np.isfinite(seen).all():
            raise InputError(f"{seen} is not {wanted} numbers", where=where)
        if mark.view is not None and not 0 <= mark.view < views:
            raise InputError(
                f"there is no view {mark.view}", where=where, mend=f"views are 0 to {views - 1}"
            )


def landmark_weights(
    landmarks: Sequence[Landmark], discretization: Discretization
) -> scipy.sparse.csr_array:
    """Weights from a garment's vertices to its landmarks, (q, n); rows sum to one.

    Samples of an edge are uniform in its length.
    """
    numbers = {name: k for k, name in enumerate(discretization.panel_names)}
    weld = np.asarray(discretization.weld_map)
    entries: list[float] = []
    columns: list[int] = []
    for mark in landmarks:
        samples = samples_of_edge(discretization, numbers[mark.panel], mark.edge)
        place = mark.at * (len(samples) - 1)
        before = min(int(place), len(samples) - 2)
        entries += [1.0 - (place - before), place - before]
        columns += weld[samples[before : before + 2]].tolist()
    rows = np.repeat(np.arange(len(landmarks)), 2)
    shape = (len(landmarks), discretization.vertex_count)
    return scipy.sparse.csr_array((np.array(entries), (rows, np.array(columns, int))), shape=shape)


def landmark_distances(
    landmarks: Sequence[Landmark],
    discretization: Discretization,
    positions: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, " q"]:
    """How far a garment's landmarks are from their places; NaN for those in pictures [m]."""
    points = landmark_weights(landmarks, discretization).dot(positions)
    wanted = [(np.nan,) * 3 if mark.position is None else mark.position for mark in landmarks]
    return np.linalg.norm(points - np.array(wanted).reshape(-1, 3), axis=1)
