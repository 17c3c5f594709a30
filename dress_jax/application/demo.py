"""The demonstration: a dress is draped and photographed, and recovered from wrong measurements."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from dress_jax.application.drape import (
    DrapeOptions,
    DrapeResult,
    drape_pattern,
    drape_report,
    draped_state,
    save_drape,
)
from dress_jax.application.fit import FitResult, fit_pattern, fit_report, scheduled
from dress_jax.application.fit_files import save_fit
from dress_jax.application.progress import Progress, silent
from dress_jax.application.tailor import template_measurements
from dress_jax.application.targets import draw_targets, read_targets, write_targets
from dress_jax.application.wearer import find_wearer
from dress_jax.body.model import named_shape
from dress_jax.io.bodies import load_default_body
from dress_jax.io.patterns import save_pattern
from dress_jax.pattern.model import Pattern
from dress_jax.pattern.scaling import scaled
from dress_jax.pattern.templates import sleeveless_dress

POSE = "a"
WRONG_WIDTH, WRONG_LENGTH = 1.15, 1.20
"""Factors of the wrong measurements: too wide and too long."""


@dataclasses.dataclass(frozen=True)
class DemoOptions:
    """How much the demonstration computes.

    Attributes:
        edge_length: of the cloth's triangles [m].
        views: target views around the body.
        size: their height and width [px].
        iterations: of the fit, at most.
    """

    edge_length: float = 0.03
    views: int = 8
    size: int = 256
    iterations: int = 40


@dataclasses.dataclass(frozen=True)
class DemoResult:
    """What the demonstration did.

    Attributes:
        observed: the drape of the true pattern.
        fit: the recovered one.
        report: of the fit.
        folder: where everything is: `observed/`, `targets/`, `fit/`, `start.json`.
    """

    observed: DrapeResult
    fit: FitResult
    report: dict[str, Any]
    folder: Path

    @property
    def good(self) -> bool:
        """Both drapes converged and are free of intersections."""
        return self.observed.good and self.fit.good


def demo_patterns() -> tuple[Pattern, Pattern]:
    """The true dress, made to measure for the default body, and the wrong one to begin with."""
    model = load_default_body()
    true = sleeveless_dress(template_measurements(model, np.asarray(named_shape(model, "average"))))
    return true, scaled(true, {"*": (WRONG_WIDTH, WRONG_LENGTH)})


def run_demo(
    folder: str | Path, *, options: DemoOptions | None = None, progress: Progress = silent
) -> DemoResult:
    """Drape and photograph a dress, then recover its pattern from wrong measurements.

    Args:
        folder: where to.
        options: see `DemoOptions`.
        progress: told about every stage.

    Raises:
        InputError: the folder cannot be written to.
    """
    folder = Path(folder)
    options = DemoOptions() if options is None else options
    true, wrong = demo_patterns()
    drape_options = DrapeOptions(edge_length=options.edge_length)
    wearer = find_wearer("default", dressing_pose=POSE)

    observed = drape_pattern(true, wearer, options=drape_options, progress=progress)
    save_drape(folder / "observed", observed, drape_report(observed))
    state = draped_state(observed)
    targets = draw_targets(state, views=options.views, size=options.size, progress=progress)
    write_targets(folder / "targets", targets, state.garment)
    save_pattern(wrong, folder / "start.json")

    result = fit_pattern(
        wrong,
        wearer,
        read_targets(folder / "targets"),
        folder / "fit",
        drape_options=drape_options,
        fit_options=scheduled(options.iterations),
        truth=true,
        progress=progress,
    )
    report = fit_report(result)
    save_fit(folder / "fit", result, report)
    return DemoResult(observed=observed, fit=result, report=report, folder=folder)
