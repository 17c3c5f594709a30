"""The person's matte: a network twice, over the picture and over the person, then its edges.

U^2-Net p (Qin et al. 2020, Pattern Recognition 106) finds what stands out of a picture at 320 x
320 px. Its second look at the person alone resolves more of the outline, and a guided filter (He,
Sun and Tang 2010) draws it to the edges of the picture.
"""

import numpy as np
from jaxtyping import Float, UInt8
from scipy import ndimage

from dress_jax.capture.checks import picture as checked_picture
from dress_jax.core.errors import InputError
from dress_jax.vision.networks import Network, run_network
from dress_jax.vision.resampling import resized

LEAST_SIDE = 64
"""Shortest side of a picture in which a person is looked for [px]."""
LEAST_SHARE = 0.002
"""Part of the picture that a person covers at least."""
_MEAN, _SPREAD = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
_MARGIN = 0.12
_FILTER_RADIUS = 1.0 / 250.0
_FILTER_VARIANCE = 1e-4
_GREY = np.array([0.299, 0.587, 0.114])


def find_matte(image: UInt8[np.ndarray, "h w 3"], network: Network) -> UInt8[np.ndarray, "h w"]:
    """Coverage of the pixels by what stands out, 0 to 255: its largest connected part.

    Args:
        image: RGB, shape (h, w, 3).
        network: of `io.networks.load_matting_network`.

    Raises:
        InputError: the picture is too small, or nothing stands out.
    """
    colours = checked_size(image).astype(np.float32) / 255.0
    first = _look(colours, network)
    rows, columns = _box(first > 0.5, colours.shape[:2])
    coverage = np.zeros_like(first)
    coverage[rows, columns] = _look(colours[rows, columns], network)
    coverage = guided_filter(coverage, colours @ _GREY)
    kept = _largest(coverage > 0.5)
    if kept.mean() < LEAST_SHARE:
        raise nothing_found()
    # The soft rim belongs to the part that is kept.
    reach = max(2, round(2 * _FILTER_RADIUS * max(coverage.shape)))
    near = ndimage.binary_dilation(kept, iterations=reach)
    return np.round(255.0 * np.where(near, coverage, 0.0)).astype(np.uint8)


def checked_size(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """The picture itself.

    Raises:
        InputError: it is no 8-bit RGB picture, or too small to show a person.
    """
    image = checked_picture("image", image, channels=3)
    if min(image.shape[:2]) < LEAST_SIDE:
        raise InputError(
            f"has {image.shape[1]}x{image.shape[0]} pixels",
            where="image",
            mend=f"give a picture of {LEAST_SIDE} pixels a side at least",
        )
    return image


def nothing_found() -> InputError:
    """The fault of a picture in which nothing stands out."""
    return InputError(
        "shows nobody who stands out of the background",
        where="image",
        mend="give a picture of one whole person, or a matte of your own",
    )


def guided_filter(
    coverage: Float[np.ndarray, "h w"],
    guide: Float[np.ndarray, "h w"],
    *,
    radius: float = _FILTER_RADIUS,
    variance: float = _FILTER_VARIANCE,
) -> Float[np.ndarray, "h w"]:
    """Coverage that is a linear function of the guide in every window (He, Sun and Tang 2010).

    Args:
        coverage: 0 to 1, shape (h, w).
        guide: grey values 0 to 1, shape (h, w).
        radius: half the window as a share of the longer side.
        variance: of the guide, below which a window counts as flat.
    """
    size = 2 * max(1, round(radius * max(coverage.shape))) + 1

    def mean(values: np.ndarray) -> np.ndarray:
        return ndimage.uniform_filter(values.astype(np.float64), size, mode="nearest")

    guide_mean, coverage_mean = mean(guide), mean(coverage)
    covariance = mean(guide * coverage) - guide_mean * coverage_mean
    slope = covariance / (mean(guide * guide) - guide_mean**2 + variance)
    offset = coverage_mean - slope * guide_mean
    return np.clip(mean(slope) * guide + mean(offset), 0.0, 1.0)


def _look(colours: Float[np.ndarray, "h w 3"], network: Network) -> Float[np.ndarray, "h w"]:
    small = resized(colours, network.graph.input_size)
    small = (small / max(float(small.max()), 1e-6) - _MEAN) / _SPREAD
    (coverage,) = run_network(network, small[None])
    return np.clip(resized(coverage[0, :, :, 0], colours.shape[:2]), 0.0, 1.0)


def _box(mask: np.ndarray, size: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns around the largest part, with a margin.

    Raises:
        InputError: there is none.
    """
    mask = _largest(mask)
    if mask.mean() < LEAST_SHARE:
        raise nothing_found()
    spans = []
    for axis, length in ((1, size[0]), (0, size[1])):
        found = np.flatnonzero(mask.any(axis=axis))
        margin = int(_MARGIN * (found[-1] - found[0] + 1)) + 1
        spans.append(slice(max(0, found[0] - margin), min(length, found[-1] + 1 + margin)))
    return spans[0], spans[1]


def _largest(mask: np.ndarray) -> np.ndarray:
    """The largest connected part of a mask."""
    labels = np.zeros(mask.shape, np.int32)
    ndimage.label(mask, output=labels)
    sizes = np.bincount(labels.ravel())
    if len(sizes) == 1:
        return mask
    sizes[0] = 0
    return labels == sizes.argmax()
