"""A piece of cloth made tileable, without a generator: even light, and a cut where it joins itself.

The default of S14.1 where no texture generator is at hand. Light and shade of low frequency are
divided out. The tile's size is chosen so that the cloth meets itself one tile on as well as it can,
which for woven and printed patterns is a whole number of their periods. In the strip where the
cloth overlaps itself, the path of least difference joins the two (Efros and Freeman 2001), along
both axes, and the second path closes around the first.
"""

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

CLEAR = 0.5
"""Correlation of the cloth with itself that makes a period."""

HARMONICS = 3
"""Waves that stand for a pattern, from its period downward."""

_LINES = 64  # that are looked at for a period
_SEARCH = 0.08  # of a period, on either side of what correlation says
_OVERLAP = 8  # the strip is a part of this of the image's length
_SMALLEST_OVERLAP = 4
_LONGER = 0.1  # of the mismatch's mean: what a tile of the full length is worth


@dataclasses.dataclass(frozen=True)
class Tile:
    """A picture that continues beyond its border with its other side.

    Attributes:
        image: colours in [0, 1], row 0 at the top, shape (h, w, 3).
        size: width and height of the cloth that it shows [m].
        corner: panel coordinates of a lower left corner [m].
        periods: of the pattern along width and height [m]; None where there is none.
    """

    image: Float[np.ndarray, "h w 3"]
    size: tuple[float, float]
    corner: tuple[float, float] = (0.0, 0.0)
    periods: tuple[float | None, float | None] = (None, None)


def seamless_tile(
    image: Float[np.ndarray, "h w 3"],
    texel_size: float,
    *,
    corner: tuple[float, float] = (0.0, 0.0),
    flatten: bool = True,
) -> Tile:
    """A tile from a piece of cloth.

    Args:
        image: colours in [0, 1], row 0 at the top; at least 8 texels along each axis.
        texel_size: [m].
        corner: panel coordinates of the image's lower left corner [m].
        flatten: remove light and shade of low frequency first.

    Raises:
        ValueError: the image is too small.
    """
    image = np.asarray(image, np.float64)
    if min(image.shape[:2]) < 8:
        raise ValueError(f"an image of shape {image.shape} is too small for a tile")
    periods = find_period(image, axis=1), find_period(image, axis=0)
    if flatten:
        image = flatten_light(image, periods)
        periods = find_period(image, axis=1), find_period(image, axis=0)
    height = len(image)
    image, width_texels = _join(image, periods[0], closed=False)
    turned, height_texels = _join(image.transpose(1, 0, 2), periods[1], closed=True)
    image = turned.transpose(1, 0, 2)
    known = [None if period is None else period * texel_size for period in periods]
    return Tile(
        image=np.clip(image, 0.0, 1.0),
        size=(width_texels * texel_size, height_texels * texel_size),
        # Rows count from the top: the tile ends above the lower border of the image.
        corner=(corner[0], corner[1] + (height - height_texels) * texel_size),
        periods=(known[0], known[1]),
    )


