"""Pictures that move: MP4 (H.264) where PyAV is installed, animated PNG otherwise."""

import importlib.util
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from dress_jax.io.atomic import atomic_path

_QUALITY = "20"  # of x264, where 18 cannot be told from the original and 28 shows


def video_suffix() -> str:
    """The kind of file that can be written here: `.mp4`, or `.png` without PyAV."""
    return ".mp4" if importlib.util.find_spec("av") is not None else ".png"


def write_video(
    path: str | Path, pictures: Iterable[UInt8[np.ndarray, "h w 3"]], *, fps: float
) -> None:
    """Write a film; its kind follows the ending, `.mp4` or `.png`.

    Args:
        path: the file.
        pictures: 8 bits, all of one even size.
        fps: pictures per second.

    Raises:
        ValueError: another ending, or no pictures.
        InputError: the place cannot be written to.
    """
    writers = {".mp4": _write_mp4, ".png": _write_animated_png}
    suffix = Path(path).suffix.lower()
    if suffix not in writers:
        raise ValueError(f"a film ends in .mp4 or .png, not {suffix!r}")
    with atomic_path(path) as temporary:
        writers[suffix](temporary, pictures, fps)


def _write_mp4(path: Path, pictures: Iterable[np.ndarray], fps: float) -> None:
    import av

    rate = Fraction(fps).limit_denominator(1001)
    with av.open(str(path), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=rate)
        stream.pix_fmt = "yuv420p"  # what browsers and slides play
        stream.options = {"crf": _QUALITY}
        count = 0
        for count, picture in enumerate(pictures, start=1):
            if count == 1:
                stream.height, stream.width = picture.shape[:2]
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            container.mux(stream.encode(frame))
        if not count:
            raise ValueError("there are no pictures")
        container.mux(stream.encode())


def _write_animated_png(path: Path, pictures: Iterable[np.ndarray], fps: float) -> None:
    images = [Image.fromarray(np.asarray(picture, np.uint8)) for picture in pictures]
    if not images:
        raise ValueError("there are no pictures")
    images[0].save(
        path,
        format="PNG",
        save_all=True,
        append_images=images[1:],
        duration=1000.0 / fps,
        loop=0,
        default_image=False,
    )
