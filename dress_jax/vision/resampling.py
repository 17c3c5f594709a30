"""Pictures at other sizes: resized, or a square window of any place and scale cut out."""

import numpy as np
from jaxtyping import Float
from PIL import Image
from scipy.ndimage import map_coordinates


def resized(picture: Float[np.ndarray, "h w *c"], size: tuple[int, int]) -> np.ndarray:
    """The picture with `size` rows and columns, bilinear; what shrinks is averaged.

    Args:
        picture: any range, shape (h, w) or (h, w, c).
        size: rows and columns [px].
    """
    planes = np.atleast_3d(np.asarray(picture, np.float32))
    height, width = size
    resample = Image.Resampling.BILINEAR
    result = [
        np.asarray(Image.fromarray(np.ascontiguousarray(plane)).resize((width, height), resample))
        for plane in np.moveaxis(planes, 2, 0)
    ]
    return np.stack(result, axis=2).reshape(*size, *picture.shape[2:])


def square_window(
    picture: Float[np.ndarray, "h w 3"], centre: Float[np.ndarray, "2"], side: float, size: int
) -> Float[np.ndarray, "s s 3"]:
    """An upright square of the picture, resampled; zero beyond its border.

    Args:
        picture: shape (h, w, 3).
        centre: column and row of the middle [px].
        side: length of the square in the picture [px].
        size: rows and columns of the result.
    """
    scale = side / size
    if scale > 1.0:  # average first, so that thin things do not vanish
        height, width = picture.shape[:2]
        small = max(1, round(height / scale)), max(1, round(width / scale))
        factors = np.array([small[1] / width, small[0] / height])
        picture = resized(picture, small)
        centre = (centre + 0.5) * factors - 0.5
        steps = side * factors / size
    else:
        steps = np.array([scale, scale])
    offsets = np.arange(size) - 0.5 * (size - 1)
    rows, columns = np.meshgrid(
        centre[1] + steps[1] * offsets, centre[0] + steps[0] * offsets, indexing="ij"
    )
    planes = [
        map_coordinates(picture[..., channel], [rows, columns], order=1, mode="grid-constant")
        for channel in range(3)
    ]
    return np.stack(planes, axis=2).astype(np.float32)
