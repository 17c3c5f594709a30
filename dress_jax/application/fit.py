"""Fit a pattern to target views: dress, optimise with checkpoints, drape the result (S9)."""

import dataclasses
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from dress_jax.application.drape import (
    DrapeOptions,
    DrapeResult,
    drape_pattern,
    draped_state,
)
from dress_jax.application.fit_session import (
    History,
    as_record,
    fit_fingerprint,
    load_progress,
    load_start,
    save_progress,
    save_start,
)
from dress_jax.application.progress import Progress, silent
from dress_jax.application.quality import drape_quality
from dress_jax.application.targets import TargetViews
from dress_jax.application.wearer import Wearer
from dress_jax.core.errors import InputError
from dress_jax.core.results import Result
from dress_jax.energy.cloth import make_cloth
from dress_jax.energy.panels import FacePanels
from dress_jax.io.results import DrapedState
from dress_jax.optimisation import (
    AnyState,
    Evaluation,
    FitInfo,
    FitOptions,
    FitProblem,
    evaluate,
    fit,
    fitted_pattern,
    init,
    length_errors,
    make_problem,
)
from dress_jax.optimisation.draping import fitted_parameters
from dress_jax.optimisation.problem import rest_shape
from dress_jax.optimisation.state import DrapedUnknowns, Unknowns
from dress_jax.pattern import Discretization, Pattern, discretize
from dress_jax.sim import make_simulation, static_solve
from dress_jax.sim.equilibrium import Report

CHECKPOINT_EVERY = 5
_GREY = 0.5


class Fitted(NamedTuple):
    """Unknowns and their drape [m], (n, 3)."""

    unknowns: Unknowns
    positions: Array


@dataclasses.dataclass(frozen=True)
class FitResult:
    """A finished or interrupted fit.

    Attributes:
        problem: what was fitted.
        begin: first unknowns and drape.
        end: fitted unknowns and their settled drape.
        start: the initial drape.
        state: the final drape with its pattern's panels.
        pattern: the fitted pattern.
        report: of the final solve.
        history: one record per iteration.
        before, after: figures of `begin` and `end`.
        views: what was fitted to.
    """

    problem: FitProblem
    begin: DrapedUnknowns
    end: Fitted
    start: DrapedState
    state: DrapedState
    pattern: Pattern
    report: Report
    history: History
    before: Evaluation
    after: Evaluation
    views: TargetViews

    @property
    def good(self) -> bool:
        """The final drape converged and is free of intersections."""
        return self.report.converged and self.report.intersection_free


class FitInterrupted(Exception):
    """The user stopped a fit; its checkpoint is written.

    Args:
        iteration: iterations that the checkpoint holds.
    """

    def __init__(self, iteration: int):
        super().__init__(f"stopped after iteration {iteration}")
        self.iteration = iteration


