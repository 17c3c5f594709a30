"""A photograph, with its alpha channel or a second picture as the matte."""

from pathlib import Path

from dress_jax.capture.bundle import Bundle
from dress_jax.io.capture.pictures import read_coverage, read_pixels


def read_photograph(path: str | Path, *, matte: str | Path | None = None) -> Bundle:
    """The image, and the matte where there is one; transparent pixels become white.

    Cameras write how they were held; the image is turned upright by that.

    Args:
        path: PNG, JPEG or another picture.
        matte: coverage by the person, of the same size; the picture's alpha channel unless given.

    Raises:
        InputError: a file is missing or no picture, or the sizes differ.
    """
    pixels, alpha = read_pixels(path)
    if matte is not None:
        alpha = read_coverage(matte)
    sources = {"image": "photograph"} | ({} if alpha is None else {"matte": "photograph"})
    return Bundle(image=pixels, matte=alpha, sources=sources)