def find_period(image: Float[np.ndarray, "h w 3"], *, axis: int) -> float | None:
    """The period of a pattern along an axis [texels], from its correlation with itself.

    The first clear maximum after a dip counts, and a fit of waves refines it; a pattern that does
    not change along the axis has no period.

    Args:
        image: colours.
        axis: 0 down the rows, 1 along the columns.
    """
    values = np.moveaxis(np.asarray(image, np.float64), axis, 0)
    count = len(values)
    # Some lines say as much as all of them.
    values = values[:, :: -(-values.shape[1] // _LINES)].reshape(count, -1)
    position = np.linspace(-1.0, 1.0, count)[:, None]
    values = values - values.mean()
    values = values - position * (position * values).sum() / (position**2).sum() / values.shape[1]
    lags = np.arange(max(2, 3 * count // 4))
    correlation = np.array([_correlation(values, int(lag)) for lag in lags])
    peaks = 1 + np.flatnonzero(
        (correlation[1:-1] >= correlation[:-2]) & (correlation[1:-1] > correlation[2:])
    )
    lowest = np.minimum.accumulate(correlation)
    peaks = peaks[
        (correlation[peaks] >= CLEAR) & (correlation[peaks] - lowest[peaks] >= 0.5 * CLEAR)
    ]
    if not len(peaks):
        return None
    # Checks of unequal lines correlate a little with themselves at less than their period.
    peaks = peaks[correlation[peaks] >= 0.9 * correlation[peaks].max()]
    period = _refined(correlation, int(peaks[0]))
    # A pattern on a slope of light has its correlation's maxima elsewhere; a fit of both has not.
    step = period * period / (8.0 * count)
    around = period + step * np.arange(-round(_SEARCH * period / step), 1 + period * _SEARCH / step)
    fits = np.array([_explained(values, p) for p in around])
    top = int(fits.argmax())
    if top in (0, len(around) - 1):
        return period
    return float(around[0] + step * _refined(fits, top))


def flatten_light(
    image: Float[np.ndarray, "h w 3"], periods: tuple[float | None, float | None] = (None, None)
) -> Float[np.ndarray, "h w 3"]:
    """Divide out the quadratic course of the brightness; its mean stays.

    It is fitted together with the pattern's waves, lest a half stripe at the border pass for shade.

    Args:
        image: colours in [0, 1].
        periods: along columns and rows [texels].
    """
    image = np.asarray(image, np.float64)
    light = image.mean(axis=-1)
    height, width = light.shape
    down, right = _course(height), _course(width)
    terms = np.stack(
        [
            down[:, i, None] * right[None, :, j]
            for i, j in ((0, 0), (0, 1), (1, 0), (0, 2), (1, 1), (2, 0))
        ],
        axis=-1,
    )
    pattern = [np.zeros((height, width, 0))]
    if periods[0] is not None:
        waves = _waves(width, periods[0])[None, :, :]
        pattern.append(np.broadcast_to(waves, (height, *waves.shape[1:])))
    if periods[1] is not None:
        waves = _waves(height, periods[1])[:, None, :]
        pattern.append(np.broadcast_to(waves, (height, width, waves.shape[2])))
    every = np.concatenate([terms, *pattern], axis=-1).reshape(height * width, -1)
    weights = np.linalg.lstsq(every, light.reshape(-1), rcond=None)[0][: terms.shape[-1]]
    course = terms @ weights
    mean = max(float(course.mean()), 1e-6)
    course = np.clip(course / mean, 0.25, 4.0)
    return np.clip(image / course[..., None], 0.0, 1.0)


def wrap_jump(image: Float[np.ndarray, "h w 3"]) -> tuple[float, float]:
    """How the step across the border of a tile compares with the largest step inside it.

    A step is the mean absolute difference of neighbouring columns (or rows). Up to 1, the border is
    no worse than some place inside, so that it cannot be seen as a seam.

    Returns:
        Along columns and rows; 0 for a plain tile.
    """
    found = []
    for axis in (1, 0):
        values = np.moveaxis(np.asarray(image, np.float64), axis, 0)
        inside = np.abs(np.diff(values, axis=0)).mean(axis=(1, 2)).max(initial=0.0)
        across = float(np.abs(values[0] - values[-1]).mean())
        found.append(across / float(inside) if inside > 0.0 else float(across > 0.0))
    return found[0], found[1]


def _join(image: np.ndarray, period: float | None, *, closed: bool) -> tuple[np.ndarray, float]:
    """Let an image continue beyond its right border with its left one.

    Returns:
        The image, narrower, and the width of the cloth that it shows [texels], which for a pattern
        is a whole number of periods and may lie between two texels.
    """
    count = image.shape[1]
    overlap = max(_SMALLEST_OVERLAP, count // _OVERLAP)
    widths = np.arange(count // 2, count - overlap + 1)
    if period is not None and period <= widths[-1]:
        multiples = period * np.arange(1, int(widths[-1] / period) + 1)
        widths = np.unique(np.round(multiples).astype(int))
        widths = widths[widths >= 2 * overlap] if (widths >= 2 * overlap).any() else widths[-1:]
    left = image[:, :overlap]
    mismatch = np.array(
        [((image[:, w : w + overlap] - left) ** 2).sum(axis=-1).mean() for w in widths]
    )
    # A little mismatch is worth a longer tile, which repeats itself less.
    gain = _LONGER * mismatch.mean() * widths / count
    width = int(widths[(mismatch - gain).argmin()])
    beyond = image[:, width : width + overlap]
    cost = ((beyond - left) ** 2).sum(axis=-1)
    path = _closed_path(cost) if closed else _path(cost)[0]
    # To the left of the path the cloth from beyond the border goes on.
    own = (np.arange(overlap)[None, :] > path[:, None]).astype(np.float64)
    own = gaussian_filter1d(own, 0.7, axis=1, mode="nearest")
    if closed:
        own = gaussian_filter1d(own, 0.7, axis=0, mode="wrap")
    own[:, 0] = 0.0
    own[:, -1] = 1.0
    joined = image[:, :width].copy()
    joined[:, :overlap] = own[..., None] * left + (1.0 - own[..., None]) * beyond
    shown = float(width)
    if period is not None:
        exact = period * round(width / period)
        shown = exact if abs(exact - width) <= 1.0 else shown
    return joined, shown


def _path(cost: np.ndarray, start: int | None = None) -> tuple[np.ndarray, float]:
    """The path of least cost from the first row to the last, one column per row, at most one
    column to the side from row to row; with a start it ends where it starts, or next to it."""
    rows, columns = cost.shape
    cost = cost.copy()
    # Not along the strip's own borders: the images join there anyway.
    cost[:, [0, -1]] += cost.max() + 1.0
    total = cost[0] if start is None else np.where(np.arange(columns) == start, cost[0], np.inf)
    origin = np.zeros((rows, columns), np.int64)
    for row in range(1, rows):
        padded = np.pad(total, 1, constant_values=np.inf)
        choices = np.stack([padded[:-2], padded[1:-1], padded[2:]])
        step = choices.argmin(axis=0)
        origin[row] = np.arange(columns) + step - 1
        total = cost[row] + choices.min(axis=0)
    if start is not None:
        total = np.where(np.abs(np.arange(columns) - start) <= 1, total, np.inf)
    path = np.zeros(rows, np.int64)
    path[-1] = int(total.argmin())
    for row in range(rows - 1, 0, -1):
        path[row - 1] = origin[row, path[row]]
    return path, float(total.min())


def _closed_path(cost: np.ndarray) -> np.ndarray:
    """The path of least cost around a strip whose first row follows the last."""
    paths = [_path(cost, start) for start in range(1, cost.shape[1] - 1)]
    return min(paths, key=lambda found: found[1])[0]


def _correlation(values: np.ndarray, lag: int) -> float:
    """Of the values with themselves `lag` further on, over the part that overlaps."""
    first, second = values[: len(values) - lag], values[lag:]
    first, second = first - first.mean(), second - second.mean()
    size = np.sqrt((first**2).sum() * (second**2).sum())
    return float((first * second).sum() / size) if size > 0.0 else 0.0


def _refined(values: np.ndarray, peak: int) -> float:
    """Where the parabola through a maximum and its neighbours is largest."""
    before, top, after = values[peak - 1 : peak + 2]
    curvature = before - 2.0 * top + after
    return peak + (0.5 * float((before - after) / curvature) if curvature < 0.0 else 0.0)


def _course(count: int) -> np.ndarray:
    """1, x and x^2 over the length of an image, shape (count, 3)."""
    x = np.linspace(-1.0, 1.0, count)
    return np.stack([np.ones(count), x, x * x], axis=1)


def _waves(count: int, period: float) -> np.ndarray:
    """Sine and cosine of a period and its overtones, shape (count, 2 * HARMONICS)."""
    phase = 2.0 * np.pi * np.arange(count)[:, None] * np.arange(1, HARMONICS + 1) / period
    return np.concatenate([np.sin(phase), np.cos(phase)], axis=1)


def _explained(values: np.ndarray, period: float) -> float:
    """Part of the lines' variance that a quadratic course and a pattern of this period explain."""
    basis, _ = np.linalg.qr(np.concatenate([_course(len(values)), _waves(len(values), period)], 1))
    return float(((basis.T @ values) ** 2).sum() / max((values**2).sum(), 1e-300))
