"""A piece of a picture as flat cloth: resampled in the panel's own coordinates (S14.1, S14.2).

The fitted surface says where on the panel every pixel looks. Its inverse resamples the picture, so
foreshortening, folds and the turn of the body go out, the grain stands upright, and the size of the
cut in metres is known.
"""

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates

from dress_jax.texture.panel_maps import PanelMap
from dress_jax.texture.square import Square, central_square

OVERSAMPLING = 2.0
"""Texels per pixel along each axis: periods of the cloth are counted in whole texels."""

_EDGE = 1e-9  # of a triangle: a texel on an edge belongs to both sides


@dataclasses.dataclass(frozen=True)
class Cut:
    """A square of flat cloth.

    Attributes:
        image: colours in [0, 1]; columns run along the panel's +x, rows against its +y, shape
            (n, n, 3).
        texel_size: [m].
        panel: that it was cut from.
        corner: panel coordinates of the image's lower left corner [m], shape (2,).
    """

    image: Float[np.ndarray, "n n 3"]
    texel_size: float
    panel: int
    corner: Float[np.ndarray, "2"]

    @property
    def side(self) -> float:
        """Edge length of the cut [m]."""
        return len(self.image) * self.texel_size


def cut_cloth(
    picture: Float[np.ndarray, "h w 3"],
    seen: PanelMap,
    square: Square,
    *,
    oversampling: float = OVERSAMPLING,
) -> Cut | None:
    """The largest square along the grain that a square of pixels shows of its panel.

    Args:
        picture: colours in [0, 1].
        seen: the panels in this view.
        square: pixels of one panel, without a jump of its coordinates (`even_cloth`).
        oversampling: texels per pixel along each axis.

    Returns:
        The cut, or None where the pixels show a strip too narrow to hold a square of 8 texels.
    """
    rows = slice(square.row, square.row + square.side)
    columns = slice(square.column, square.column + square.side)
    own = seen.coordinates[rows, columns].reshape(-1, 2)
    texel = float(np.median(seen.spacing[rows, columns])) / oversampling
    low, high = own.min(axis=0), own.max(axis=0)
    count = np.floor((high - low) / texel).astype(int)
    if count.min() < 8:
        return None
    place = (seen.coordinates[rows, columns] - low) / texel - 0.5
    inverse = _inverse(place, int(count[1]), int(count[0]))[::-1]
    inverse = inverse + np.array([square.row, square.column])
    top, left, side = central_square(np.isfinite(inverse[..., 0]))
    if side < 8:
        return None
    inner = inverse[top : top + side, left : left + side]
    image = np.stack(
        [
            map_coordinates(
                picture[..., k], [inner[..., 0], inner[..., 1]], order=3, mode="nearest"
            )
            for k in range(3)
        ],
        axis=-1,
    )
    return Cut(
        # Cubic interpolation overshoots at sharp edges.
        image=np.clip(image, 0.0, 1.0),
        texel_size=texel,
        panel=int(seen.panel[square.row, square.column]),
        corner=low + texel * np.array([left, count[1] - top - side]),
    )


def _inverse(place: Float[np.ndarray, "n n 2"], height: int, width: int) -> np.ndarray:
    """The pixel (row, column) that shows each texel, NaN where none does, shape (h, w, 2).

    Pixels span two triangles each with their neighbours; these are drawn where they lie on the
    panel, one offset within their boxes at a time.

    Args:
        place: column and row (upward) of every pixel in the texels' grid.
        height, width: of the grid.
    """
    grid = np.moveaxis(np.indices(place.shape[:2], dtype=np.float64), 0, -1)
    corners = [(0, 0), (0, 1), (1, 1), (1, 0)]

    def shifted(array: np.ndarray, corner: tuple[int, int]) -> np.ndarray:
        down, right = corner
        rows, columns = array.shape[0] - 1, array.shape[1] - 1
        return array[down : down + rows, right : right + columns].reshape(-1, 2)

    found = np.full((height, width, 2), np.nan)
    for pick in ((0, 1, 2), (0, 2, 3)):
        a, b, c = (shifted(place, corners[k]) for k in pick)
        values = [shifted(grid, corners[k]) for k in pick]
        first = np.ceil(np.minimum(np.minimum(a, b), c)).astype(np.int64)
        last = np.floor(np.maximum(np.maximum(a, b), c)).astype(np.int64)
        area = _cross(b - a, c - a)
        most = np.maximum(last - first, -1).max(axis=0)
        for right in range(int(most[0]) + 1):
            for up in range(int(most[1]) + 1):
                at = first + np.array([right, up])
                inside = (at <= last).all(axis=1) & (at >= 0).all(axis=1) & (area != 0.0)
                inside &= (at[:, 0] < width) & (at[:, 1] < height)
                weight = np.stack([_cross(b - at, c - at), _cross(c - at, a - at)], axis=1)
                weight = weight / np.where(area == 0.0, 1.0, area)[:, None]
                third = 1.0 - weight.sum(axis=1)
                inside &= (weight >= -_EDGE).all(axis=1) & (third >= -_EDGE)
                value = weight[:, :1] * values[0] + weight[:, 1:] * values[1]
                value = (value + third[:, None] * values[2])[inside]
                found[at[inside, 1], at[inside, 0]] = value
    return found


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
