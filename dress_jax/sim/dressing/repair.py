"""A start state with intersections, made free of them.

A barrier cannot undo a crossing, and which side of a fold is the right one is not in the positions.
So the garment is put on again, from where it is instead of from where its panels are placed: the
smooth surface nearest to the state (`joining`), a body thin enough to stand inside of it, and the
body's growth. Small knots come undone and the garment stays where it was; what hangs on the wrong
side of an arm stays there, and what cannot be freed is refused like any garment.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from dress_jax.contact.barrier import ContactSettings
from dress_jax.core.errors import InputError
from dress_jax.energy.fabric import Fabrics
from dress_jax.geometry.intersection import IntersectionCounts, count_intersections
from dress_jax.pattern import Discretization
from dress_jax.sim.dressing.dress import DressedGarment, DressingOptions, dress


@dataclasses.dataclass(frozen=True)
class Repair:
    """A repaired start state.

    Attributes:
        garment: free of intersections, every pair further apart than the thickness; vertices keep
            their numbers.
        before: intersections of the state as given.
        largest_displacement, mean_displacement: between the two states [m].
    """

    garment: DressedGarment
    before: IntersectionCounts
    largest_displacement: float
    mean_displacement: float


def repair_start(
    discretization: Discretization,
    rest_positions: Float[np.ndarray, "p 2"],
    positions: Float[np.ndarray, "n 3"],
    body_vertices: Float[np.ndarray, "b 3"],
    body_faces: Int[np.ndarray, "k 3"],
    *,
    fabric: Fabrics,
    settings: ContactSettings | None = None,
    options: DressingOptions | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Repair:
    """A state without intersections near one that has them, for `static_solve` to start from.

    Args:
        discretization: of the pattern.
        rest_positions: panel coordinates [m].
        positions: of the welded vertices, from a scan, another simulator or another body [m].
        body_vertices, body_faces: the body in the pose of this state [m].
        fabric, settings, options, progress: see `dress`.

    Raises:
        InputError: positions that do not fit the pattern or are not finite, or a garment that
            cannot be freed; the message names the panels.
    """
    positions = np.asarray(positions, np.float64)
    expected = (discretization.vertex_count, 3)
    if positions.shape != expected:
        raise InputError(f"shape {positions.shape}, expected {expected}", where="positions")
    bad = np.flatnonzero(~np.isfinite(positions).all(axis=1))
    if len(bad):
        raise InputError("a number is not finite", where=f"positions, row {bad[0]}")
    before = count_intersections(
        positions, np.asarray(discretization.faces), body_vertices, body_faces
    )
    garment = dress(
        discretization,
        rest_positions,
        body_vertices,
        body_faces,
        fabric=fabric,
        placed=positions[np.asarray(discretization.weld_map)],
        settings=settings,
        options=options,
        progress=progress,
    )
    moved = np.linalg.norm(garment.positions - positions, axis=1)
    return Repair(garment, before, float(moved.max()), float(moved.mean()))
