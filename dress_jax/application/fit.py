"""Fit a pattern to target views: dress, optimise with checkpoints, drape the result (S9)."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array

from dress_jax.application.drape import (
    DrapeOptions,
    DrapeResult,
    certificate_of,
    drape_pattern,
    draped_state,
)
from dress_jax.application.fit_knowledge import knowledge_report
from dress_jax.application.fit_problem import usable
from dress_jax.application.fit_run import FitInputs, run_fit
from dress_jax.application.fit_session import Course, fit_fingerprint, load_start, save_start
from dress_jax.application.progress import Progress, silent
from dress_jax.application.quality import drape_quality
from dress_jax.application.targets import TargetViews
from dress_jax.application.wearer import Wearer
from dress_jax.core.errors import InputError
from dress_jax.core.results import Result
from dress_jax.io.results import DrapedState
from dress_jax.optimisation import (
    Evaluation,
    FitOptions,
    FitProblem,
    Uncertainty,
    evaluate,
    find_uncertainty,
    fitted_pattern,
    length_errors,
    named_values,
)
from dress_jax.optimisation.draping import fitted_parameters
from dress_jax.optimisation.landmarks import check_landmarks
from dress_jax.optimisation.problem import rest_shape
from dress_jax.optimisation.state import DrapedUnknowns, Unknowns
from dress_jax.pattern import Discretization, Pattern, discretize
from dress_jax.pattern.rules import Rule
from dress_jax.sim import static_solve
from dress_jax.sim.equilibrium import Report
from dress_jax.solver.linear import LinearSolveError

_SAME = 1e-9  # [m]
_NO_DERIVATIVE = "the final drape is no stable equilibrium, so it has no derivative"


class Fitted(NamedTuple):
    """Unknowns and their drape [m], (n, 3)."""

    unknowns: Unknowns
    positions: Array


@dataclasses.dataclass(frozen=True)
class FitResult:
    """A finished or interrupted fit.

    Attributes:
        first: the problem on the first mesh.
        problem: what was fitted, on the last mesh.
        begin: first unknowns and drape.
        end: fitted unknowns and their settled drape.
        start: the initial garment on the last mesh, and the body.
        state: the final drape with its pattern's panels.
        pattern: the fitted pattern.
        report: of the final solve.
        certificate: of its equilibrium, ready for a report.
        course: one record per iteration, and per new mesh.
        before, after: figures of `begin` and `end`.
        views: what was fitted to.
        known: what they tell; None where the final drape has no derivative.
    """

    first: FitProblem
    problem: FitProblem
    begin: DrapedUnknowns
    end: Fitted
    start: DrapedState
    state: DrapedState
    pattern: Pattern
    report: Report
    certificate: dict[str, Any]
    course: Course
    before: Evaluation
    after: Evaluation
    views: TargetViews
    known: Uncertainty | None

    @property
    def good(self) -> bool:
        """The final drape converged and is free of intersections."""
        return self.report.converged and self.report.intersection_free


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
    rules: Sequence[Rule] = (),
    resume: bool = False,
    start: DrapedState | None = None,
    progress: Progress = silent,
) -> FitResult:
    """Fit a pattern to target views.

    Args:
        pattern: where to begin.
        wearer: the body in the pose of the views.
        views: from `application.targets.read_targets`, `application.bundle_targets.read_views`, or
            `views_without_pictures`.
        folder: for checkpoints.
        drape_options: mesh and fabric; the Newton rule holds for every drape. Friction acts in the
            initial drape only (S8.9, S9.9); a strain limit is refused.
        fit_options: see `optimisation.FitOptions`; terms for which there are no pictures are left
            out.
        truth: the true pattern, to measure against.
        rules: of the design, see `pattern.rules`.
        resume: go on from the folder's checkpoint, exactly.
        start: the pattern as it was draped on this wearer with these options; draped here when
            None, and not looked at when resuming.
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
    fit_options = usable(fit_options, views)
    check_landmarks(views.landmarks, pattern, views.observation.view_count)
    if truth is not None:
        length_errors(pattern, truth)  # says here, not after hours, where the two differ
    names = tuple(rule.name for rule in rules)
    identity = fit_fingerprint(pattern, wearer, views, drape_options, fit_options, names)
    if resume:
        start = load_start(folder, identity)
        discretization = discretize(pattern, drape_options.edge_length)
    elif start is not None:
        discretization = discretize(pattern, drape_options.edge_length)
        _require_same(start, discretization, wearer)
        save_start(folder, start, identity)
    else:
        draped = drape_pattern(pattern, wearer, options=drape_options, progress=progress)
        _require_sound(draped)
        start, discretization = draped_state(draped), draped.discretization
        save_start(folder, start, identity)
    inputs = FitInputs(pattern, wearer, views, drape_options, fit_options, tuple(rules))
    run = run_fit(inputs, discretization, start, folder, resume=resume, progress=progress)
    problem = run.problem
    end, report, certificate = _settle(problem, run.state)
    progress("evaluate", 0, 1)
    true_mesh = None if views.truth is None else (views.truth.vertices, views.truth.faces)
    before, after = (
        evaluate(p, s, true_mesh=true_mesh, true_pattern=truth)
        for p, s in ((run.first, run.begin), (problem, end))
    )
    garment = dataclasses.replace(
        run.start.garment,
        vertices=np.asarray(end.positions),
        rest_positions=np.asarray(rest_shape(problem, end.unknowns.pattern)),
    )
    return FitResult(
        first=run.first,
        problem=problem,
        begin=run.begin,
        end=end,
        start=run.start,
        state=dataclasses.replace(run.start, garment=garment),
        pattern=fitted_pattern(problem, end),
        report=report,
        certificate=certificate,
        course=run.course,
        before=before,
        after=after,
        views=views,
        known=_known(problem, end),
    )


