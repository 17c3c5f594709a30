"""The command `bundle`. Heavy imports wait until it runs."""

import enum
from pathlib import Path
from typing import Annotated

import typer

from dress_jax.cli.outcome import ExitCode, command
from dress_jax.cli.show import stages, table, wrote


class SourceName(enum.Enum):
    """Formats that are read; values as in `application.bundle.Source`, which is slow to import."""

    BUNDLE = "bundle"
    PHOTO = "photo"
    TARGETS = "targets"
    PHOTOGRAPH = "photograph"
    LABELS = "labels"
    OPENPOSE = "openpose"
    DWPOSE = "dwpose"
    SMPLER_X = "smpler-x"
    OSX = "osx"
    MAGICMAN = "magicman"
    MAGICMAN_BODY = "magicman-body"
    PSHUMAN = "pshuman"
    SEWFACTORY = "sewfactory"
    FOUR_D_DRESS = "4d-dress"
    CLOSE = "close"
    PATTERN = "pattern"


@command
def bundle(
    given: Annotated[Path, typer.Argument(metavar="INPUT", help="File or folder of --source.")],
    source: Annotated[SourceName, typer.Option(help="Format of INPUT; see docs/observations.md.")],
    out: Annotated[
        Path, typer.Option(help="HDF5 file (.h5, .hdf5), or a folder for anything else.")
    ],
    onto: Annotated[
        Path | None,
        typer.Option(help="Bundle to add the parts to; --out may be the same."),
    ] = None,
    replace: Annotated[
        bool, typer.Option("--replace", help="Parts may take the place of those in --onto.")
    ] = False,
    draw_masks: Annotated[
        bool, typer.Option("--draw-masks", help="Draw the views' masks from the labelled scan.")
    ] = False,
    height: Annotated[
        float | None, typer.Option(help="magicman, pshuman: the person's height [m].")
    ] = None,
    mirrored: Annotated[
        bool | None,
        typer.Option(
            "--mirrored/--upright",
            help="pshuman: whether back and left are stored as mirror images; they are unless "
            "--upright is given.",
            show_default=False,
        ),
    ] = None,
    pose: Annotated[
        str | None, typer.Option(help="sewfactory: static (unless given), or such as 0000.")
    ] = None,
    frame: Annotated[str | None, typer.Option(help="4d-dress: such as 00011.")] = None,
    table_name: Annotated[
        str | None,
        typer.Option(
            "--table",
            help="labels: whose ids they are: atr, lip, fashn, sapiens, close, 4d-dress, or own.",
        ),
    ] = None,
    person: Annotated[
        int | None, typer.Option(min=0, help="openpose, dwpose: which of several people, from 0.")
    ] = None,
    matte: Annotated[
        Path | None,
        typer.Option(help="photo, photograph: the matte, unless the picture has alpha."),
    ] = None,
    tool: Annotated[
        str | None, typer.Option(help="pattern: the tool it came from, for the record.")
    ] = None,
) -> ExitCode:
    """Collect what other tools found out about a dressed person, for `fit --targets`."""
    from dress_jax.application.bundle import Source, bundle_rows, make_bundle, write_bundle
    from dress_jax.application.photo import label_rows
    from dress_jax.io.capture.bundles import load_bundle

    with stages() as progress:
        result = make_bundle(
            given,
            Source(source.value),
            onto=None if onto is None else load_bundle(onto),
            replace=replace,
            masks=draw_masks,
            progress=progress,
            height=height,
            mirrored=mirrored,
            pose=pose,
            frame=frame,
            table=table_name,
            person=person,
            matte=matte,
            tool=tool,
        )
    preview = write_bundle(out, result)
    table(str(out), bundle_rows(result), header=("part", "what", "source"))
    if source is SourceName.PHOTO and result.labels is not None:
        table("shares of the person's pixels", label_rows(result))
    wrote(out, preview)
    return ExitCode.DONE
