"""Vertex animation for modelling programs: PC2 (Blender, 3ds Max) and MDD (LightWave, Blender).

Both hold the positions of all vertices, frame after frame, in single precision, in the order of the
mesh that they are put upon. PC2 is little-endian: `POINTCACHE2`, a zero, version 1, the number of
points, first frame, step, number of frames. MDD is big-endian: numbers of frames and of points, the
time of each frame [s].
"""

import dataclasses
import struct
from pathlib import Path

import numpy as np
from jaxtyping import Float

from dress_jax.core.errors import InputError
from dress_jax.io.atomic import atomic_open

_SIGNATURE = b"POINTCACHE2\0"
_HEADER = struct.Struct("<12siiffi")
_COUNTS = struct.Struct(">ii")


@dataclasses.dataclass(frozen=True)
class Cache:
    """Vertex animation read from a cache.

    Args:
        frames: positions [m], single precision in the file, (t, n, 3).
        times: of the frames, (t,): numbers of frames in PC2, seconds in MDD.
    """

    frames: Float[np.ndarray, "t n 3"]
    times: Float[np.ndarray, " t"]


def write_pc2(path: str | Path, frames: Float[np.ndarray, "t n 3"]) -> None:
    """Write a PC2 cache that begins at frame 0, one sample a frame.

    Raises:
        ValueError: positions of another shape.
        InputError: the place cannot be written to.
    """
    frames = _checked(frames)
    with atomic_open(path, binary=True) as file:
        file.write(_HEADER.pack(_SIGNATURE, 1, frames.shape[1], 0.0, 1.0, len(frames)))
        file.write(np.ascontiguousarray(frames, "<f4").tobytes())


def read_pc2(path: str | Path) -> Cache:
    """Read a PC2 cache.

    Raises:
        InputError: the file is missing, no such cache, or cut short.
    """
    content = _content(path)
    if len(content) < _HEADER.size or content[:12] != _SIGNATURE:
        raise InputError("is no PC2 cache", where=str(path), mend="write it again")
    _, version, points, start, step, samples = _HEADER.unpack_from(content)
    if version != 1:
        raise InputError(f"has version {version}", where=str(path), mend="give version 1")
    frames = _frames(path, content[_HEADER.size :], samples, points, "<f4")
    return Cache(frames, start + step * np.arange(samples))


def write_mdd(path: str | Path, frames: Float[np.ndarray, "t n 3"], *, fps: float) -> None:
    """Write an MDD cache.

    Raises:
        ValueError: positions of another shape.
        InputError: the place cannot be written to.
    """
    frames = _checked(frames)
    with atomic_open(path, binary=True) as file:
        file.write(_COUNTS.pack(len(frames), frames.shape[1]))
        file.write((np.arange(len(frames)) / fps).astype(">f4").tobytes())
        file.write(np.ascontiguousarray(frames, ">f4").tobytes())


def read_mdd(path: str | Path) -> Cache:
    """Read an MDD cache.

    Raises:
        InputError: the file is missing, no such cache, or cut short.
    """
    content = _content(path)
    if len(content) < _COUNTS.size:
        raise InputError("is no MDD cache", where=str(path), mend="write it again")
    samples, points = _COUNTS.unpack_from(content)
    end = _COUNTS.size + 4 * max(samples, 0)
    times = content[_COUNTS.size : end]
    if samples < 0 or points < 0 or len(times) != 4 * samples:
        raise InputError("is no MDD cache", where=str(path), mend="write it again")
    frames = _frames(path, content[end:], samples, points, ">f4")
    return Cache(frames, np.frombuffer(times, ">f4").astype(float))


def _checked(frames: np.ndarray) -> np.ndarray:
    frames = np.asarray(frames)
    if frames.ndim != 3 or frames.shape[2] != 3 or not np.isfinite(frames).all():
        raise ValueError(f"positions of shape {frames.shape}, or not finite")
    return frames


def _content(path: str | Path) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", where=str(path), mend="check the path"
        ) from error


def _frames(path: str | Path, content: bytes, samples: int, points: int, kind: str) -> np.ndarray:
    if len(content) != 12 * samples * points:
        raise InputError(
            f"holds {len(content)} bytes of positions, {samples} frames of {points} points need "
            f"{12 * samples * points}",
            where=str(path),
            mend="write it again",
        )
    return np.frombuffer(content, kind).reshape(samples, points, 3).astype(float)
