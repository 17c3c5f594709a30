"""How good a fit is: masks over all views, distance to a true mesh, lengths of a true pattern."""

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Num

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.geometry.nearest import nearest_on_surface
from dress_jax.loss.metrics import CENTIMETRES_PER_METRE, chamfer_distance, iou
from dress_jax.optimisation.landmarks import landmark_distances
from dress_jax.optimisation.observation import observe_meshes
from dress_jax.optimisation.problem import FitProblem, fitted_pattern
from dress_jax.optimisation.state import DrapedUnknowns
from dress_jax.pattern import Pattern, edge_lengths, edge_table, pattern_parameters


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """Figures of a fit; None where the truth was not given.

    Attributes:
        iou: of the masks, pixels of all views together.
        scan: mean distance of the scan's points to the garment [cm].
        landmarks: mean distance of those in space to their places [cm].
        chamfer: symmetric mean distance to the true mesh [cm].
        median_length_error, largest_length_error: of pattern edges, relative to the true lengths.
    """

    iou: float
    chamfer: float | None = None
    scan: float | None = None
    landmarks: float | None = None
    median_length_error: float | None = None
    largest_length_error: float | None = None


def evaluate(
    problem: FitProblem,
    state: DrapedUnknowns,
    *,
    true_mesh: tuple[Float[np.ndarray, "m 3"], Num[np.ndarray, "g 3"]] | None = None,
    true_pattern: Pattern | None = None,
) -> Evaluation:
    """Compare a state with the observation, and with the truth where it is known.

    Args:
        problem: what was fitted.
        state: the fit.
        true_mesh: vertices [m] and faces of the true drape.
        true_pattern: with the panels and edges of the fitted one.

    Raises:
        InputError: the true pattern has other panels or edges.
    """
    tables, observation = problem.tables, problem.observation
    garment = replace(tables.garment, positions=state.positions, colors=state.unknowns.colors)
    drawn = observe_meshes(observation.cameras, garment, tables.occluder)
    valid = np.asarray(observation.valid) > 0.0
    chamfer = scan = landmarks = median = largest = None
    faces = np.asarray(problem.discretization.faces)
    if problem.scan is not None:
        triangles = np.asarray(state.positions)[faces]
        distance = nearest_on_surface(problem.scan.points, triangles).distance
        scan = CENTIMETRES_PER_METRE * float(distance.mean())
    in_space = [mark for mark in problem.landmarks if mark.position is not None]
    if in_space:
        own = landmark_distances(in_space, problem.discretization, np.asarray(state.positions))
        landmarks = CENTIMETRES_PER_METRE * float(own.mean())
    if true_mesh is not None:
        chamfer = chamfer_distance(np.asarray(state.positions), faces, *true_mesh)
    if true_pattern is not None:
        errors = length_errors(fitted_pattern(problem, state), true_pattern)
        every = np.concatenate(list(errors.values()))
        median, largest = float(np.median(every)), float(np.max(every))
    return Evaluation(
        iou=float(iou(np.asarray(drawn.mask) * valid, np.asarray(observation.mask) * valid)),
        chamfer=chamfer,
        scan=scan,
        landmarks=landmarks,
        median_length_error=median,
        largest_length_error=largest,
    )


def length_errors(
    pattern: Pattern, true_pattern: Pattern
) -> Mapping[str, Float[np.ndarray, " edges"]]:
    """|L - L*| / L* of every edge, by panel; panels match by name, edges by their place (host).

    Args:
        pattern: the pattern to judge.
        true_pattern: the true one; its panels may come in another order.

    Raises:
        InputError: panels or numbers of edges differ.
    """
    own = {panel.name: len(panel.edges) for panel in pattern.panels}
    true = {panel.name: len(panel.edges) for panel in true_pattern.panels}
    mend = "compare with a pattern of the same panels and edges"
    if set(own) != set(true):
        raise InputError(
            f"panels {sorted(own)} and {sorted(true)} differ", where="length errors", mend=mend
        )
    for name, count in own.items():
        if count != true[name]:
            raise InputError(
                f"{count} and {true[name]} edges",
                where=f"length errors, panel {name!r}",
                mend=mend,
            )
    lengths, true_lengths = _lengths(pattern), _lengths(true_pattern)
    return {
        name: np.abs(lengths[name] - true_lengths[name]) / true_lengths[name] for name in lengths
    }


def _lengths(pattern: Pattern) -> dict[str, np.ndarray]:
    table = edge_table(pattern)
    lengths = np.asarray(edge_lengths(pattern_parameters(pattern), table))
    return {
        panel.name: lengths[table.panel == number] for number, panel in enumerate(pattern.panels)
    }
