"""The command `animate`. Heavy imports wait until it runs."""

from pathlib import Path
from typing import Annotated, Any

import typer

from dress_jax.cli.outcome import ExitCode, command
from dress_jax.cli.show import stages, table, wrote


@command
def animate(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder that `drape` or `fit` wrote.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the animation; made where it is missing.")],
    motion: Annotated[
        str,
        typer.Option(help="walk, turn, sway, or a file: AMASS .npz, AIST++ .pkl, .bvh."),
    ] = "walk",
    frames: Annotated[
        int | None,
        typer.Option(help="Frames, the drape's own included; 100, or all of a file, unless given."),
    ] = None,
    fps: Annotated[float, typer.Option(help="Frames per second.")] = 30.0,
    start: Annotated[float, typer.Option(help="Where a file is entered [s].")] = 0.0,
    ease: Annotated[
        float, typer.Option(help="Seconds from the drape's pose at rest into the motion.")
    ] = 0.8,
    steps: Annotated[
        int,
        typer.Option(
            min=1, help="Implicit steps of a frame; more are less damped, and take longer."
        ),
    ] = 1,
    gap_mm: Annotated[
        float, typer.Option(help="Room that is kept between parts of the body [mm].")
    ] = 6.0,
    keep_body: Annotated[
        bool,
        typer.Option("--keep-body", help="Leave bodies that intersect themselves as they are."),
    ] = False,
    no_friction: Annotated[
        bool, typer.Option("--no-friction", help="Cloth slides freely.")
    ] = False,
    preview_size: Annotated[
        int,
        typer.Option(min=0, max=2048, help="Height of the film [px]; 0 for none."),
    ] = 384,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where --out stopped.")] = False,
) -> ExitCode:
    """Move the wearer of a garment: trajectory, GLB, PC2, MDD, a film and a report.

    Every frame is free of intersections. Ctrl-C stops after a frame; --resume goes on exactly.
    """
    from dress_jax.application.animate import AnimateOptions
    from dress_jax.application.animate import animate as run
    from dress_jax.application.animation_files import save_animation
    from dress_jax.application.moving_body import MotionOptions
    from dress_jax.core.errors import InputError
    from dress_jax.io.results import prepare_folder, read_state
    from dress_jax.io.timing import stopwatch
    from dress_jax.motion.repulsion import RepulsionOptions

    if preview_size % 2:
        raise InputError(
            f"is {preview_size}", where="--preview-size", mend="give an even number, for films"
        )
    options = AnimateOptions(
        motion=MotionOptions(fps=fps, frames=frames, start=start, ease=ease),
        repulsion=None if keep_body else RepulsionOptions(gap=1e-3 * gap_mm),
        friction=not no_friction,
        steps=steps,
    )
    state = read_state(folder / "drape.h5")
    prepare_folder(out)
    with stopwatch() as seconds, stages() as progress:
        made = run(state, motion, out, options=options, resume=resume, progress=progress)
    report = {**made.report, "seconds": {"compile": seconds.compile, "run": seconds.run}}
    with stages() as progress:
        files = save_animation(out, made, report, size=preview_size, progress=progress)
    crossings, halved = report["intersections"], report["halved_steps"]
    rows: dict[str, Any] = {
        "frames": f"{report['frames']} at {report['fps']:g} per second",
        "vertices": report["vertices"],
        "intersections": f"{crossings['self']} self, {crossings['body']} body",
        "steps": f"{report['steps']}, {halved['body'] + halved['newton']} halved on the way",
        "steps that did not converge": report["unconverged_steps"],
        "steps in which cloth was squeezed": report["squeezed_steps"],
        "Newton steps": report["newton_iterations"],
        "held at the waist by": report["waist"]["held_by"],
        "seconds": f"{seconds.compile:.0f} compiling, {seconds.run:.0f} running",
    }
    if not keep_body:
        body = report["body"]
        rows["bodies not free of themselves"] = f"{body['frames_not_free']} of {body['frames']}"
        rows["largest displacement [mm]"] = 1e3 * max(body["largest_displacement_m"], default=0.0)
    for row in report["slip"]:
        if row["slipped"]:
            where = ", ".join(row["panels"])
            rows["slipped along the body [m]"] = f"{where}: {row['median_m']:.2f}"
    table(report["motion"], rows)
    wrote(*files)
    return ExitCode.DONE if made.good else ExitCode.NOT_SOUND
