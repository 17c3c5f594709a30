"""Iterations of a fit, with checkpoints and new meshes on the way (S9, S13)."""

import dataclasses
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dress_jax.application.drape import DrapeOptions, garment_state, put_on
from dress_jax.application.fit_problem import fit_problem
from dress_jax.application.fit_session import (
    Course,
    as_record,
    finite_or_none,
    load_course,
    load_mesh,
    load_progress,
    save_mesh,
    save_progress,
)
from dress_jax.application.progress import Progress
from dress_jax.application.targets import TargetViews
from dress_jax.application.wearer import Wearer
from dress_jax.core.errors import InputError
from dress_jax.io.results import DrapedState
from dress_jax.optimisation import (
    AnyState,
    FitInfo,
    FitOptions,
    FitProblem,
    carry_over,
    cost,
    distortion,
    finished,
    fit,
    init,
    pulled_back,
)
from dress_jax.optimisation.problem import validated_pattern
from dress_jax.pattern import (
    Discretization,
    Pattern,
    PatternParameters,
    discretize,
    with_parameters,
)
from dress_jax.pattern.rules import Rule

CHECKPOINT_EVERY = 5
_PATIENCE = 1.5  # factor on the distortion that is borne after a new mesh could not be put on


class FitInterrupted(Exception):
    """The user stopped a fit; its checkpoint is written.

    Args:
        iteration: iterations that the checkpoint holds.
    """

    def __init__(self, iteration: int):
        super().__init__(f"stopped after iteration {iteration}")
        self.iteration = iteration


@dataclasses.dataclass(frozen=True)
class FitInputs:
    """Everything that a fit depends on.

    Attributes:
        pattern: where it begins.
        wearer: the body.
        views: what is fitted to.
        drape_options, fit_options: settings.
        rules: of the design.
    """

    pattern: Pattern
    wearer: Wearer
    views: TargetViews
    drape_options: DrapeOptions
    fit_options: FitOptions
    rules: tuple[Rule, ...] = ()

    def mesh(self, parameters: PatternParameters) -> Discretization:
        """A mesh of the pattern with other parameters."""
        pattern = with_parameters(self.pattern, parameters)
        return discretize(pattern, self.drape_options.edge_length)

    def put_on(
        self, discretization: Discretization, problem: FitProblem, progress: Progress
    ) -> tuple[DrapedState, str]:
        """The garment of a new mesh: as it was fitted, or where that cannot be put on as it began.

        The fitted garment comes to hang as it would for anyone who drapes it; the initial one is
        known to go on (S13.4).

        Returns:
            The garment, and which of the two it is.

        Raises:
            InputError: neither can be put on.
        """
        meshed = np.asarray(discretization.meshed_positions)
        try:
            return self._put_on(discretization, meshed, progress), "fitted pattern"
        except InputError:
            rest = pulled_back(problem, discretization)
            return self._put_on(discretization, rest, progress), "initial pattern"

    def _put_on(
        self, discretization: Discretization, rest: np.ndarray, progress: Progress
    ) -> DrapedState:
        dressed = put_on(discretization, rest, self.wearer, self.drape_options, progress=progress)
        return garment_state(
            discretization,
            rest,
            dressed.positions,
            dressed,
            self.wearer,
            self.drape_options,
            source=self.pattern.source,
        )

    def problem(self, discretization: Discretization, start: DrapedState) -> FitProblem:
        """The problem on one mesh of the pattern, from what the folder keeps of it."""
        return fit_problem(
            self.pattern,
            discretization,
            start,
            self.views,
            self.drape_options,
            self.fit_options,
            self.rules,
        )


class FitRun(NamedTuple):
    """A fit that has come to its end.

    Attributes:
        first, begin: the problem on the first mesh, and the first state.
        problem, state: the problem on the last mesh, and the last state.
        start: a garment of the last mesh.
        course: what happened on the way.
    """

    first: FitProblem
    begin: AnyState
    problem: FitProblem
    state: AnyState
    start: DrapedState
    course: Course


