"""Pictures as 8-bit numbers, exactly as their files hold them."""

from pathlib import Path

import numpy as np
from jaxtyping import Int, UInt8
from PIL import Image, ImageOps

from dress_jax.core.errors import InputError
from dress_jax.io.atomic import atomic_path
from dress_jax.io.images import opened

_ID_MODES = ("P", "L", "1", "I", "I;16")
_DEEP_MODES = ("I", "I;16", "I;16B", "F")


def read_pixels(
    path: str | Path,
) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w"] | None]:
    """Colours and, where the file has it, the alpha channel. Transparency is laid over white.

    A photograph that its camera took on the side is turned upright, as most tools read it.

    Raises:
        InputError: the file is missing, no picture, or has more than 8 bits.
    """
    with opened(path) as taken:
        _eight_bits(path, taken)
        image = ImageOps.exif_transpose(taken)
        if "A" not in image.getbands() and "transparency" not in image.info:
            return np.array(image.convert("RGB")), None
        rgba = np.array(image.convert("RGBA"))
    alpha = rgba[..., 3:].astype(np.float64) / 255.0
    over_white = rgba[..., :3] * alpha + 255.0 * (1.0 - alpha)
    return np.round(over_white).astype(np.uint8), rgba[..., 3].copy()


def read_coverage(path: str | Path) -> UInt8[np.ndarray, "h w"]:
    """A mask, from a grey picture or the alpha channel of one that has it.

    Raises:
        InputError: the file is missing, no picture, or has more than 8 bits.
    """
    with opened(path) as image:
        _eight_bits(path, image)
        grey = image.getchannel("A") if "A" in image.getbands() else image.convert("L")
        return np.array(grey)


def read_ids(path: str | Path) -> Int[np.ndarray, "h w"]:
    """The ids of a label map: indices of a palette PNG, values of a grey one, or an npy array.

    Raises:
        InputError: the file is missing, shows colours instead of ids, or is no map of whole
            numbers.
    """
    path = Path(path)
    if path.suffix.lower() == ".npy":
        try:
            ids = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise InputError(
                "cannot be read as an array", where=str(path), mend="save it with np.save"
            ) from error
        if ids.ndim != 2 or ids.dtype.kind not in "iu":
            raise InputError(
                f"is {ids.dtype} of shape {ids.shape}",
                where=str(path),
                mend="give one whole number per pixel, shape (h, w)",
            )
        return ids.astype(np.int64)
    with opened(path) as image:
        if image.mode not in _ID_MODES:
            raise InputError(
                f"holds {image.mode} colours instead of ids",
                where=str(path),
                mend="give the label map as a palette PNG, a grey PNG of ids, or an npy array",
            )
        return np.array(image).astype(np.int64)


def _eight_bits(path: str | Path, image: Image.Image) -> None:
    if image.mode in _DEEP_MODES:
        raise InputError(
            f"has more than 8 bits per pixel (mode {image.mode})",
            where=str(path),
            mend="save it with 8 bits",
        )


def write_pixels(path: str | Path, pixels: np.ndarray) -> None:
    """Write 8-bit pixels, grey or RGB, as PNG, atomically."""
    with atomic_path(path) as temporary:
        Image.fromarray(pixels).save(temporary, format="PNG")
