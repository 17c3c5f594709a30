"""Panel textures from all views: every texel takes what the views show of its point of the cloth.

A texel counts in a view where its point projects beside pixels that look at the same place of the
same panel, on the outside of the cloth, inside the picture's mask. Comparing places on the panel,
not depths, tells layers of cloth apart that lie closer together than a pixel is wide.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from dress_jax.core.errors import InputError
from dress_jax.render.cameras import Camera
from dress_jax.texture.atlas import Texels
from dress_jax.texture.panel_maps import PanelMap, project_points, view_of_points

SHARPNESS = 4.0
"""Exponent of a view's weight. Means of views that do not agree to a pixel are blurred, so the best
view should outweigh the others; a choice of the best alone would show where it changes."""

SMALLEST_COSINE = 0.2
"""Cloth that is seen at less than 12 degrees is not looked at."""

INSIDE = 0.99
"""Coverage by the mask from which a pixel shows the garment and nothing else."""

_HALF = 0.5  # of a sample's four pixels must show its cloth


@dataclasses.dataclass(frozen=True)
class View:
    """One picture of the garment.

    Attributes:
        camera: that took it.
        picture: colours in [0, 1], shape (h, w, 3).
        mask: coverage by the garment in [0, 1], shape (h, w).
        seen: the panels as the camera sees them.
    """

    camera: Camera
    picture: Float[np.ndarray, "h w 3"]
    mask: Float[np.ndarray, "h w"]
    seen: PanelMap


@dataclasses.dataclass(frozen=True)
class Baked:
    """What the views say of the texels.

    Attributes:
        colors: in [0, 1], zero where unseen, shape (q, 3).
        seen: shape (q,).
        views: number of views that show each texel, shape (q,).
    """

    colors: Float[np.ndarray, "q 3"]
    seen: Bool[np.ndarray, " q"]
    views: Int[np.ndarray, " q"]


def outer_sides(views: Sequence[View], panels: int) -> Float[np.ndarray, " panels"]:
    """The side of each panel that is the outside: the one that is seen more.

    Files do not agree on which way panels face, and a print is on one side of the cloth.

    Returns:
        +1 where it is the side from which faces run counter-clockwise, else -1.
    """
    balance = np.zeros(panels)
    for view in views:
        own = view.seen.panel >= 0
        balance += np.bincount(view.seen.panel[own], view.seen.side[own], minlength=panels)
    return np.where(balance < 0.0, -1.0, 1.0)


def bake(views: Sequence[View], texels: Texels, sides: Float[np.ndarray, " panels"]) -> Baked:
    """The weighted mean of what the views show of every texel.

    The weight is (cosine x resolution) ^ `SHARPNESS`: how many pixels a length of the cloth takes
    up across the direction in which it is foreshortened.

    Args:
        views: pictures of the garment.
        texels: of the atlas.
        sides: from `outer_sides`.

    Raises:
        InputError: no view shows any of the garment.
    """
    colors = np.zeros((len(texels.row), 3))
    total = np.zeros(len(texels.row))
    count = np.zeros(len(texels.row), np.int64)
    finest = min((float(view.seen.spacing.min()) for view in views), default=1.0)
    for view in views:
        sample, weight = _look(view, texels, sides[texels.panel], finest)
        colors += weight[:, None] * sample
        total += weight
        count += weight > 0.0
    seen = total > 0.0
    if not seen.any():
        raise InputError(
            "no view shows any of the garment",
            where="texture",
            mend="see that the garment, the masks and the cameras belong together",
        )
    return Baked(colors / np.where(seen, total, 1.0)[:, None], seen, count)


def _look(
    view: View, texels: Texels, sides: Float[np.ndarray, " q"], finest: float
) -> tuple[Float[np.ndarray, "q 3"], Float[np.ndarray, " q"]]:
    """Colour and weight of every texel in one view."""
    cosine, spacing = view_of_points(view.camera, texels.positions, texels.normals)
    cosine = cosine * sides
    x, y = project_points(view.camera, texels.positions)
    height, width = view.mask.shape
    candidate = (cosine >= SMALLEST_COSINE) & (x > -0.5) & (x < width - 0.5)
    candidate &= (y > -0.5) & (y < height - 0.5)
    chosen = np.flatnonzero(candidate)
    x, y = x[chosen], y[chosen]
    # A neighbouring pixel's ray meets the cloth within this distance, if it meets the same layer;
    # twice that, because cloth is stretched and curved.
    reach = 2.0 * np.sqrt(2.0) * spacing[chosen] / cosine[chosen]
    usable = (view.mask >= INSIDE) & (view.seen.side * view.seen.cosine != 0.0)
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    color = np.zeros((len(chosen), 3))
    share = np.zeros(len(chosen))
    for down in (0, 1):
        for right in (0, 1):
            column = np.clip(left + right, 0, width - 1)
            row = np.clip(top + down, 0, height - 1)
            apart = view.seen.coordinates[row, column] - texels.coordinates[chosen]
            good = usable[row, column] & (view.seen.panel[row, column] == texels.panel[chosen])
            good &= view.seen.side[row, column] == sides[chosen]
            good &= np.linalg.norm(apart, axis=1) <= reach
            part = np.abs(1 - right - (x - left)) * np.abs(1 - down - (y - top)) * good
            color += part[:, None] * view.picture[row, column]
            share += part
    known = share >= _HALF
    colors = np.zeros((len(texels.row), 3))
    weights = np.zeros(len(texels.row))
    colors[chosen[known]] = color[known] / share[known, None]
    resolution = finest / spacing[chosen]
    weights[chosen[known]] = ((cosine[chosen] * resolution) ** SHARPNESS)[known]
    return colors, weights
