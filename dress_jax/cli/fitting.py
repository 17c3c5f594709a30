"""The commands `fit` and `demo`. Heavy imports wait until a command runs."""

import dataclasses
import enum
from pathlib import Path
from typing import Annotated, Any

import typer

from dress_jax.cli.draping import (
    Body,
    DressingPose,
    EdgeLength,
    FabricName,
    FabricOf,
    Membrane,
    MembraneName,
    NewtonLimit,
    Out,
    PatternFile,
    Pose,
    Shape,
    drape_options,
)
from dress_jax.cli.outcome import ExitCode, command
from dress_jax.cli.show import stages, table, wrote


class Method(enum.Enum):
    """How a fit finds its steps; values as in `optimisation.FitMethod`, which is slow to import."""

    GAUSS_NEWTON = "gauss-newton"
    ADAM = "adam"


@command
def fit(
    pattern: PatternFile,
    out: Out,
    targets: Annotated[
        Path | None, typer.Option(help="Target views: a folder that `render` wrote, or a bundle.")
    ] = None,
    scan: Annotated[
        Path | None,
        typer.Option(help="Scan of the garment in metres, mesh or points, to fit to as well."),
    ] = None,
    scan_complete: Annotated[
        bool, typer.Option("--scan-complete", help="The scan shows the whole garment.")
    ] = False,
    landmarks: Annotated[
        Path | None,
        typer.Option(
            help="Points of seams and hems whose place is known (JSON), to fit to as well."
        ),
    ] = None,
    rules: Annotated[
        Path | None, typer.Option(help="Design rules (JSON) that the pattern keeps.")
    ] = None,
    body: Body = "default",
    pose: Pose = None,
    dressing_pose: DressingPose = None,
    shape: Shape = "average",
    edge_length: EdgeLength = 0.015,
    fabric: FabricName = "cotton",
    fabric_of: FabricOf = None,
    fabric_per_panel: Annotated[
        bool, typer.Option("--fabric-per-panel", help="Fit the fabric of every panel.")
    ] = False,
    warp_weft: Annotated[
        bool,
        typer.Option(
            "--warp-weft", help="Fit stiffness along warp and weft, in shear; orthotropic."
        ),
    ] = False,
    membrane: MembraneName = Membrane.ARAP,
    newton_limit: NewtonLimit = 300,
    iterations: Annotated[int, typer.Option(min=0, help="Steps at most.")] = 60,
    method: Annotated[
        Method, typer.Option(help="gauss-newton linearizes the drape; adam follows a gradient.")
    ] = Method.GAUSS_NEWTON,
    views_per_iteration: Annotated[
        int | None,
        typer.Option(min=1, help="Views that one step of adam looks at; all unless given."),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where --out stopped.")] = False,
    truth: Annotated[
        Path | None, typer.Option(help="The true pattern (JSON), to measure against.")
    ] = None,
) -> ExitCode:
    """Fit a pattern to target views, a scan, landmarks, or all of them.

    Ctrl-C stops with a checkpoint; --resume goes on exactly.
    """
    from dress_jax.application.bundle_targets import read_views
    from dress_jax.application.fit import fit_pattern, fit_report, scheduled
    from dress_jax.application.fit_files import save_fit
    from dress_jax.application.fit_run import FitInterrupted
    from dress_jax.application.targets import read_landmarks, read_scan, views_without_pictures
    from dress_jax.application.wearer import find_wearer
    from dress_jax.core.errors import InputError
    from dress_jax.io.patterns import load_pattern, load_rules
    from dress_jax.io.results import prepare_folder
    from dress_jax.io.timing import stopwatch
    from dress_jax.optimisation import FabricFreedom, FitMethod

    if targets is None and scan is None and landmarks is None:
        raise InputError(
            "there is nothing to fit to", mend="give --targets, --scan, --landmarks, or several"
        )

    cloth_options = drape_options(edge_length, fabric, fabric_of, membrane, newton_limit)
    fit_options = scheduled(
        iterations,
        method=FitMethod(method.value),
        views_per_iteration=views_per_iteration,
        fabric=FabricFreedom(per_panel=fabric_per_panel, warp_weft=warp_weft),
    )
    start = load_pattern(pattern)
    true_pattern = None if truth is None else load_pattern(truth)
    kept = () if rules is None else load_rules(rules, start)
    scanned = None if scan is None else read_scan(scan, complete=scan_complete)
    marks = () if landmarks is None else read_landmarks(landmarks)
    views = None if targets is None else read_views(targets)
    prepare_folder(out)
    wearer = find_wearer(body, pose=pose, shape=shape, dressing_pose=dressing_pose)
    if views is not None:
        views = dataclasses.replace(views, scan=scanned, landmarks=marks)
    else:
        views = views_without_pictures(wearer.vertices, scan=scanned, landmarks=marks)
    try:
        with stopwatch() as seconds, stages() as progress:
            result = fit_pattern(
                start,
                wearer,
                views,
                out,
                drape_options=cloth_options,
                fit_options=fit_options,
                truth=true_pattern,
                rules=kept,
                resume=resume,
                progress=progress,
            )
    except FitInterrupted as stop:
        typer.echo(f"{stop}; add --resume to go on from there", err=True)
        return ExitCode.INTERRUPTED
    report = fit_report(result)
    report["seconds"] = {"compile": seconds.compile, "run": seconds.run}
    save_fit(out, result, report)
    table(pattern.stem, summary(report), header=("", "start", "end"))
    wrote(out)
    return ExitCode.DONE if result.good else ExitCode.NOT_SOUND


@command
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("dress-jax-demo"),
) -> ExitCode:
    """Drape a dress, photograph it, and recover its pattern from wrong measurements."""
    from dress_jax.application.demo import run_demo
    from dress_jax.io.results import prepare_folder
    from dress_jax.io.timing import stopwatch

    prepare_folder(out)
    with stopwatch() as seconds, stages() as progress:
        result = run_demo(out, progress=progress)
    rows = summary(result.report)
    rows.append(("seconds", f"{seconds.compile:.0f} compiling", f"{seconds.run:.0f} running"))
    table("a dress, recovered from wrong measurements", rows, header=("", "start", "end"))
    wrote(
        out / "fit" / "comparison.png",
        out / "fit" / "loss.png",
        out / "observed" / "preview.png",
        out / "targets",
        out / "fit" / "report.json",
    )
    return ExitCode.DONE if result.good else ExitCode.NOT_SOUND


