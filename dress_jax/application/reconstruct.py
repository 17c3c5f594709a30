"""The whole way from pictures to a fitted, textured garment, stage by stage (S4, S6 to S9, S14).

    bundle -> body -> pattern -> drape -> fit -> texture -> report

Every stage is an ordinary workflow of this package in a folder of its own (`application.stages`),
so that each can be looked at, edited, and begun from again.
"""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from dress_jax.application.bundle import Source, make_bundle, write_bundle
from dress_jax.application.bundle_targets import bundle_pictures, bundle_targets, true_garment
from dress_jax.application.completion import MaskSource, complete_bundle
from dress_jax.application.drape import (
    DrapeOptions,
    drape_pattern,
    drape_report,
    save_drape,
)
from dress_jax.application.fit import fit_pattern, fit_report, scheduled
from dress_jax.application.fit_files import save_fit
from dress_jax.application.fit_run import FitInterrupted
from dress_jax.application.fit_session import START
from dress_jax.application.found_body import (
    BodyOptions,
    find_body,
    load_wearer,
    measurements_of,
    moved_bundle,
    why_no_fit,
)
from dress_jax.application.page import write_page
from dress_jax.application.progress import Progress, silent
from dress_jax.application.stages import Stage, StageOutcome, StageResult, run_stages
from dress_jax.application.start_pattern import front_view, on_the_floor, symmetric, template_for
from dress_jax.application.texture import (
    Mode,
    TextureOptions,
    save_texture,
    texture_garment,
    texture_report,
)
from dress_jax.capture.bundle import Bundle
from dress_jax.capture.frames import view_azimuth
from dress_jax.core.errors import InputError
from dress_jax.io.atomic import write_text
from dress_jax.io.capture.bundles import load_bundle
from dress_jax.io.documents import read_json, write_json
from dress_jax.io.patterns import load_pattern, save_pattern
from dress_jax.io.report import write_report
from dress_jax.io.results import read_state
from dress_jax.io.timing import stopwatch
from dress_jax.optimisation import FitOptions
from dress_jax.optimisation.gauss_newton.options import GaussNewtonOptions
from dress_jax.pattern.drawing import drawing

# One view, and a body that is assumed in part: a tighter prior, which stays at the template.
_ONE_VIEW = GaussNewtonOptions(
    shape_scale=0.08, size_scale=0.25, control_scale=0.04, seam_scale=0.005, recenterings=0
)

STAGES = ("bundle", "body", "pattern", "drape", "fit", "texture", "report")
BUNDLE, FACTS = "bundle.h5", "facts.json"


@dataclasses.dataclass(frozen=True)
class ReconstructOptions:
    """What is reconstructed, and how.

    Attributes:
        source: format of the input.
        reader: options of its reader, see `application.bundle.make_bundle`.
        masks: where masks of the clothes come from; None takes the best there is.
        view_size: longest side of the views [px].
        body: which body wears the garment.
        pattern: where the fit begins; None for the input's own pattern, or else a template.
        truth: the true pattern, to measure against.
        drape: mesh, fabric and contact of every drape.
        iterations: of the fit.
        texture: None for none. A tile that cannot be cut is baked instead, and the report says so.
    """

    source: Source = Source.PHOTO
    reader: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    masks: MaskSource | None = None
    view_size: int = 512
    body: BodyOptions = dataclasses.field(default_factory=BodyOptions)
    pattern: Path | None = None
    truth: Path | None = None
    drape: DrapeOptions = dataclasses.field(default_factory=DrapeOptions)
    iterations: int = 60
    texture: Mode | None = Mode.TILE


