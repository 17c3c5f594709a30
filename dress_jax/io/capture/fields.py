"""Fields and files of others' formats that must be there."""

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from dress_jax.core.errors import InputError


@contextlib.contextmanager
def within(place: str | Path) -> Iterator[None]:
    """Faults that are found in the block are said to lie in `place`."""
    try:
        yield
    except InputError as error:
        where = error.where if str(place) in error.where else f"{place}, {error.where}"
        raise InputError(error.problem, where=where, mend=error.mend) from error


def field(values: Mapping[str, Any], *names: str, where: str | Path, mend: str = "") -> Any:
    """The first of several fields that is there.

    Raises:
        InputError: none is; the message lists those that are.
    """
    for name in names:
        if name in values:
            return values[name]
    raise InputError(
        f"holds no '{names[0]}', only {', '.join(sorted(values)) or 'nothing'}",
        where=str(where),
        mend=mend,
    )


def files_named(folder: Path, pattern: str, *, what: str) -> list[Path]:
    """Files of a folder by their names, sorted.

    Raises:
        InputError: there is none.
    """
    found = sorted(folder.glob(pattern))
    if not found:
        raise InputError(
            f"holds no {what}", where=str(folder), mend=f"its name is {pattern}, check the folder"
        )
    return found
