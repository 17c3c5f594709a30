"""How a command ends: exit codes, and one line for what the user can mend."""

import enum
import functools
import inspect
from collections.abc import Callable

import typer

from dress_jax.cli.environment import prepare
from dress_jax.core.errors import InputError


class ExitCode(enum.IntEnum):
    """Exit codes of the commands."""

    DONE = 0
    BAD_INPUT = 2
    NOT_SOUND = 3  # not converged, or not free of intersections
    INTERRUPTED = 130  # what a shell reports after Ctrl-C


def command(function: Callable[..., ExitCode]) -> Callable[..., None]:
    """Turn a function that returns an exit code into a command.

    The process is set up only here, so that help and usage errors need no jax.
    """

    @functools.wraps(function)
    def run(*, context: typer.Context, **options) -> None:
        warning = prepare((context.obj or {}).get("cache"))
        if warning:
            typer.echo(f"warning: {warning}", err=True)
        try:
            code = function(**options)
        except InputError as error:
            typer.echo(f"error: {error}", err=True)
            code = ExitCode.BAD_INPUT
        except KeyboardInterrupt:
            typer.echo("stopped", err=True)
            code = ExitCode.INTERRUPTED
        raise typer.Exit(int(code))

    # What typer reads: the function's own options, and the context that holds the global ones.
    own = inspect.signature(function)
    context = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
    run.__annotations__ = {**function.__annotations__, "context": typer.Context, "return": None}
    run.__signature__ = own.replace(  # type: ignore[attr-defined]
        parameters=[*own.parameters.values(), context], return_annotation=None
    )
    return run
