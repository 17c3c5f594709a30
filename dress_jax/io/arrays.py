"""Archives of plain numpy arrays."""

import zipfile
from pathlib import Path

import numpy as np

from dress_jax.core.errors import InputError


def read_npz(path: str | Path) -> dict[str, np.ndarray]:
    """All plain arrays of an npz file; object arrays are skipped, nothing is unpickled.

    Raises:
        InputError: the file is missing or no npz.
    """
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as data:
            if not isinstance(data, np.lib.npyio.NpzFile):
                raise InputError(
                    "is a single array, not an npz file", where=str(path), mend="save with np.savez"
                )
            arrays = {}
            for key in data.files:
                try:
                    arrays[key] = data[key]
                except ValueError:
                    continue
            return arrays
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror or error})", where=str(path), mend="check the path"
        ) from error
    except (zipfile.BadZipFile, ValueError, EOFError) as error:
        raise InputError(
            "is not a valid npz file", where=str(path), mend="copy it again"
        ) from error