def reconstruct(
    path: str | Path,
    folder: str | Path,
    *,
    options: ReconstructOptions | None = None,
    first: str | None = None,
    last: str | None = None,
    tell: Callable[[StageOutcome], None] | None = None,
    progress: Progress = silent,
) -> tuple[StageOutcome, ...]:
    """Reconstruct garment and body of an input, or go on with it.

    Args:
        path: the input, of the options' source.
        folder: for the stages; one that has some is gone on with.
        options: see `ReconstructOptions`.
        first: made again from this stage on, see `STAGES`.
        last: the stage to end with.
        tell: called after every stage.
        progress: told about everything that takes time.

    Returns:
        The stages, complete; their results say whether each is sound.

    Raises:
        InputError: bad input, or a stage that cannot do its work; the stage is named.
        Stopped: on Ctrl-C.
    """
    options = ReconstructOptions() if options is None else options
    run = _Run(Path(path), Path(folder), options, progress)
    return run_stages(folder, run.stages(), first=first, last=last, tell=tell)


@dataclasses.dataclass(frozen=True)
class _Run:
    """The stages of one reconstruction, and where they find each other."""

    given: Path
    folder: Path
    options: ReconstructOptions
    progress: Progress

    def stages(self) -> list[Stage]:
        """All stages with everything that they depend on."""
        o = self.options
        files = {n: Path(f) for n, f in (("pattern file", o.pattern),) if f is not None}
        truth = {"truth": Path(o.truth)} if o.truth is not None else {}
        own_body = Path(o.body.body)
        body_file = {"body file": own_body} if own_body.suffix else {}
        reader = {k: Path(v) if k == "matte" else v for k, v in o.reader.items() if v is not None}
        seen = {"input": self.given, "source": o.source, "reader": reader}
        fits = [o.body.known, o.body.keep_estimate, o.body.body]
        views = {"masks": o.masks, "view size": o.view_size, "body": fits}
        return [
            Stage("bundle", seen | views, (), self._bundle),
            Stage("body", {"options": o.body} | body_file, ("bundle",), self._body),
            Stage("pattern", files, ("bundle", "body"), self._pattern),
            Stage("drape", {"options": o.drape}, ("body", "pattern"), self._drape),
            Stage(
                "fit",
                {"options": o.drape, "iterations": o.iterations} | truth,
                ("bundle", "body", "pattern", "drape"),
                self._fit,
                resumes=True,
            ),
            Stage("texture", {"mode": o.texture}, ("bundle", "body", "fit"), self._texture),
            Stage("report", {"input": str(self.given)}, STAGES[:-1], self._report),
        ]

    def _bundle(self, work: Path) -> StageResult:
        o = self.options
        bundle = make_bundle(self.given, o.source, progress=self.progress, **o.reader)
        done = complete_bundle(
            bundle,
            masks=o.masks,
            longest_side=o.view_size,
            landmarks=not why_no_fit(bundle, o.body),
            progress=self.progress,
        )
        write_bundle(work / BUNDLE, done.bundle)
        write_json(work / FACTS, {"single_view": done.single_view})
        return StageResult(notes=done.notes)

    def _body(self, work: Path) -> StageResult:
        bundle, o = self._observed(), self.options.body
        good, notes = find_body(
            work, bundle, options=o, single_view=self._single_view(), progress=self.progress
        )
        return StageResult(good=good, notes=notes, skipped=why_no_fit(bundle, o))

    def _pattern(self, work: Path) -> StageResult:
        bundle = self._observed()
        wearer, offset = load_wearer(self.folder / "body")
        notes: list[str] = []
        if self.options.pattern is not None:
            pattern = load_pattern(self.options.pattern)
            notes.append(f"The start pattern is {self.options.pattern.name}.")
        elif bundle.pattern is not None:
            pattern = bundle.pattern
            notes.append(f"The start pattern came with the input: {bundle.sources['pattern']}.")
        else:
            view = front_view(moved_bundle(bundle, offset).views)
            pattern, chosen = template_for(view, wearer, measurements_of(self.folder / "body"))
            notes += chosen
        stature = float(wearer.start[:, 1].max() - wearer.start[:, 1].min())
        pattern, moved = on_the_floor(pattern, stature)
        pattern, mirrored = symmetric(pattern)
        notes += [note for note in (moved, mirrored) if note]
        save_pattern(pattern, work / "pattern.json")
        write_text(work / "pattern.svg", drawing(pattern))
        return StageResult(notes=tuple(notes))

    def _drape(self, work: Path) -> StageResult:
        wearer, _ = load_wearer(self.folder / "body")
        pattern = load_pattern(self.folder / "pattern" / "pattern.json")
        with stopwatch() as seconds:
            result = drape_pattern(
                pattern, wearer, options=self.options.drape, progress=self.progress
            )
            report = drape_report(result)
        report["seconds"] = dataclasses.asdict(seconds)
        save_drape(work, result, report)
        notes = [] if result.good else [f"The start drape is not sound: {report['result']}"]
        for name, stretch in sorted(report["tight_panels"].items()):
            notes.append(f"The start pattern's panel {name} is {stretch - 1.0:.0%} too small.")
        return StageResult(good=result.good, notes=tuple(notes))

    def _fit(self, work: Path) -> StageResult:
        wearer, offset = load_wearer(self.folder / "body")
        bundle = moved_bundle(self._observed(), offset)
        draped = self.folder / "drape"
        crossings = read_json(draped / "report.json", what="the report of a drape")["intersections"]
        if any(crossings.values()):
            raise InputError(
                f"the start drape has {sum(crossings.values())} intersections",
                where=str(draped),
                mend="look at its preview; try a finer mesh or another start pattern",
            )
        views = dataclasses.replace(bundle_targets(bundle), truth=true_garment(bundle))
        truth = self.options.truth
        try:
            with stopwatch() as seconds:
                result = fit_pattern(
                    load_pattern(self.folder / "pattern" / "pattern.json"),
                    wearer,
                    views,
                    work,
                    drape_options=self.options.drape,
                    fit_options=self._fit_options(),
                    truth=None if truth is None else load_pattern(truth),
                    resume=(work / START).is_file(),
                    start=read_state(draped / "drape.h5"),
                    progress=self.progress,
                )
        except FitInterrupted as stop:
            raise KeyboardInterrupt from stop
        report = fit_report(result)
        report["seconds"] = dataclasses.asdict(seconds)
        save_fit(work, result, report)
        notes = () if result.good else (f"The fit is not sound: {report['result']}",)
        return StageResult(good=result.good, notes=notes)

    def _texture(self, work: Path) -> StageResult:
        mode = self.options.texture
        _, offset = load_wearer(self.folder / "body")
        bundle = moved_bundle(self._observed(), offset)
        pictures = bundle_pictures(bundle)
        if mode is None or pictures is None:
            why = "No texture was asked for." if mode is None else "A view has no colours."
            write_report(work / "report.json", {"skipped": why})
            return StageResult(skipped=why)
        state, notes = read_state(self.folder / "fit" / "drape.h5"), []
        view = view_azimuth(front_view(bundle.views).camera)
        with stopwatch() as seconds:
            try:
                made = texture_garment(
                    state,
                    pictures,
                    options=TextureOptions(mode=mode, view=view),
                    progress=self.progress,
                )
            except InputError as error:
                if mode is not Mode.TILE:
                    raise
                notes.append(f"No tile could be cut ({error.problem}): the texture is baked.")
                made = texture_garment(
                    state,
                    pictures,
                    options=TextureOptions(mode=Mode.BAKE, view=view),
                    progress=self.progress,
                )
            report = texture_report(made)
        report["seconds"] = dataclasses.asdict(seconds)
        save_texture(work, made, report)
        return StageResult(notes=tuple(notes))

    def _report(self, work: Path) -> StageResult:
        write_page(work / "index.html", self.folder, title=self.given.stem)
        return StageResult()

    def _fit_options(self) -> FitOptions:
        """One view says little of a pattern: what it leaves open stays that of the template."""
        if not self._single_view():
            return scheduled(self.options.iterations)
        return scheduled(self.options.iterations, gauss_newton=_ONE_VIEW)

    def _observed(self) -> Bundle:
        return load_bundle(self.folder / "bundle" / BUNDLE)

    def _single_view(self) -> bool:
        facts = read_json(self.folder / "bundle" / FACTS, what="facts of a bundle")
        return bool(facts["single_view"])
