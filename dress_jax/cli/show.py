"""What commands write: progress on standard error, tables on standard output."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from dress_jax.io.progress import Report, progress


class Stages:
    """Shows the stages of a workflow one after the other; see `application.progress.Progress`."""

    def __init__(self) -> None:
        self._stack = contextlib.ExitStack()
        self._stage: str | None = None
        self._report: Report | None = None

    def __call__(self, stage: str, done: int, total: int, *, loss: float | None = None) -> None:
        """Report, and begin a new stage where the name is new."""
        if stage != self._stage or self._report is None:
            self._stack.close()
            self._stage = stage
            self._report = self._stack.enter_context(progress(stage, total=total))
        self._report(done, loss)

    def close(self) -> None:
        """End the last stage."""
        self._stack.close()
        self._stage = self._report = None


@contextlib.contextmanager
def stages() -> Iterator[Stages]:
    """A progress display for the length of a block."""
    display = Stages()
    try:
        yield display
    finally:
        display.close()


def table(title: str, rows: Mapping[str, Any] | Sequence[Sequence[Any]], *, header=()) -> None:
    """Print a table: name and value, or columns under a header."""
    lines = list(rows.items()) if isinstance(rows, Mapping) else rows
    width = max((len(line) for line in lines), default=2)
    made = Table(title=title, title_justify="left", show_header=bool(header))
    for k in range(width):
        made.add_column(header[k] if header else "", justify="left" if k == 0 else "right")
    for line in lines:
        made.add_row(*(Text(cell(value)) for value in line))
    Console().print(made)


def cell(value: Any) -> str:
    """A value as a short text."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)


def wrote(*paths: Path) -> None:
    """Say where results are, one unwrapped line each."""
    for path in paths:
        Console().print(f"wrote {path}", soft_wrap=True, highlight=False, markup=False)
