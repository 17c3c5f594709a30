"""Animated cloth and body as one HDF5 file: positions per frame, topology once (S15.1)."""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from dress_jax.core.errors import InputError
from dress_jax.io.atomic import atomic_path

# Appends one frame: time [s], then positions by the names given at the start.
Append = Callable[[float, Mapping[str, np.ndarray]], None]


@contextlib.contextmanager
def write_trajectory(path: str | Path, faces: Mapping[str, np.ndarray]) -> Iterator[Append]:
    """Write frames as they come; the file appears when the block ends without error.

    Args:
        path: the `.h5` file.
        faces: triangles of each object by name ("cloth", "body"), shape (f, 3).

    Yields:
        `append(time, {"cloth": (n, 3), "body": (m, 3)})`, positions in metres.

    Raises:
        ValueError: a frame lacks an object or changes its shape.
        InputError: the place cannot be written to.
    """
    with atomic_path(path) as temporary, h5py.File(temporary, "w") as file:
        times = file.create_dataset("time", shape=(0,), maxshape=(None,), dtype="f8")
        for name, triangles in faces.items():
            file.create_dataset(f"{name}/faces", data=np.asarray(triangles))

        def append(time: float, positions: Mapping[str, np.ndarray]) -> None:
            if set(positions) != set(faces):
                raise ValueError(f"a frame needs {sorted(faces)}, not {sorted(positions)}")
            count = len(times)
            for name, values in positions.items():
                values = np.asarray(values)
                key = f"{name}/positions"
                if count == 0:
                    file.create_dataset(
                        key,
                        shape=(0, *values.shape),
                        maxshape=(None, *values.shape),
                        chunks=(1, *values.shape),
                        dtype=values.dtype,
                        compression="gzip",
                        shuffle=True,
                    )
                frames: Any = file[key]
                if frames.shape[1:] != values.shape:
                    raise ValueError(f"{name} changed from {frames.shape[1:]} to {values.shape}")
                frames.resize(count + 1, axis=0)
                frames[count] = values
            times.resize(count + 1, axis=0)
            times[count] = time

        yield append


def read_trajectory(
    path: str | Path,
) -> tuple[np.ndarray, dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Times [s], shape (t,), and per object positions [m], shape (t, n, 3), and faces (f, 3).

    Raises:
        InputError: the file is missing or no trajectory.
    """
    try:
        with h5py.File(path, "r") as file:
            names = [name for name in file if name != "time"]
            objects = {
                str(name): (_read(file, f"{name}/positions"), _read(file, f"{name}/faces"))
                for name in names
            }
            return _read(file, "time"), objects
    except (OSError, KeyError) as error:
        raise InputError(
            "is not a trajectory, or is damaged", where=str(path), mend="write it again"
        ) from error


def _read(file: h5py.File, key: str) -> np.ndarray:
    dataset: Any = file[key]
    return dataset[()]