def summary(report: dict[str, Any]) -> list[tuple[Any, ...]]:
    """Rows of name, start and end."""
    losses = [value for value in report["loss"] if value is not None]
    crossings = report["intersections"]
    rows: list[tuple[Any, ...]] = [
        ("loss", losses[0] if losses else None, losses[-1] if losses else None),
    ]
    if report["iou"]:
        rows.append(("mask IoU", *_ends(report["iou"])))
    if report["scan_cm"]:
        rows.append(("mean distance of the scan [cm]", *_ends(report["scan_cm"])))
    if report["landmarks_cm"]:
        rows.append(("mean distance of the landmarks [cm]", *_ends(report["landmarks_cm"])))
    if report["chamfer_cm"]:
        rows.append(("Chamfer distance [cm]", *_ends(report["chamfer_cm"])))
    if report["edge_length_error"]:
        start, end = _ends(report["edge_length_error"])
        for name in ("median", "max"):
            rows.append((f"edge length error, {name}", f"{start[name]:.1%}", f"{end[name]:.1%}"))
    rows += [
        ("iterations, of them rejected", report["iterations"], report["rejected"]),
        ("intersections (self, body)", crossings["self"], crossings["body"]),
        ("converged", None, report["converged"]),
    ]
    return rows


def _ends(pair: dict[str, Any]) -> tuple[Any, Any]:
    return pair["start"], pair["end"]
