"""The largest square of uniform colour in a mask (S14.1).

Uniform means that every part of the square looks like every other: the means of its blocks agree.
Single pixels may differ as much as they like, so that checked or printed cloth counts as uniform,
while a shadow, a fold or the border of a print does not.
"""

import dataclasses
import itertools

import numpy as np
from jaxtyping import Bool, Float

from dress_jax.texture.panel_maps import PanelMap

BLOCKS = 3
"""Blocks along each side of a square whose means are compared."""

TOLERANCE = 0.03
"""Largest deviation of the blocks' means, colours in [0, 1]: about what a gentle shade does."""

SMALLEST_SIDE = 16  # px; below, a cut holds too little of the cloth
_SHRINK = 0.97  # from one side that is tried to the next


@dataclasses.dataclass(frozen=True)
class Square:
    """A square of pixels.

    Attributes:
        row, column: of its upper left pixel.
        side: [px].
        deviation: root mean square of its blocks' means about their mean, colours in [0, 1].
    """

    row: int
    column: int
    side: int
    deviation: float


def even_cloth(
    seen: PanelMap,
    mask: Bool[np.ndarray, "h w"],
    cosine: Float[np.ndarray, "h w"],
    *,
    smallest_cosine: float,
) -> Bool[np.ndarray, "h w"]:
    """Pixels of cloth that faces the camera, away from the borders of panels and from folds that
    hide cloth behind them.

    A square of such pixels lies on one panel, and panel coordinates are continuous in it.

    Args:
        seen: the panels in the view.
        mask: where the picture shows the garment.
        cosine: between the cloth's normal and the direction to the eye.
        smallest_cosine: of cloth that counts; steeper cloth is shaded and foreshortened.
    """
    allowed = mask & (seen.panel >= 0) & (cosine >= smallest_cosine)
    # Neighbouring pixels are this far apart on cloth that is not folded over itself, twice over.
    reach = 2.0 * seen.spacing / np.maximum(seen.cosine, 0.2)
    for axis in (0, 1):
        step = np.linalg.norm(np.diff(seen.coordinates, axis=axis), axis=-1)
        jump = np.diff(seen.panel, axis=axis) != 0
        first = [slice(None), slice(None)]
        second = [slice(None), slice(None)]
        first[axis], second[axis] = slice(None, -1), slice(1, None)
        jump |= step > np.maximum(reach[tuple(first)], reach[tuple(second)])
        allowed[tuple(first)] &= ~jump
        allowed[tuple(second)] &= ~jump
    return allowed


def uniform_square(
    picture: Float[np.ndarray, "h w 3"],
    allowed: Bool[np.ndarray, "h w"],
    *,
    tolerance: float = TOLERANCE,
    smallest_side: int = SMALLEST_SIDE,
) -> Square | None:
    """The largest axis-aligned square of allowed pixels whose colour is uniform.

    Sides go down in steps of 3 % from the largest square that fits; the first that has a square
    within the tolerance is taken, and of its squares the most uniform. Where none is within the
    tolerance, the most uniform of all squares at least a third as long as the largest is taken.

    Args:
        picture: colours in [0, 1].
        allowed: pixels that may be used.
        tolerance: see `TOLERANCE`.
        smallest_side: squares are not shorter [px].

    Returns:
        The square, or None where not even the smallest fits.
    """
    counts = _integral(allowed.astype(np.float64)[..., None])
    colors = _integral(np.asarray(picture, np.float64))
    side = largest_side(allowed)
    smallest = max(smallest_side, side // 3)
    best = None
    while side >= smallest:
        fits = _window_sums(counts, side, side)[..., 0] > side * side - 0.5
        deviation = np.where(fits, _deviation(colors, side), np.inf)
        row, column = np.unravel_index(int(deviation.argmin()), deviation.shape)
        found = Square(int(row), int(column), side, float(deviation[row, column]))
        if np.isfinite(found.deviation) and (best is None or found.deviation < best.deviation):
            best = found
        if best is not None and best.deviation <= tolerance:
            return best
        side = min(side - 1, int(_SHRINK * side))
    return best


def largest_side(allowed: Bool[np.ndarray, "h w"]) -> int:
    """Side of the largest square of allowed pixels [px]; 0 where there is none."""
    counts = _integral(allowed.astype(np.float64)[..., None])
    low, high = 0, min(allowed.shape)
    # Every square holds smaller ones, so whether one fits is monotone in the side.
    while low < high:
        middle = (low + high + 1) // 2
        if (_window_sums(counts, middle, middle) > middle * middle - 0.5).any():
            low = middle
        else:
            high = middle - 1
    return low


def central_square(allowed: Bool[np.ndarray, "h w"]) -> tuple[int, int, int]:
    """Row, column and side of the largest square of allowed pixels, of several the middle one."""
    side = largest_side(allowed)
    if side == 0:
        return 0, 0, 0
    counts = _integral(allowed.astype(np.float64)[..., None])
    places = np.argwhere(_window_sums(counts, side, side)[..., 0] > side * side - 0.5)
    middle = places.mean(axis=0)
    row, column = places[((places - middle) ** 2).sum(axis=1).argmin()]
    return int(row), int(column), side


def _deviation(integral: np.ndarray, side: int) -> np.ndarray:
    """Deviation of the blocks' means for every place of a square with this side."""
    cuts = np.round(np.linspace(0, side, BLOCKS + 1)).astype(int)
    height, width = integral.shape[0] - side, integral.shape[1] - side
    total = np.zeros((height, width, integral.shape[2]))
    squares = np.zeros_like(total)
    for top, bottom in itertools.pairwise(cuts):
        for left, right in itertools.pairwise(cuts):
            mean = _window_sums(integral, bottom - top, right - left)[top:, left:][:height, :width]
            mean = mean / ((bottom - top) * (right - left))
            total += mean
            squares += mean * mean
    count = BLOCKS * BLOCKS
    variance = squares / count - (total / count) ** 2
    return np.sqrt(np.maximum(variance, 0.0).mean(axis=-1))


def _integral(image: np.ndarray) -> np.ndarray:
    """Sums over everything above and to the left, shape (h + 1, w + 1, c)."""
    return np.pad(image, [(1, 0), (1, 0), (0, 0)]).cumsum(axis=0).cumsum(axis=1)


def _window_sums(integral: np.ndarray, height: int, width: int) -> np.ndarray:
    """Sums over all windows of a size, by their upper left pixel."""
    return (
        integral[height:, width:]
        - integral[:-height, width:]
        - integral[height:, :-width]
        + integral[:-height, :-width]
    )
