"""An atlas without holes: unseen texels from their neighbours or from a tile, and a gutter."""

import dataclasses
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from jaxtyping import Float
from scipy.ndimage import distance_transform_edt, map_coordinates

from dress_jax.texture.atlas import Atlas, Texels
from dress_jax.texture.baking import Baked
from dress_jax.texture.tiling import Tile

REACH = 0.01
"""Unseen cloth this near to seen cloth [m] takes the colour of the nearest of it."""


@dataclasses.dataclass(frozen=True)
class Shares:
    """Where the texels of a panel come from, as parts of all of them.

    Attributes:
        seen: from the views.
        neighbours: from seen texels of the same panel.
        tile: from the tile.
        mean: from the mean of everything seen: a panel of which nothing is, without a tile.
    """

    seen: float
    neighbours: float
    tile: float
    mean: float


def fill(
    atlas: Atlas,
    texels: Texels,
    baked: Baked,
    panels: int,
    tiles: Sequence[Tile | None],
    *,
    reach: float = REACH,
) -> tuple[Float[np.ndarray, "h w 3"], list[Shares]]:
    """The atlas' picture, complete.

    Unseen texels within `reach` of seen ones of the same panel take the nearest one's colour.
    Beyond, they take the tile's; where there is none, a smooth interpolation of what the panel
    shows (pull-push over a pyramid). Around the panels the nearest texel is repeated, so that
    filtering does not draw the background in.

    Args:
        atlas: its size.
        texels: of the atlas.
        baked: what is seen of them.
        panels: number of panels.
        tiles: for each panel, or None.
        reach: [m].

    Returns:
        Colours in [0, 1], and where each panel's texels come from.
    """
    image = np.zeros((atlas.height, atlas.width, 3))
    inside = np.zeros((atlas.height, atlas.width), bool)
    inside[texels.row, texels.column] = True
    mean = baked.colors[baked.seen].mean(axis=0)
    shares = []
    for panel in range(panels):
        own = np.flatnonzero(texels.panel == panel)
        if not len(own):
            shares.append(Shares(0.0, 0.0, 0.0, 0.0))
            continue
        colors, share = _complete(atlas, texels, baked, own, tiles[panel], mean, reach)
        image[texels.row[own], texels.column[own]] = colors
        shares.append(share)
    if not inside.all():
        _, nearest = _nearest(~inside)
        image = image[nearest[0], nearest[1]]
    return np.clip(image, 0.0, 1.0), shares


def tile_colors(tile: Tile, coordinates: Float[np.ndarray, "q 2"]) -> Float[np.ndarray, "q 3"]:
    """The colours of a tile, repeated, at places on the panel [m]."""
    height, width = tile.image.shape[:2]
    across = (coordinates[:, 0] - tile.corner[0]) / tile.size[0] * width - 0.5
    down = height - (coordinates[:, 1] - tile.corner[1]) / tile.size[1] * height - 0.5
    return np.stack(
        [
            map_coordinates(tile.image[..., k], [down, across], order=1, mode="grid-wrap")
            for k in range(3)
        ],
        axis=-1,
    )


def _complete(atlas, texels, baked, own, tile, mean, reach):
    """Colours of one panel's texels, and where they come from."""
    colors, seen = baked.colors[own].copy(), baked.seen[own]
    row, column = texels.row[own], texels.column[own]
    row, column = row - row.min(), column - column.min()
    shape = (int(row.max()) + 1, int(column.max()) + 1)
    near = np.zeros(len(own), bool)
    if seen.any() and not seen.all():
        empty = np.ones(shape, bool)
        empty[row[seen], column[seen]] = False
        distance, nearest = _nearest(empty)
        near = ~seen & (distance[row, column] * atlas.texel_size <= reach)
        picture = np.zeros((*shape, 3))
        picture[row, column] = colors
        source = nearest[:, row[near], column[near]]
        colors[near] = picture[source[0], source[1]]
    rest = ~seen & ~near
    by_tile = by_mean = 0
    if rest.any() and tile is not None:
        colors[rest] = tile_colors(tile, texels.coordinates[own[rest]])
        by_tile = int(rest.sum())
    elif rest.any() and seen.any():
        picture, weight = np.zeros((*shape, 3)), np.zeros(shape)
        picture[row[~rest], column[~rest]] = colors[~rest]
        weight[row[~rest], column[~rest]] = 1.0
        colors[rest] = _pull_push(picture, weight)[row[rest], column[rest]]
        near |= rest
    elif rest.any():
        colors[rest] = mean
        by_mean = int(rest.sum())
    count = len(own)
    return colors, Shares(
        seen=int(seen.sum()) / count,
        neighbours=int(near.sum()) / count,
        tile=by_tile / count,
        mean=by_mean / count,
    )


def _nearest(empty: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance to the nearest texel that is not empty, and its row and column, shape (2, h, w)."""
    distance, nearest = cast(Any, distance_transform_edt)(empty, return_indices=True)
    return distance, nearest


def _pull_push(image: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Known pixels as they are, the others from coarser and coarser means of known ones."""
    if weight.all() or min(weight.shape) == 1:
        known = weight > 0.0
        mean = image[known].mean(axis=0)
        return np.where(known[..., None], image, mean)
    padding = [(0, n % 2) for n in weight.shape]
    weighted = np.pad(image * weight[..., None], [*padding, (0, 0)])
    padded = np.pad(weight, padding)
    blocks = (weighted.shape[0] // 2, 2, weighted.shape[1] // 2, 2)
    total = padded.reshape(blocks).sum(axis=(1, 3))
    coarse = weighted.reshape(*blocks, 3).sum(axis=(1, 3)) / np.maximum(total, 1e-12)[..., None]
    coarse = _pull_push(coarse, (total > 0.0).astype(np.float64))
    place = [
        np.clip((np.arange(n) + 0.5) / 2.0 - 0.5, 0.0, m - 1.0)
        for n, m in zip(weight.shape, total.shape, strict=True)
    ]
    grid = np.meshgrid(*place, indexing="ij")
    fine = np.stack(
        [map_coordinates(coarse[..., k], grid, order=1, mode="nearest") for k in range(3)], axis=-1
    )
    return np.where(weight[..., None] > 0.0, image, fine)
