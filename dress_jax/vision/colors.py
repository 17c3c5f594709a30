"""Colours as the eye tells them apart, palettes of regions, and how far two regions differ."""

import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.distance import cdist

_TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
"""Linear sRGB to CIE XYZ (IEC 61966-2-1)."""
_KNEE, _SLOPE = (6.0 / 29.0) ** 3, (29.0 / 6.0) ** 2 / 3.0
_ROUNDS = 8
_SAMPLES = 300
LIGHTNESS_WEIGHT = 0.5
"""Shading changes lightness more than hue, so that lightness counts for less."""


def lab(image: UInt8[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
    """CIE L*a*b* under D65 of sRGB colours: L from 0 to 100, a to red, b to yellow."""
    value = np.asarray(image, np.float64) / 255.0
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    xyz = linear @ _TO_XYZ.T / _TO_XYZ.sum(axis=1)
    root = np.where(xyz > _KNEE, np.cbrt(xyz), _SLOPE * xyz + 4.0 / 29.0)
    x, y, z = np.moveaxis(root, -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def shade_tolerant(colors: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
    """L*a*b* with lightness scaled by `LIGHTNESS_WEIGHT`; all distances here are between these."""
    return colors * np.array([LIGHTNESS_WEIGHT, 1.0, 1.0])


def palette(
    colors: Float[np.ndarray, "n 3"], count: int
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]]:
    """Up to `count` colours that stand for many, and the share of each.

    k-means from a deterministic start: the point farthest from those chosen before.
    """
    sample = _sample(colors)
    centres = [sample.mean(axis=0)]
    for _ in range(min(count, len(sample)) - 1):
        gap = cdist(sample, np.array(centres)).min(axis=1)
        if gap.max() < 1e-6:
            break
        centres.append(sample[gap.argmax()])
    centres = np.array(centres)
    nearest = np.zeros(len(sample), int)
    for _ in range(_ROUNDS):
        nearest = cdist(sample, centres).argmin(axis=1)
        centres = np.array(
            [
                sample[nearest == k].mean(axis=0) if (nearest == k).any() else centres[k]
                for k in range(len(centres))
            ]
        )
    shares = np.bincount(nearest, minlength=len(centres)) / len(sample)
    return centres[shares > 0.0], shares[shares > 0.0]


def density(
    colors: Float[np.ndarray, "n 3"],
    centres: Float[np.ndarray, "k 3"],
    shares: Float[np.ndarray, " k"],
    *,
    spread: float,
) -> Float[np.ndarray, " n"]:
    """How well colours fit a palette: a mixture of Gaussians, 1 at the middle of a lone colour."""
    distances = cdist(colors, centres, "sqeuclidean")
    return np.exp(-0.5 * distances / spread**2) @ np.sqrt(shares / shares.max())


def contrast(first: Float[np.ndarray, "n 3"], second: Float[np.ndarray, "m 3"]) -> float:
    """Distance of two sets of colours: the energy distance (Szekely and Rizzo 2013), halved.

    d^2 = E|X - Y| (2 E|X - Y| - E|X - X'| - E|Y - Y'|) / 2 is zero for equal palettes, however
    varied, and the plain distance for two plain colours.
    """
    x, y = _sample(first), _sample(second)
    across = float(cdist(x, y).mean())
    within = float(cdist(x, x).mean() + cdist(y, y).mean())
    return float(np.sqrt(max(0.0, across * (across - 0.5 * within))))


def _sample(colors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """Evenly chosen members of a large set."""
    if len(colors) <= _SAMPLES:
        return colors
    return colors[np.linspace(0, len(colors) - 1, _SAMPLES).astype(int)]
