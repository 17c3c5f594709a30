"""Sewing: seams are pulled together in simulation and welded by a checked move (S8.2)."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Parameters
from dress_jax.pattern import Discretization
from dress_jax.sim.dressing.motion import motion_bound
from dress_jax.sim.simulator import Simulator
from dress_jax.sim.solve import static_solve
from dress_jax.solver.newton import NewtonOptions

_ROUNDS = 8
_STIFFER = 4.0  # factor on the stitches from round to round


@dataclasses.dataclass(frozen=True)
class Sewn:
    """A sewn garment.

    Attributes:
        positions: welded vertices [m], (n, 3).
        seam_gap: largest gap of a seam just before the weld [m].
        iterations: Newton steps taken.
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
    x = np.array(positions, np.float64)
    weld = np.asarray(discretization.weld_map)
    count = discretization.vertex_count
    members = np.bincount(weld, minlength=count)
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