def _known(problem: FitProblem, end: Fitted) -> Uncertainty | None:
    try:
        return find_uncertainty(problem, end.unknowns, end.positions)
    except LinearSolveError:
        return None


def _require_same(start: DrapedState, made: Discretization, wearer: Wearer) -> None:
    garment = start.garment
    same = (
        np.array_equal(garment.faces, np.asarray(made.faces))
        and garment.rest_positions.shape == np.shape(made.meshed_positions)
        and np.allclose(garment.rest_positions, np.asarray(made.meshed_positions), atol=_SAME)
        and np.allclose(start.body_vertices, wearer.vertices, atol=_SAME)
    )
    if not same:
        raise InputError(
            "is of another pattern, mesh or body",
            where="initial drape",
            mend="drape the pattern that is to be fitted, with the options of the fit",
        )


def _require_sound(draped: DrapeResult) -> None:
    if not draped.report.intersection_free:
        raise InputError(
            "the initial drape has intersections",
            where=draped.pattern.source,
            mend="drape it on its own, with a finer mesh, to see where",
        )


def _settle(problem: FitProblem, state: DrapedUnknowns) -> tuple[Fitted, Report, dict[str, Any]]:
    """Drape the fitted pattern once more, to the full tolerance, for the record, and certify it."""
    rest = rest_shape(problem, state.unknowns.pattern)
    unknowns = state.unknowns
    parameters = fitted_parameters(problem, rest, unknowns.log_stiffness, unknowns.pin_shift)
    simulator = dataclasses.replace(problem.simulator)
    drape = static_solve(simulator, parameters, state.positions)
    certificate = certificate_of(simulator, parameters, np.asarray(drape.positions))
    return Fitted(unknowns, drape.positions), drape.report, certificate


def fit_report(result: FitResult) -> dict[str, Any]:
    """Numbers of a fit, ready for `report.json`."""
    before, after, report = result.before, result.after, result.report
    history = result.course.history
    content = {
        **drape_quality(result.state),
        "converged": report.converged,
        "result": Result(int(report.result)).message,
        "residual": float(report.residual),
        "certificate": result.certificate,
        "newton_iterations": int(report.iterations),
        "iterations": len(history),
        "rejected": sum(record["outcome"] != "accepted" for record in history),
        "loss": [record["loss"] for record in history],
        "history": history,
        "remeshed": result.course.remeshed,
        "iou": {"start": before.iou, "end": after.iou} if result.views.has_mask else None,
        "fabric": named_values(
            result.problem.tables.fabric, np.asarray(result.end.unknowns.log_stiffness)
        ),
        "pin_shift_m": np.asarray(result.end.unknowns.pin_shift).tolist(),
        "weights": dict(result.problem.options.active_weights),
        "settings": dict(result.state.settings),
        "chamfer_cm": None,
        "scan_cm": None,
        "landmarks_cm": None,
        "rules": [rule.name for rule in result.problem.rules],
        "known": {"missing": _NO_DERIVATIVE}
        if result.known is None
        else knowledge_report(result.problem, result.pattern, result.known),
        "edge_length_error": None,
    }
    if before.chamfer is not None:
        content["chamfer_cm"] = {"start": before.chamfer, "end": after.chamfer}
    if before.scan is not None:
        content["scan_cm"] = {"start": before.scan, "end": after.scan}
    if before.landmarks is not None:
        content["landmarks_cm"] = {"start": before.landmarks, "end": after.landmarks}
    if before.median_length_error is not None:
        content["edge_length_error"] = {
            name: {"median": e.median_length_error, "max": e.largest_length_error}
            for name, e in (("start", before), ("end", after))
        }
    return content
