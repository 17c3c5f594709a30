"""The command `texture`. Heavy imports wait until it runs."""

import enum
from pathlib import Path
from typing import Annotated

import typer

from dress_jax.cli.outcome import ExitCode, command
from dress_jax.cli.show import stages, table, wrote


class TextureMode(enum.Enum):
    """Where the texture comes from; values as in `application.texture.Mode`."""

    TILE = "tile"
    BAKE = "bake"


@command
def texture(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="Folder that `drape` or `fit` wrote.")
    ],
    targets: Annotated[
        Path, typer.Option(help="Folder of views: cameras.json, rgb/, mask/, and normal/ if any.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the textured garment.")],
    mode: Annotated[
        TextureMode,
        typer.Option(
            help="tile: a piece of the front view, made seamless, repeated over all panels; "
            "bake: every panel from all views."
        ),
    ] = TextureMode.TILE,
    view: Annotated[
        int, typer.Option(help="Name (azimuth) of the view that the tile is cut from.")
    ] = 0,
    texel_mm: Annotated[
        float | None,
        typer.Option(help="Texel of a baked atlas [mm]. Default: the finest pixel on the garment."),
    ] = None,
    tile: Annotated[
        Path | None, typer.Option(help="A tileable picture of the cloth, instead of a cut.")
    ] = None,
    tile_command: Annotated[
        str | None,
        typer.Option(
            metavar="'TOOL --in {crop} --out {tile}'",
            help="A program that makes a tileable picture of a piece of cloth.",
        ),
    ] = None,
    tile_size_cm: Annotated[
        float | None,
        typer.Option(
            help="Width of the cloth that such a picture shows [cm]. Needed with --tile; "
            "with --tile-command that of the piece unless given."
        ),
    ] = None,
) -> ExitCode:
    """Texture a garment from pictures of it; writes OBJ, GLB, previews and a report."""
    from dress_jax.application.texture import (
        Mode,
        TextureOptions,
        save_texture,
        texture_garment,
        texture_report,
    )
    from dress_jax.io.images import load_targets
    from dress_jax.io.results import prepare_folder, read_state
    from dress_jax.io.timing import stopwatch

    options = TextureOptions(
        mode=Mode(mode.value),
        view=view,
        texel_size=None if texel_mm is None else 1e-3 * texel_mm,
        tile=tile,
        tile_command=tile_command,
        tile_width=None if tile_size_cm is None else 1e-2 * tile_size_cm,
    )
    state, pictures = read_state(result / "drape.h5"), load_targets(targets)
    prepare_folder(out)
    with stopwatch() as seconds, stages() as progress:
        made = texture_garment(state, pictures, options=options, progress=progress)
        report = texture_report(made)
    report["seconds"] = {"compile": seconds.compile, "run": seconds.run}
    save_texture(out, made, report)
    rows: list[tuple] = [("mode", mode.value)]
    for name, own in report["garments"].items():
        square, found = own["square"], own["tile"]
        if square is not None:
            rows.append((f"{name}: square [px] on", f"{square['side']} on {square['panel']}"))
        if found is not None:
            size = f"{100 * found['width']:.2f} x {100 * found['height']:.2f}"
            rows.append((f"{name}: tile [cm]", size))
            rows.append((f"{name}: step across its border", max(found["wrap_jump"])))
    if "atlas" in report:
        rows.append(("atlas", f"{report['atlas']['width']} x {report['atlas']['height']}"))
        rows += [(f"{name}: seen", share["seen"]) for name, share in report["panels"].items()]
    errors = [f"{error:.3f}" for error in report["error"].values() if error is not None]
    rows.append((f"difference from views {', '.join(report['error'])}", ", ".join(errors)))
    rows.append(("seconds compiling / running", f"{seconds.compile:.0f} / {seconds.run:.0f}"))
    table("texture", rows)
    wrote(*(out / name for name in ("textured.obj", "textured.glb", "preview.png", "report.json")))
    return ExitCode.DONE