def run_fit(
    inputs: FitInputs,
    discretization: Discretization,
    start: DrapedState,
    folder: Path,
    *,
    resume: bool,
    progress: Progress,
) -> FitRun:
    """Iterate to the end, or on from the folder's checkpoint.

    Args:
        inputs: what is fitted.
        discretization: of the initial pattern.
        start: its drape.
        folder: for checkpoints and meshes.
        resume: go on from the checkpoint.
        progress: told about every iteration.

    Raises:
        InputError: the checkpoint does not fit, or the initial pattern does not drape.
        FitInterrupted: on Ctrl-C.
    """
    first = inputs.problem(discretization, start)
    course = load_course(folder) if resume else None
    if course is None:
        progress("fit", 0, first.options.iterations)
        begin = init(first, start.garment.vertices, clock=time.perf_counter)
        run = _Run(inputs, folder, progress, begin, first, begin, start, Course())
        run.save()
    else:
        problem = first
        if course.mesh:
            start, meshed = load_mesh(folder, course.mesh)
            problem = inputs.problem(inputs.mesh(meshed), start)
        begin, state = load_progress(folder, first, problem)
        run = _Run(inputs, folder, progress, begin, problem, state, start, course)
    try:
        run.to_the_end()
    except KeyboardInterrupt as error:
        done = int(run.state.iteration)
        # The last record may be of an iteration whose state was not kept any more.
        run.course = dataclasses.replace(run.course, history=run.course.history[:done])
        run.save()
        raise FitInterrupted(done) from error
    run.save()
    return FitRun(first, begin, run.problem, run.state, run.start, run.course)


@dataclasses.dataclass
class _Run:
    """The moving parts of a fit; `state` always belongs to `problem`."""

    inputs: FitInputs
    folder: Path
    progress: Progress
    begin: AnyState
    problem: FitProblem
    state: AnyState
    start: DrapedState
    course: Course

    def save(self) -> None:
        """Write a checkpoint."""
        save_progress(self.folder, self.begin, self.state, self.course)

    def to_the_end(self) -> None:
        """Iterate; put the garment on again where triangles or a rest ask for it (S13.1)."""
        options = self.problem.options
        self.progress("fit", len(self.course.history), options.iterations)
        while True:
            if self.distorted(self.state):
                self.begin_again(unless_worse=False)
            fit(
                self.problem,
                self.state,
                on_iteration=self.after_iteration,
                clock=time.perf_counter,
            )
            if not finished(self.problem, self.state):
                continue
            early = int(self.state.iteration) < options.iterations
            if not early or self.course.refreshed >= options.refreshes:
                return
            if not self.begin_again(unless_worse=True):
                return

    def distorted(self, state: AnyState) -> bool:
        """Whether the state's mesh is not borne any more."""
        limit = self.course.borne or self.problem.options.remesh_distortion
        return distortion(self.problem, state.unknowns.pattern) > limit

    def after_iteration(self, state: AnyState, info: FitInfo) -> bool:
        """Keep what was reached; True ends the iterations on this mesh."""
        record = as_record(info, state)
        # In this order: an interrupt in between leaves a surplus record, which is cut off.
        self.course.history.append(record)
        self.state = state
        count = len(self.course.history)
        if count % CHECKPOINT_EVERY == 0:
            self.save()
        self.progress("fit", count, self.problem.options.iterations, loss=record["loss"])
        return self.distorted(state)

    def begin_again(self, *, unless_worse: bool) -> bool:
        """Put the garment on again with a mesh of the fitted pattern, and go on from there.

        Where that fails the fit goes on as it is, until triangles are worse by a factor.

        Args:
            unless_worse: keep the old drape where the new one fits the pictures less. A fold that
                snapped early may stay to the end of a fit; a garment that is put on anew has none
                but its own.

        Returns:
            Whether the fit goes on with the new mesh.
        """
        began, before = time.perf_counter(), distortion(self.problem, self.state.unknowns.pattern)
        record: dict[str, Any] = {
            "iteration": int(self.state.iteration),
            "distortion": finite_or_none(before),
        }
        course, inputs, number = self.course, self.inputs, self.course.mesh + 1
        meshed = validated_pattern(self.problem, self.state.unknowns.pattern)
        state = None
        try:
            discretization = inputs.mesh(meshed)
            start, record["put_on"] = inputs.put_on(discretization, self.problem, self.progress)
            problem = inputs.problem(discretization, start)
            state, info = carry_over(
                self.problem,
                self.state,
                problem,
                start.garment.vertices,
                clock=time.perf_counter,
            )
            record |= {
                "outcome": info.outcome.value,
                "loss": finite_or_none(info.loss),
                "iou": finite_or_none(info.iou),
            }
        except InputError as error:
            record["outcome"] = str(error)
        if state is not None and unless_worse:
            costs = [cost(s) for s in (self.state, state)]
            record["cost"] = costs
            if not costs[1] < costs[0]:
                state, record["outcome"] = None, "not better"
        record["seconds"] = time.perf_counter() - began
        if unless_worse:
            course = dataclasses.replace(course, refreshed=course.refreshed + 1)
        if state is None:
            if not unless_worse:
                course = dataclasses.replace(course, borne=_PATIENCE * before)
        else:
            record["vertices"] = discretization.vertex_count
            save_mesh(self.folder, number, start, meshed)
            course = dataclasses.replace(course, mesh=number, borne=None)
            self.problem, self.state, self.start = problem, state, start
        self.course = dataclasses.replace(course, remeshed=[*course.remeshed, record])
        self.save()
        return state is not None
