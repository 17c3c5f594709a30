"""Progress on the terminal: a live line where there is one, sparse plain lines elsewhere."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

# Reports a finished iteration: its number from 1, and the loss where there is one.
Report = Callable[..., None]
# Without a terminal one line is printed per this share of the work, but not more often than this.
PLAIN_SHARE = 0.1
PLAIN_SECONDS = 10.0


@contextlib.contextmanager
def progress(
    stage: str, *, total: int, stream: TextIO | None = None, clock: Callable[[], float] = time.time
) -> Iterator[Report]:
    """Show how a stage advances.

    Usage: `with progress("drape", total=100) as report: report(1, loss=0.5)`.

    Args:
        stage: what is being done.
        total: number of iterations.
        stream: where to write, standard error by default so that results can be piped.
        clock: seconds, for tests.

    Yields:
        `report(iteration, loss=None)`, to be called after each iteration.
    """
    output: TextIO = sys.stderr if stream is None else stream
    if output.isatty():
        with _live(stage, total, output) as report:
            yield report
    else:
        yield _plain(stage, total, output, clock)


@contextlib.contextmanager
def _live(stage: str, total: int, stream: TextIO) -> Iterator[Report]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        TextColumn("{task.completed:.0f}/{task.total:.0f}"),
        TextColumn("{task.fields[loss]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(file=stream)) as display:
        task = display.add_task(stage, total=total, loss="")

        def report(iteration: int, loss: float | None = None) -> None:
            display.update(task, completed=iteration, loss=_loss(loss))

        yield report


def _plain(stage: str, total: int, stream: TextIO, clock: Callable[[], float]) -> Report:
    started = clock()
    printed = {"time": started, "share": 0.0}

    def report(iteration: int, loss: float | None = None) -> None:
        now, share = clock(), iteration / max(total, 1)
        due = share - printed["share"] >= PLAIN_SHARE and now - printed["time"] >= PLAIN_SECONDS
        if not (due or iteration == total):
            return
        printed.update(time=now, share=share)
        left = (now - started) * (1.0 - share) / share if share > 0.0 else float("nan")
        parts = [f"{stage}: {iteration}/{total}", _loss(loss), f"{left:.0f} s left"]
        stream.write("  ".join(part for part in parts if part) + "\n")
        stream.flush()

    return report


def _loss(loss: float | None) -> str:
    return "" if loss is None else f"loss {float(loss):.4g}"
