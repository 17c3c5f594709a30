"""Sewing: seams are brought together and welded by a checked move (S8.2).

Where the panels can be bent smoothly until their seams meet, that move alone welds them. Elsewhere
(sleeves, crossing panels) stitches pull the seams together in simulation first.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Float

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Parameters
from dress_jax.geometry.intersection import count_intersections
from dress_jax.geometry.topology import unique_edges
from dress_jax.pattern import Discretization
from dress_jax.sim.dressing.motion import motion_bound
from dress_jax.sim.simulator import Simulator
from dress_jax.sim.solve import static_solve
from dress_jax.solver.newton import NewtonOptions

_ANCHORS = (0.02, 0.05, 0.2, 0.6)  # tried weights of staying in place, see `bent_together`
_ROUNDS = 8
_STIFFER = 4.0  # factor on the stitches from round to round


@dataclasses.dataclass(frozen=True)
class Sewn:
    """A sewn garment.

    Attributes:
        positions: welded vertices [m], (n, 3).
        seam_gap: largest move of a seam point in the weld [m].
        iterations: Newton steps taken; 0 where bending the panels sufficed.
    """

    positions: Float[np.ndarray, "n 3"]
    seam_gap: float
    iterations: int


def sew(
    simulator: Simulator,
    parameters: Parameters,
    positions: Float[np.ndarray, "p 3"],
    discretization: Discretization,
) -> Sewn:
    """Pull the seams together and weld them.

    Args:
        simulator: of the unwelded panels, with the seams as stitches and the weld map set.
        parameters: of the unwelded panels.
        positions: intersection-free panel vertices [m].
        discretization: of the pattern.

    Raises:
        InputError: a seam cannot be closed; the message names the panels of the widest one.
    """
    for anchor in _ANCHORS:
        bent = _try_bending(simulator, parameters, positions, discretization, anchor)
        if bent is not None:
            return bent
    x = np.array(positions, np.float64)
    weld = np.asarray(discretization.weld_map)
    count = discretization.vertex_count
    members = np.bincount(weld, minlength=count).astype(float)
    iterations = 0
    sewing = dataclasses.replace(
        simulator, newton=NewtonOptions(tolerance=2e-4, iteration_limit=60, longest_step=0.05)
    )
    stiffness = float(parameters.stitch_stiffness)
    for _ in range(_ROUNDS):
        now = replace(parameters, stitch_stiffness=jnp.asarray(stiffness))
        drape = static_solve(sewing, now, jnp.asarray(x))
        x = np.asarray(drape.positions)
        iterations += int(drape.report.iterations)
        welded = np.stack(
            [np.bincount(weld, x[:, k], minlength=count) / members for k in range(3)], axis=1
        )
        gap = float(np.max(np.linalg.norm(welded[weld] - x, axis=1)))
        body = np.asarray(parameters.body_vertices)
        bound = motion_bound(sewing, x, welded[weld] - x, body, np.zeros_like(body))
        if bound >= 1.0 and gap < _longest_weld(discretization):
            return Sewn(welded, gap, iterations)
        stiffness *= _STIFFER
    raise _open_seam(x, discretization)


def bent_together(
    positions: Float[np.ndarray, "p 3"], discretization: Discretization, anchor: float
) -> Float[np.ndarray, "n 3"]:
    """Welded positions in which the panels keep their shape as well as the seams allow.

    Minimizes the change of all edge vectors plus `anchor` times the displacement of all panel
    vertices, squared: one sparse linear solve. A small anchor lets whole panels move, a large one
    bends only the strips along the seams.
    """
    weld = np.asarray(discretization.weld_map)
    count = discretization.vertex_count
    edges = unique_edges(np.asarray(discretization.rest_faces))
    i, j = weld[edges[:, 0]], weld[edges[:, 1]]
    ones = np.ones(len(edges))
    laplacian = scipy.sparse.coo_matrix(
        (
            np.concatenate([ones, ones, -ones, -ones]),
            (np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i])),
        ),
        shape=(count, count),
    )
    wanted = positions[edges[:, 0]] - positions[edges[:, 1]]
    right = np.zeros((count, 3))
    np.add.at(right, i, wanted)
    np.add.at(right, j, -wanted)
    np.add.at(right, weld, anchor * positions)
    members = np.bincount(weld, minlength=count).astype(float)
    matrix = (laplacian + anchor * scipy.sparse.diags(members)).tocsc()
    return scipy.sparse.linalg.splu(matrix).solve(right)


def _try_bending(
    simulator: Simulator,
    parameters: Parameters,
    positions: np.ndarray,
    discretization: Discretization,
    anchor: float,
) -> Sewn | None:
    """The bent garment, if the move to it and the garment itself are free of collisions."""
    weld = np.asarray(discretization.weld_map)
    welded = bent_together(positions, discretization, anchor)
    body = np.asarray(parameters.body_vertices)
    faces = np.asarray(discretization.faces)
    counts = count_intersections(welded, faces, body, simulator.body_faces)
    if counts.self or counts.body:
        return None
    move = welded[weld] - positions
    if motion_bound(simulator, positions, move, body, np.zeros_like(body)) < 1.0:
        return None
    pairs = np.asarray(discretization.seam_vertices)
    largest = float(np.max(np.linalg.norm(move[pairs.ravel()], axis=1), initial=0.0))
    return Sewn(welded, largest, 0)


def _longest_weld(discretization: Discretization) -> float:
    """A weld moves no vertex further than a quarter of an edge."""
    return 0.25 * discretization.edge_length


def _open_seam(x: np.ndarray, discretization: Discretization) -> InputError:
    pairs = np.asarray(discretization.seam_vertices)
    gaps = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    widest = int(np.argmax(gaps))
    names = [
        discretization.panel_names[panel]
        for panel in np.asarray(discretization.panel_of_vertex)[pairs[widest]]
    ]
    return InputError(
        f"a seam stays {gaps[widest] * 1e3:.1f} mm open",
        where=f"seam between panels {names[0]!r} and {names[1]!r}",
        mend="check which edges this seam joins, and their directions",
    )
