"""Checks of the arrays in a bundle; every fault names the part it lies in."""

from typing import Any

import numpy as np

from dress_jax.core.errors import InputError


def picture(part: str, array: Any, *, channels: int = 0) -> np.ndarray:
    """8-bit pixels of shape (h, w), or (h, w, channels) where there are any.

    Raises:
        InputError: another type or shape, or no pixel.
    """
    array = np.asarray(array)
    wanted = "(h, w)" if channels == 0 else f"(h, w, {channels})"
    fits = array.ndim == 2 if channels == 0 else array.ndim == 3 and array.shape[2] == channels
    if array.dtype != np.uint8 or not fits or array.size == 0:
        raise InputError(
            f"is {array.dtype} of shape {array.shape}",
            where=part,
            mend=f"give 8-bit pixels of shape {wanted}",
        )
    return array


def same_size(part: str, array: np.ndarray, size: tuple[int, int], of: str) -> None:
    """That a picture is as large as another one.

    Raises:
        InputError: it is not.
    """
    if array.shape[:2] != size:
        raise InputError(
            f"is {array.shape[1]}x{array.shape[0]}, {of} is {size[1]}x{size[0]}",
            where=part,
            mend="give both the same size",
        )


def numbers(
    part: str, array: Any, shape: tuple[int | None, ...], *, dtype: Any = np.float64
) -> np.ndarray:
    """Finite numbers of a shape, in which None stands for any length.

    Raises:
        InputError: another shape, no numbers, or one that is not finite.
    """
    try:
        result = np.asarray(array, dtype)
    except (TypeError, ValueError) as error:
        raise InputError("holds something else than numbers", where=part) from error
    fits = result.ndim == len(shape) and all(
        wanted is None or have == wanted for have, wanted in zip(result.shape, shape, strict=True)
    )
    if not fits:
        wanted = ", ".join("any" if length is None else str(length) for length in shape)
        raise InputError(f"has shape {result.shape}, not ({wanted})", where=part)
    if not np.isfinite(result).all():
        raise InputError("holds a number that is not finite", where=part)
    return result