def scheduled(iterations: int, **changes: Any) -> FitOptions:
    """Fit options for a number of iterations: control points are free for the last two thirds."""
    return FitOptions(iterations=iterations, stage_one=iterations // 3, **changes)


def fit_pattern(
    pattern: Pattern,
    wearer: Wearer,
    views: TargetViews,
    folder: str | Path,
    *,
    drape_options: DrapeOptions | None = None,
    fit_options: FitOptions | None = None,
    truth: Pattern | None = None,
    resume: bool = False,
    progress: Progress = silent,
) -> FitResult:
    """Fit a pattern to target views.

    Args:
        pattern: where to begin.
        wearer: the body in the pose of the views.
        views: from `application.targets.read_targets`.
        folder: for checkpoints.
        drape_options: mesh and fabric; the Newton rule holds for every drape. Friction acts in the
            initial drape only (S8.9, S9.9); a strain limit is refused.
        fit_options: see `optimisation.FitOptions`; terms for which there are no pictures are left
            out.
        truth: the true pattern, to measure against.
        resume: go on from the folder's checkpoint, exactly.
        progress: told about every stage.

    Raises:
        InputError: inputs that cannot be used, or that differ from those of the resumed fit.
        FitInterrupted: on Ctrl-C while optimising.
    """
    folder = Path(folder)
    drape_options = DrapeOptions() if drape_options is None else drape_options
    fit_options = scheduled(FitOptions().iterations) if fit_options is None else fit_options
    if drape_options.strain_limit is not None:
        raise InputError(
            "a fit has no strain limit: a wrong pattern may have to stretch beyond it",
            where="strain limit",
            mend="fit without it, and drape the result with it",
        )
    fit_options = _usable(fit_options, views)
    if truth is not None:
        length_errors(pattern, truth)  # says here, not after hours, where the two differ
    identity = fit_fingerprint(pattern, wearer, views, drape_options, fit_options)
    if resume:
        start = load_start(folder, identity)
        discretization = discretize(pattern, drape_options.edge_length)
    else:
        draped = drape_pattern(pattern, wearer, options=drape_options, progress=progress)
        _require_sound(draped)
        start, discretization = draped_state(draped), draped.discretization
        save_start(folder, start, identity)
    problem = _problem(pattern, discretization, start, views, drape_options, fit_options)
    begin, state, history = _run(problem, start, folder, resume=resume, progress=progress)
    end, report = _settle(problem, state)
    true_mesh = None if views.truth is None else (views.truth.vertices, views.truth.faces)
    before, after = (
        evaluate(problem, s, true_mesh=true_mesh, true_pattern=truth) for s in (begin, end)
    )
    rest = np.asarray(rest_shape(problem, end.unknowns.pattern))
    garment = dataclasses.replace(
        start.garment, vertices=np.asarray(end.positions), rest_positions=rest
    )
    return FitResult(
        problem=problem,
        begin=begin,
        end=end,
        start=start,
        state=dataclasses.replace(start, garment=garment),
        pattern=fitted_pattern(problem, end),
        report=report,
        history=history,
        before=before,
        after=after,
        views=views,
    )


def _usable(options: FitOptions, views: TargetViews) -> FitOptions:
    """Without the terms for which the targets hold no pictures."""
    absent = {"color": not views.has_color, "normal": not views.has_normal}
    weights = {name: w for name, w in options.weights.items() if not absent.get(name, False)}
    return dataclasses.replace(options, weights=weights)


def _require_sound(draped: DrapeResult) -> None:
    if not draped.report.intersection_free:
        raise InputError(
            "the initial drape has intersections",
            where=draped.pattern.source,
            mend="drape it on its own, with a finer mesh, to see where",
        )


def _problem(
    pattern: Pattern,
    discretization: Discretization,
    start: DrapedState,
    views: TargetViews,
    drape_options: DrapeOptions,
    fit_options: FitOptions,
) -> FitProblem:
    """The problem, from the inputs and what `start.h5` holds, so that a resumed one is equal."""
    garment = start.garment
    cloth = make_cloth(
        garment.faces,
        garment.rest_faces,
        rest_positions=garment.rest_positions,
        vertex_count=len(garment.vertices),
        pins=start.pins,
        membrane=drape_options.dressing.membrane,
    )
    simulator, parameters = make_simulation(
        cloth,
        garment.vertices,
        garment.rest_positions,
        fabric=drape_options.fabrics(discretization.panel_names),
        panels=FacePanels(discretization.panel_names, np.asarray(discretization.face_panel)),
        body_vertices=start.body_vertices,
        body_faces=start.body_faces,
        pin_targets=start.pin_targets,
        settings=drape_options.contact,
        newton=drape_options.newton,
        linear_solver=drape_options.dressing.linear_solver,
        broad_phase=drape_options.dressing.broad_phase,
    )
    return make_problem(
        pattern,
        discretization,
        simulator,
        parameters,
        views.observation,
        options=fit_options,
        colors=np.tile(_mean_color(views), (len(garment.vertices), 1)),
    )


def _mean_color(views: TargetViews) -> Float[np.ndarray, "3"]:
    """The garment's mean colour in the views; grey where there are no colours."""
    if not views.has_color:
        return np.full(3, _GREY)
    inside = np.asarray(views.observation.garment) > 0.5
    if not inside.any():
        return np.full(3, _GREY)
    return np.asarray(views.observation.color, np.float64)[inside].mean(axis=0)


def _run(
    problem: FitProblem, start: DrapedState, folder: Path, *, resume: bool, progress: Progress
) -> tuple[AnyState, AnyState, History]:
    """Iterate to the end, with checkpoints."""
    total = problem.options.iterations
    kept = load_progress(folder, problem) if resume else None
    if kept is None:
        progress("fit", 0, total)
        begin = init(problem, start.garment.vertices, clock=time.perf_counter)
        state, history = begin, []
        save_progress(folder, begin, state, history)
    else:
        begin, state, history = kept
    progress("fit", len(history), total)
    reached = state

    def after(state: AnyState, info: FitInfo) -> None:
        nonlocal reached
        record = as_record(info, state)
        # In this order: after an interrupt in between, the surplus record is cut off below.
        history.append(record)
        reached = state
        if len(history) % CHECKPOINT_EVERY == 0:
            save_progress(folder, begin, state, history)
        progress("fit", len(history), total, loss=record["loss"])

    try:
        state = fit(problem, state, on_iteration=after, clock=time.perf_counter)
    except KeyboardInterrupt as error:
        done = int(reached.iteration)
        save_progress(folder, begin, reached, history[:done])
        raise FitInterrupted(done) from error
    save_progress(folder, begin, state, history)
    return begin, state, history


def _settle(problem: FitProblem, state: DrapedUnknowns) -> tuple[Fitted, Report]:
    """Drape the fitted pattern once more, to the full tolerance, for the record."""
    rest = rest_shape(problem, state.unknowns.pattern)
    unknowns = state.unknowns
    parameters = fitted_parameters(problem, rest, unknowns.log_stiffness, unknowns.pin_shift)
    simulator = dataclasses.replace(problem.simulator)
    drape = static_solve(simulator, parameters, state.positions)
    return Fitted(unknowns, drape.positions), drape.report


def fit_report(result: FitResult) -> dict[str, Any]:
    """Numbers of a fit, ready for `report.json`."""
    before, after, report = result.before, result.after, result.report
    content = {
        **drape_quality(result.state),
        "converged": report.converged,
        "result": Result(int(report.result)).message,
        "residual": float(report.residual),
        "newton_iterations": int(report.iterations),
        "iterations": len(result.history),
        "rejected": sum(record["outcome"] != "accepted" for record in result.history),
        "loss": [record["loss"] for record in result.history],
        "history": result.history,
        "iou": {"start": before.iou, "end": after.iou},
        "stiffness_factors": np.exp(np.asarray(result.end.unknowns.log_stiffness)).tolist(),
        "pin_shift_m": np.asarray(result.end.unknowns.pin_shift).tolist(),
        "weights": dict(result.problem.options.active_weights),
        "settings": dict(result.state.settings),
        "chamfer_cm": None,
        "edge_length_error": None,
    }
    if before.chamfer is not None:
        content["chamfer_cm"] = {"start": before.chamfer, "end": after.chamfer}
    if before.median_length_error is not None:
        content["edge_length_error"] = {
            name: {"median": e.median_length_error, "max": e.largest_length_error}
            for name, e in (("start", before), ("end", after))
        }
    return content
