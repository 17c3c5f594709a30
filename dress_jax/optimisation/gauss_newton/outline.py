"""Distances between the outlines of masks, linearized. Host side, numpy."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.ndimage
import scipy.sparse
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

_SMOOTHING = 1.0  # of the mask for its normals [px]
_NORMAL_SHARE = 1.0  # distance at which normal and direction to the target count alike [px]


class Outline(NamedTuple):
    """The outline of one mask.

    Attributes:
        points: where it crosses rows and columns of pixel centres, (column, row) [px], (m, 2).
        normals: unit vectors away from the mask, (m, 2).
    """

    points: Float[np.ndarray, "m 2"]
    normals: Float[np.ndarray, "m 2"]


class Crossings(NamedTuple):
    """The outline of a drawn garment in one view; see `render.contours.Contour`."""

    points: Float[np.ndarray, "q 2"]
    vertical: Bool[np.ndarray, " q"]
    vertices: Int[np.ndarray, "q 2"]
    slope: Float[np.ndarray, "q 2 3"]


class Rows(NamedTuple):
    """Residuals that are linear in the vertices.

    Attributes:
        residual: distance [m], (r,).
        jacobian: its derivative in the flattened positions, (r, 3 n).
        weight: share of each residual in the mean, (r,).
    """

    residual: Float[np.ndarray, " r"]
    jacobian: scipy.sparse.csr_matrix
    weight: Float[np.ndarray, " r"]


def find_outline(mask: Float[np.ndarray, "h w"], valid: Bool[np.ndarray, "h w"]) -> Outline:
    """The outline of an antialiased mask at half coverage, to a fraction of a pixel.

    Args:
        mask: coverage in [0, 1].
        valid: where the mask is known; its outline elsewhere is left out.
    """
    mask = np.asarray(mask, np.float64)
    inside = mask > 0.5
    found = []
    for axis in (0, 1):
        values = np.moveaxis(mask, axis, 1)
        sides = np.moveaxis(inside, axis, 1)
        known = np.moveaxis(valid, axis, 1)
        line, before = np.nonzero((sides[:, :-1] != sides[:, 1:]) & known[:, :-1] & known[:, 1:])
        low, high = values[line, before], values[line, before + 1]
        along = before + (0.5 - low) / (high - low)
        found.append(np.stack([line, along] if axis == 0 else [along, line], axis=1))
    points = np.concatenate(found).astype(np.float64)
    smooth = scipy.ndimage.gaussian_filter(mask, _SMOOTHING)
    rows, columns = np.gradient(smooth)
    at = points[:, ::-1].T
    normals = -np.stack(
        [scipy.ndimage.map_coordinates(g, at, order=1, mode="nearest") for g in (columns, rows)],
        axis=1,
    )
    length = np.linalg.norm(normals, axis=1)
    usable = length > 0.0  # a feature of one pixel may have no side
    return Outline(points[usable], normals[usable] / length[usable, None])


def outline_rows(
    targets: Sequence[Outline],
    drawn: Sequence[Crossings],
    metres_per_pixel: Float[np.ndarray, " v"],
    vertex_count: int,
) -> Rows:
    """Distances between drawn and target outlines, from either to the nearest point of the other.

    Both directions count half: one alone would miss parts that only the other outline has. A
    residual is a signed distance in the image, and a crossing moves along its row or column.

    Args:
        targets: outline of every view; a view with an empty one is left out.
        drawn: crossings of every view.
        metres_per_pixel: at the garment's distance, for every view.
        vertex_count: n.
    """
    residuals, weights, triples, count = [], [], [], 0
    views = sum(len(target.points) > 0 for target in targets)
    for target, crossings, metres in zip(targets, drawn, metres_per_pixel, strict=True):
        if not len(target.points) or not len(crossings.points):
            continue
        _, nearest = cKDTree(target.points).query(crossings.points)
        _, back = cKDTree(crossings.points).query(target.points)
        for own, other in ((np.arange(len(nearest)), nearest), (back, np.arange(len(back)))):
            offset = crossings.points[own] - target.points[other]
            direction = _directions(offset, target.normals[other])
            residuals.append(metres * np.sum(direction * offset, axis=1))
            weights.append(np.full(len(own), 0.5 / (views * len(target.points))))
            moving = np.where(crossings.vertical[own], direction[:, 1], direction[:, 0])
            entries = (metres * moving)[:, None, None] * crossings.slope[own]
            columns = 3 * crossings.vertices[own][:, :, None] + np.arange(3)
            rows = np.broadcast_to(count + np.arange(len(own))[:, None, None], columns.shape)
            triples.append((entries.ravel(), rows.ravel(), columns.ravel()))
            count += len(own)
    if not triples:
        empty = scipy.sparse.csr_matrix((0, 3 * vertex_count))
        return Rows(np.zeros(0), empty, np.zeros(0))
    entries, rows, columns = (np.concatenate(part) for part in zip(*triples, strict=True))
    moving = entries != 0.0  # the occluder's outlines name vertices that are not the garment's
    jacobian = scipy.sparse.csr_matrix(
        (entries[moving], (rows[moving], columns[moving])), shape=(count, 3 * vertex_count)
    )
    return Rows(np.concatenate(residuals), jacobian, np.concatenate(weights))


def _directions(
    offset: Float[np.ndarray, "m 2"], normals: Float[np.ndarray, "m 2"]
) -> Float[np.ndarray, "m 2"]:
    """Along which a distance is measured: the normal close by, the way between the points far off.

    The normal alone would see no distance beyond the corner of an outline.
    """
    side = np.where(np.sum(offset * normals, axis=1) < 0.0, -1.0, 1.0)
    direction = side[:, None] * offset + _NORMAL_SHARE * normals
    return direction / np.linalg.norm(direction, axis=1, keepdims=True)
