"""Flat panels side by side in one picture: the pattern is the texture space (S14.4).

Panels are moved, never turned or scaled against each other: the grain stays upright, and a texel is
the same piece of cloth everywhere.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from dress_jax.core.errors import InputError
from dress_jax.render.cameras import Camera, orthographic_camera
from dress_jax.texture.panel_maps import see
from dress_jax.texture.surface import PanelSurface

LARGEST_SIDE = 8192
"""Texels; graphics hardware of any age takes that much."""


@dataclasses.dataclass(frozen=True)
class Atlas:
    """Where the panels lie in the picture.

    Attributes:
        texel_size: edge length of a texel [m].
        height, width: of the picture [texels]; row 0 is at the top.
        offsets: from panel coordinates to the place in the atlas, measured from its lower left
            corner [m], shape (panels, 2).
    """

    texel_size: float
    height: int
    width: int
    offsets: Float[np.ndarray, "panels 2"]


@dataclasses.dataclass(frozen=True)
class Texels:
    """The texels whose centres lie on a panel, and the surface points that they show.

    Attributes:
        row, column: place in the atlas, shape (q,).
        panel: shape (q,).
        coordinates: on the panel [m], shape (q, 2).
        positions: in space [m], shape (q, 3).
        normals: unit length, shape (q, 3).
    """

    row: Int[np.ndarray, " q"]
    column: Int[np.ndarray, " q"]
    panel: Int[np.ndarray, " q"]
    coordinates: Float[np.ndarray, "q 2"]
    positions: Float[np.ndarray, "q 3"]
    normals: Float[np.ndarray, "q 3"]


def pack_panels(surface: PanelSurface, texel_size: float, *, margin: int = 4) -> Atlas:
    """Lay the panels out on shelves, the tallest first.

    Args:
        surface: the garment.
        texel_size: edge length of a texel [m].
        margin: empty texels around every panel; filtering must not reach the neighbour.

    Raises:
        InputError: the texel size is not positive, or the atlas would be too large.
    """
    if not texel_size > 0.0:
        raise InputError(f"the texel size is {texel_size}", where="atlas", mend="give metres")
    low, size = _boxes(surface, texel_size)
    size = size + 2 * margin
    wide = int(size[:, 0].max(initial=1))
    limit = max(wide, int(np.ceil(np.sqrt(float(np.prod(size, axis=1, dtype=np.float64).sum())))))
    corner, height, width = _shelves(size, limit)
    if max(height, width) > LARGEST_SIDE:
        raise InputError(
            f"an atlas of {width} x {height} texels is too large",
            where="atlas",
            mend=f"use texels larger than {1e3 * texel_size:g} mm",
        )
    # Corners count from the upper left, panel coordinates grow upward.
    left = corner[:, 0] + margin
    bottom = height - corner[:, 1] - size[:, 1] + margin
    offsets = texel_size * np.stack([left, bottom], axis=1) - low
    return Atlas(texel_size, height, width, offsets)


def atlas_coordinates(atlas: Atlas, surface: PanelSurface) -> Float[np.ndarray, "p 2"]:
    """Texture coordinates of the panel vertices: 0 to 1 over the picture, (0, 0) at its lower left
    corner; on every panel an affine function of its coordinates (S14.4)."""
    place = surface.coordinates + atlas.offsets[surface.vertex_panels]
    return place / (atlas.texel_size * np.array([atlas.width, atlas.height]))


def find_texels(atlas: Atlas, surface: PanelSurface) -> Texels:
    """The texels on the panels, by drawing the flat panels with their places in space."""
    place = surface.coordinates + atlas.offsets[surface.vertex_panels]
    flat = np.concatenate([place, np.zeros((len(place), 1))], axis=1)
    attributes = np.concatenate([surface.coordinates, surface.positions, surface.normals], axis=1)
    sight = see(_flat_camera(atlas), flat, surface.faces, attributes)
    row, column = np.nonzero(sight.face >= 0)
    values = sight.values[row, column]
    normals = values[:, 5:]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return Texels(
        row=row,
        column=column,
        panel=surface.face_panels[sight.face[row, column]],
        coordinates=values[:, :2],
        positions=values[:, 2:5],
        normals=normals / np.where(length > 0.0, length, 1.0),
    )


def _flat_camera(atlas: Atlas) -> Camera:
    extent = atlas.texel_size * np.array([atlas.width, atlas.height])
    return orthographic_camera(
        rotation=np.eye(3),
        position=np.array([0.5 * extent[0], 0.5 * extent[1], 1.0]),
        half_extent=0.5 * float(extent[1]),
        height=atlas.height,
        width=atlas.width,
    )


def _boxes(surface: PanelSurface, texel_size: float) -> tuple[np.ndarray, np.ndarray]:
    """Lower left corner [m] and size [texels] of every panel; empty ones have no size."""
    low = np.zeros((len(surface.panels), 2))
    size = np.zeros((len(surface.panels), 2), np.int64)
    for number in range(len(surface.panels)):
        own = surface.coordinates[surface.faces[surface.face_panels == number].ravel()]
        if len(own):
            low[number] = own.min(axis=0)
            size[number] = np.ceil((own.max(axis=0) - low[number]) / texel_size)
    return low, size


def _shelves(size: np.ndarray, limit: int) -> tuple[np.ndarray, int, int]:
    """Upper left corners of boxes on shelves not wider than `limit`, and the size of it all."""
    corner = np.zeros_like(size)
    order: Sequence[int] = np.argsort(-size[:, 1], kind="stable").tolist()
    across = top = shelf = width = 0
    for number in order:
        if across and across + size[number, 0] > limit:
            across, top, shelf = 0, top + shelf, 0
        corner[number] = across, top
        across += int(size[number, 0])
        shelf = max(shelf, int(size[number, 1]))
        width = max(width, across)
    return corner, top + shelf, width
