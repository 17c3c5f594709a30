"""The command `fit-body`. Heavy imports wait until it runs."""

from pathlib import Path
from typing import Annotated

import typer

from dress_jax.cli.outcome import ExitCode, command
from dress_jax.cli.show import stages, table, wrote


@command
def fit_body(
    views: Annotated[
        Path,
        typer.Argument(
            metavar="VIEWS",
            help="Bundle whose views have landmarks, or a folder: cameras.json, rgb/, mask/, "
            "occluded/.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    landmarks: Annotated[
        Path | None,
        typer.Option(help="Of a folder: COCO-WholeBody landmarks of every view, .npz or JSON."),
    ] = None,
    body: Annotated[str, typer.Option(help="'default', or an SMPL-X .npz file.")] = "default",
    estimate: Annotated[
        Path | None, typer.Option(help="Estimated pose and shape (.npz) to stay near.")
    ] = None,
    iterations: Annotated[
        int, typer.Option(min=0, help="Steps of the fine stage, by pictures.")
    ] = 100,
    views_per_iteration: Annotated[
        int, typer.Option(min=1, help="Views whose pictures a step looks at.")
    ] = 5,
) -> ExitCode:
    """Reconstruct a body from views of a person with landmarks."""
    from dress_jax.application.body_views import read_body_views
    from dress_jax.application.reconstruct_body import body_report, reconstruct_body, save_body
    from dress_jax.io.results import prepare_folder
    from dress_jax.io.timing import stopwatch
    from dress_jax.reconstruction import ReconstructionOptions

    seen = read_body_views(views, landmarks)
    prepare_folder(out)
    options = ReconstructionOptions(
        fine_iterations=iterations, views_per_iteration=views_per_iteration
    )
    with stopwatch() as seconds, stages() as progress:
        result = reconstruct_body(
            seen, body=body, estimate=estimate, options=options, progress=progress
        )
    report = body_report(result)
    report["seconds"] = {"compile": seconds.compile, "run": seconds.run}
    save_body(out, result, report)
    fine = report["fine"]
    rows = [
        ("views", report["views"]),
        ("landmarks seen", report["landmarks_seen"]),
        ("landmark error [px]", report["landmark_error_px"]),
        ("scale", report["scale"]),
        ("height as posed [m]", report["height_m"]),
    ]
    if fine["start"] is not None:
        for name in ("mask", "rgb"):
            change = f"{fine['start'][name]:.3g} to {fine['end'][name]:.3g}"
            rows.append((f"{name} error, before and after", change))
    rows.append(("seconds compiling / running", f"{seconds.compile:.0f} / {seconds.run:.0f}"))
    table("body", rows)
    wrote(*(out / name for name in ("body.obj", "body.npz", "comparison.png", "report.json")))
    return ExitCode.DONE if result.good else ExitCode.NOT_SOUND
