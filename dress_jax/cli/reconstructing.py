"""The command `reconstruct`. Heavy imports wait until it runs."""

import enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dress_jax.cli.bundling import SourceName
from dress_jax.cli.draping import (
    EdgeLength,
    FabricName,
    FabricOf,
    Membrane,
    MembraneName,
    NewtonLimit,
    drape_options,
)
from dress_jax.cli.outcome import ExitCode, command
from dress_jax.cli.show import stages, table, wrote

if TYPE_CHECKING:
    from dress_jax.application.stages import StageOutcome


class Masks(enum.Enum):
    """Where masks come from; values as in `application.completion.MaskSource`."""

    GIVEN = "given"
    SCAN = "scan"
    PARSER = "parser"


class Texture(enum.Enum):
    """Where the texture comes from; values as in `application.texture.Mode`, and none."""

    TILE = "tile"
    BAKE = "bake"
    NONE = "none"


StageName = str | None


@command
def reconstruct(
    given: Annotated[
        Path, typer.Argument(metavar="INPUT", help="Photograph, bundle, or input of --source.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the stages; gone on with where it is.")],
    source: Annotated[
        SourceName | None,
        typer.Option(
            help="Format of INPUT; see docs/observations.md. A bundle is known by itself, anything "
            "else is a photograph unless named."
        ),
    ] = None,
    first: Annotated[
        StageName, typer.Option("--from", metavar="STAGE", help="Make again from this stage on.")
    ] = None,
    last: Annotated[
        StageName, typer.Option("--until", metavar="STAGE", help="Stop after this stage.")
    ] = None,
    pattern: Annotated[
        Path | None,
        typer.Option(help="Start pattern; else the input's, else a template of ours."),
    ] = None,
    truth: Annotated[
        Path | None, typer.Option(help="The true pattern (JSON), to measure against.")
    ] = None,
    masks: Annotated[
        Masks | None,
        typer.Option(help="Masks of the clothes: those given, drawn from the scan, or parsed."),
    ] = None,
    view_size: Annotated[int, typer.Option(min=64, help="Longest side of the views [px].")] = 512,
    body: Annotated[
        str, typer.Option(help="'default', an SMPL-X .npz file, or a static mesh in metres.")
    ] = "default",
    body_pose: Annotated[
        str | None,
        typer.Option(help="The body's pose, where it is known: t, a, relaxed, or an .npz file."),
    ] = None,
    shape: Annotated[
        str, typer.Option(help="The body's shape, where it is known, as for `drape`.")
    ] = "average",
    keep_body: Annotated[
        bool,
        typer.Option("--keep-body", help="Take the input's SMPL-X estimate as it is, on --body."),
    ] = False,
    body_iterations: Annotated[
        int, typer.Option(min=0, help="Steps of the body fit by pictures.")
    ] = 100,
    height: Annotated[
        float | None,
        typer.Option(help="The person's height [m]: of a photograph, magicman and pshuman."),
    ] = None,
    pose: Annotated[
        str | None, typer.Option(help="sewfactory: static (unless given), or such as 0000.")
    ] = None,
    frame: Annotated[str | None, typer.Option(help="4d-dress: such as 00011.")] = None,
    matte: Annotated[
        Path | None, typer.Option(help="Photograph: the matte, unless the picture has alpha.")
    ] = None,
    edge_length: EdgeLength = 0.02,
    fabric: FabricName = "cotton",
    fabric_of: FabricOf = None,
    membrane: MembraneName = Membrane.ARAP,
    newton_limit: NewtonLimit = 300,
    iterations: Annotated[int, typer.Option(min=0, help="Steps of the fit at most.")] = 60,
    texture: Annotated[Texture, typer.Option(help="As for `texture`, or none.")] = Texture.TILE,
) -> ExitCode:
    """From pictures to a fitted pattern on the body: all stages, and a page that shows them.

    Stages are bundle, body, pattern, drape, fit, texture, report. Complete ones are kept while
    their inputs stay the same; after Ctrl-C or a failure the same command goes on.
    """
    from dress_jax.application.bundle import Source
    from dress_jax.application.completion import MaskSource
    from dress_jax.application.found_body import BodyOptions
    from dress_jax.application.reconstruct import ReconstructOptions
    from dress_jax.application.reconstruct import reconstruct as run
    from dress_jax.application.stages import Stopped
    from dress_jax.application.texture import Mode
    from dress_jax.io.capture.bundles import is_bundle

    if source is None:
        source = SourceName.BUNDLE if is_bundle(given) else SourceName.PHOTO
    scaled = source in (SourceName.MAGICMAN, SourceName.PSHUMAN)
    options = ReconstructOptions(
        source=Source(source.value),
        reader={"height": height if scaled else None, "pose": pose, "frame": frame, "matte": matte},
        masks=None if masks is None else MaskSource(masks.value),
        view_size=view_size,
        body=BodyOptions(
            body=body,
            pose=body_pose,
            shape=shape,
            keep_estimate=keep_body,
            iterations=body_iterations,
            height=None if scaled else height,
        ),
        pattern=pattern,
        truth=truth,
        drape=drape_options(edge_length, fabric, fabric_of, membrane, newton_limit),
        iterations=iterations,
        texture=None if texture is Texture.NONE else Mode(texture.value),
    )
    try:
        with stages() as progress:
            outcomes = run(
                given, out, options=options, first=first, last=last, tell=_tell, progress=progress
            )
    except Stopped as stop:
        typer.echo(f"{stop}; the same command goes on from there", err=True)
        return ExitCode.INTERRUPTED
    rows = [_row(outcome) for outcome in outcomes]
    table(given.stem, rows, header=("stage", "", "sound", "seconds"))
    wrote(*(outcome.folder for outcome in outcomes if outcome.name != "report"))
    wrote(*(outcome.folder / "index.html" for outcome in outcomes if outcome.name == "report"))
    return ExitCode.DONE if all(o.result.good for o in outcomes) else ExitCode.NOT_SOUND


def _tell(outcome: "StageOutcome") -> None:
    why = f" (changed: {', '.join(outcome.because)})" if outcome.because else ""
    typer.echo(f"{outcome.name}: {outcome.ending.value}{why}", err=True)
    for note in (outcome.result.skipped, *outcome.result.notes):
        if note:
            typer.echo(f"  {note}", err=True)


def _row(outcome: "StageOutcome") -> tuple[Any, ...]:
    return outcome.name, outcome.ending.value, outcome.result.good, round(outcome.seconds, 1)
