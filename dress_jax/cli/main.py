"""The program `dress-jax`."""

from typing import Annotated

import typer

from dress_jax import __version__
from dress_jax.cli.animating import animate
from dress_jax.cli.body import fit_body
from dress_jax.cli.bundling import bundle
from dress_jax.cli.checking import check, gradcheck
from dress_jax.cli.draping import drape, render
from dress_jax.cli.environment import CACHE_VARIABLE
from dress_jax.cli.fitting import demo, fit
from dress_jax.cli.reconstructing import reconstruct
from dress_jax.cli.texturing import texture

app = typer.Typer(
    name="dress-jax",
    help="Sewing patterns on bodies: drape, render, fit to images, texture, animate, and check, "
    "free of intersections. Exit codes: 0 done, 2 bad input, 3 not converged or not free of "
    "intersections (results are written all the same).",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"dress-jax {__version__}")
        raise typer.Exit()


@app.callback()
def options(
    context: typer.Context,
    cache_dir: Annotated[
        str | None,
        typer.Option(
            envvar=CACHE_VARIABLE,
            help="Folder for compiled programs; 'off' for none. Default: the user's cache folder.",
        ),
    ] = None,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Options of all commands."""
    del version
    context.obj = {"cache": cache_dir}


for _command in (
    reconstruct,
    drape,
    render,
    bundle,
    fit,
    fit_body,
    texture,
    animate,
    check,
    gradcheck,
    demo,
):
    app.command()(_command)


def main() -> None:
    """Entry point of the installed program."""
    app()
