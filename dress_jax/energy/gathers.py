"""Gathers: seams whose sides have different lengths.

A seam is welded segment by segment, so both sides get one length in space. Where a long edge is
sewn to a short one, a plain membrane would stretch the short panel and press the long one together,
by half of it for a cuff on a full sleeve. Real cloth does neither: the gathering thread draws the
long edge up to the length of the short one, in folds that are smaller than the triangles of the
mesh. So the rest shape of the triangles on the long side is drawn up along the seam, and only
there; a row further the panel is as wide as it was cut, and folds where the mesh can show it.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.core import components as c
from dress_jax.core.pytree import pytree
from dress_jax.energy.rest import RestTriangles, rest_triangles
from dress_jax.geometry.topology import hinges as find_hinges

# A seam below this ratio of its lengths is eased: the cloth itself takes up the difference. Beyond
# the other one it is no gather but a fault of the pattern, and shall show as the strain that it is.
SMALLEST_RATIO, LARGEST_RATIO = 1.2, 5.0
# Of the short side's segments, over the median edge of the mesh. Where a seam is cut finer it shows
# a detail, the outline of a letter, and a triangle drawn up to it would be a needle.
SMALLEST_SEGMENT = 0.25


@pytree
class Gathers:
    """The triangles on the long sides of gathered seams; index arrays only.

    Attributes:
        faces: the triangles, each at most once, (g,).
        own: panel vertices at the ends of its edge on the seam, (2, g).
        other: the same of the short edge that it is drawn up to, (2, g).
    """

    faces: Int[Array, " g"]
    own: Int[Array, "2 g"]
    other: Int[Array, "2 g"]


def find_gathers(
    faces: Int[np.ndarray, "f 3"],
    rest_faces: Int[np.ndarray, "f 3"],
    rest_positions: Float[np.ndarray, "p 2"],
) -> Gathers:
    """Seam edges, one side `SMALLEST_RATIO` to `LARGEST_RATIO` times as long as the other.

    Segments far finer than the mesh (`SMALLEST_SEGMENT`) are left alone. A triangle with two such
    edges, in a corner of a panel, is drawn up along the one that is longer by more.

    Args:
        faces: vertices of the welded triangles.
        rest_faces: panel vertices of the same triangles.
        rest_positions: panel coordinates [m].
    """
    found = find_hinges(faces)
    rest_faces, rest = np.asarray(rest_faces), np.asarray(rest_positions, np.float64)
    ends = np.stack(
        [
            np.stack([rest_faces[face, (corner + k) % 3] for k in (1, 2)])
            for face, corner in zip(found.faces.T, found.local_corner.T, strict=True)
        ]
    )  # (side, end, hinge)
    lengths = np.linalg.norm(rest[ends[:, 1]] - rest[ends[:, 0]], axis=-1)
    corners = rest[rest_faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    finest = SMALLEST_SEGMENT * np.median(edges) if edges.size else 0.0
    rows = []
    for long, short in ((0, 1), (1, 0)):
        least, most = SMALLEST_RATIO * lengths[short], LARGEST_RATIO * lengths[short]
        gathered = (least <= lengths[long]) & (lengths[long] <= most)
        at = np.flatnonzero(gathered & (lengths[short] >= finest))
        ratio = lengths[long, at] / lengths[short, at]
        rows.append((ratio, found.faces[at, long], ends[long][:, at], ends[short][:, at]))
    ratio, owner, own, other = (np.concatenate(part, axis=-1) for part in zip(*rows, strict=True))
    order = np.lexsort((-ratio, owner))
    unique, first = np.unique(owner[order], return_index=True)
    chosen = order[first]
    return Gathers(
        jnp.asarray(unique, jnp.int32),
        jnp.asarray(own[:, chosen], jnp.int32),
        jnp.asarray(other[:, chosen], jnp.int32),
    )


def no_gathers() -> Gathers:
    """Of a cloth without seams, or with seams of equal sides only."""
    return Gathers(
        jnp.zeros(0, jnp.int32), jnp.zeros((2, 0), jnp.int32), jnp.zeros((2, 0), jnp.int32)
    )


def gathered_corners(
    rest_positions: Float[np.ndarray, "p 2"], rest_faces: Int[np.ndarray, "f 3"], gathers: Gathers
) -> Float[np.ndarray, "f 3 2"]:
    """Corners of the triangles, drawn up along gathered seams, on the host [m]."""
    rest = np.asarray(rest_positions, np.float64)
    corners = rest[np.asarray(rest_faces)]
    faces, own, other = (np.asarray(part) for part in (gathers.faces, gathers.own, gathers.other))
    edge, short = rest[own[1]] - rest[own[0]], rest[other[1]] - rest[other[0]]
    length = np.linalg.norm(edge, axis=1)
    along = (edge / length[:, None])[:, None]
    ratio = np.linalg.norm(short, axis=1) / length
    parts = np.sum(corners[faces] * along, axis=2, keepdims=True)
    corners[faces] += (ratio - 1.0)[:, None, None] * parts * along
    return corners


def gathered_triangles(
    rest_positions: Float[Array, "p 2"], rest_faces: Int[Array, "3 f"], gathers: Gathers
) -> RestTriangles:
    """The rest shape that the membrane knows: flat triangles, drawn up along gathered seams.

    A triangle is scaled by the ratio of the two lengths in the direction of its seam edge, so it
    follows both panels when they change. Areas are those of the flat triangles: the cloth in the
    folds is there, with its mass and its stiffness.

    Args:
        rest_positions: panel coordinates [m].
        rest_faces: corners of each triangle.
        gathers: of the same triangles.
    """
    rest = rest_triangles(rest_positions, rest_faces)
    columns = c.split(rest_positions)
    own, other = (
        c.subtract(c.gather(columns, ends[1]), c.gather(columns, ends[0]))
        for ends in (gathers.own, gathers.other)
    )
    squared = c.dot(own, own)
    # The inverse of I + (ratio - 1) u u^T, times the inverse edge matrix from the left.
    widening = (jnp.sqrt(squared / c.dot(other, other)) - 1.0) / squared
    entries = []
    for row in (rest.inverse[:2], rest.inverse[2:]):
        along = widening * c.dot(c.gather(row, gathers.faces), own)
        entries += [row[k].at[gathers.faces].add(along * own[k]) for k in range(2)]
    first, second, third, fourth = entries
    return RestTriangles((first, second, third, fourth), rest.areas)
