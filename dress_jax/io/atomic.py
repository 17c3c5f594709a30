"""Files that are either complete or absent: written beside their place, then moved into it."""

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from dress_jax.core.errors import InputError


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """A temporary path in the same folder that becomes `path` when the block ends without error.

    For writers that open a file by name (h5py, numpy, pillow). When the block raises, the
    temporary file is removed and an earlier file at `path` is left as it was. Missing folders are
    made. The temporary name keeps the suffix, because many writers choose their format by it.

    Raises:
        InputError: the folder cannot be made or written to.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(6)}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise IsADirectoryError(21, "is a folder", str(path))
        # Fails here, with the folder's name at hand, rather than somewhere inside a library.
        temporary.touch(exist_ok=False)
    except OSError as error:
        raise InputError(
            f"cannot be written ({error.strerror})",
            where=str(path),
            mend="choose another place, or make the folder writable",
        ) from error
    try:
        yield temporary
        with temporary.open("rb") as handle:
            os.fsync(handle.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_open(path: str | Path, *, binary: bool = False) -> Iterator[IO[Any]]:
    """A file handle for writing whose content appears at `path` only when the block succeeds.

    Args:
        path: where the file will be.
        binary: bytes instead of UTF-8 text with "\\n" line ends.

    Raises:
        InputError: the folder cannot be made or written to.
    """
    with atomic_path(path) as temporary:
        if binary:
            with temporary.open("wb") as handle:
                yield handle
        else:
            with temporary.open("w", encoding="utf-8", newline="\n") as handle:
                yield handle


def write_text(path: str | Path, text: str) -> None:
    """Write a whole text file atomically."""
    with atomic_open(path) as handle:
        handle.write(text)
