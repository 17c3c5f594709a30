"""What the energies need of the rest shape, differentiable in it (S9.7, S21.4)."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dress_jax.core import components as c
from dress_jax.core.pytree import pytree


@pytree
class RestTriangles:
    """Rest shape of the triangles, in component form.

    Attributes:
        inverse: entries (00, 01, 10, 11) of the inverse rest edge matrix [1/m], each (f,).
        areas: rest areas [m^2], (f,).
    """

    inverse: tuple[Array, Array, Array, Array]
    areas: Float[Array, " f"]


def rest_triangles(
    rest_positions: Float[Array, "p 2"], rest_faces: Int[Array, "3 f"]
) -> RestTriangles:
    """Inverse edge matrices and areas of the rest triangles.

    Args:
        rest_positions: panel coordinates [m].
        rest_faces: corners of each triangle, counter-clockwise in panel coordinates or clockwise
            throughout a panel; areas are unsigned, so mirrored panels are allowed.
    """
    columns = c.split(rest_positions)
    corners = [c.gather(columns, rest_faces[k]) for k in range(3)]
    first = c.subtract(corners[1], corners[0])
    second = c.subtract(corners[2], corners[0])
    determinant = first[0] * second[1] - first[1] * second[0]
    inverse = (
        second[1] / determinant,
        -second[0] / determinant,
        -first[1] / determinant,
        first[0] / determinant,
    )
    return RestTriangles(inverse=inverse, areas=0.5 * jnp.abs(determinant))


def vertex_areas(
    areas: Float[Array, " f"], faces: Int[Array, "3 f"], vertex_count: int
) -> Float[Array, " n"]:
    """A third of the area of the triangles around each vertex [m^2]."""
    third = areas / 3.0
    total = jnp.zeros(vertex_count, areas.dtype)
    for k in range(3):
        total = total.at[faces[k]].add(third)
    return total


def hinge_weights(
    rest_positions: Float[Array, "p 2"],
    rest_faces: Int[Array, "3 f"],
    areas: Float[Array, " f"],
    hinge_faces: Int[Array, "2 h"],
    hinge_corners: Int[Array, "2 h"],
) -> Float[Array, " h"]:
    """The dimensionless weight e/h = e^2 / (A1 + A2) of each hinge, h the two heights' mean.

    C-IPC takes a third of that h; a rolled sheet of equilateral triangles then has three times its
    flexural energy.

    The shared edge may have two rest lengths where a seam joins panels of different length (a
    gather); their mean is used.

    Args:
        hinge_faces: the two triangles of each hinge.
        hinge_corners: the corner (0, 1, 2) opposite the shared edge in each of them.
    """
    lengths = []
    for side in range(2):
        edge = _hinge_edge(rest_positions, rest_faces, hinge_faces[side], hinge_corners[side])
        lengths.append(jnp.sqrt(c.dot(edge, edge)))
    length = 0.5 * (lengths[0] + lengths[1])
    return length**2 / (areas[hinge_faces[0]] + areas[hinge_faces[1]])


def _hinge_edge(
    rest_positions: Float[Array, "p 2"],
    rest_faces: Int[Array, "3 f"],
    face: Int[Array, " h"],
    corner: Int[Array, " h"],
) -> c.Components:
    """The shared edge of each hinge in the panel of one of its triangles [m]."""
    columns = c.split(rest_positions)
    start = c.gather(columns, rest_faces[(corner + 1) % 3, face])
    end = c.gather(columns, rest_faces[(corner + 2) % 3, face])
    return c.subtract(end, start)


def hinge_anisotropy(
    rest_positions: Float[Array, "p 2"],
    rest_faces: Int[Array, "3 f"],
    hinge_faces: Int[Array, "2 h"],
    hinge_corners: Int[Array, "2 h"],
    anisotropy: Float[Array, ""] | Float[Array, " f"],
    grain_angle: Float[Array, ""] | Float[Array, " f"],
) -> Float[Array, " h"]:
    """How much stiffer or softer than the mean a hinge is for the direction in which it bends.

    The factor is 1 + 3/2 a cos 2 phi, where phi is the angle from the warp to the direction across
    the edge, and a = (B_warp - B_weft) / (B_warp + B_weft). Averaged over edges in all directions,
    the plate then has B_warp and B_weft: the mean of cos^4 is 3/8, that of cos^4 cos 2 phi is 1/4.
    Positive for |a| < 2/3, a ratio of five. A hinge on a seam takes the mean of its two sides.

    Args:
        anisotropy: a, () or (f,).
        grain_angle: of the warp from the panel's +y, counter-clockwise [rad], () or (f,).
    """
    factors = []
    for side in range(2):
        face = hinge_faces[side]
        ex, ey = _hinge_edge(rest_positions, rest_faces, face, hinge_corners[side])
        a, grain = (v if v.ndim == 0 else v[face] for v in (anisotropy, grain_angle))
        double = (ex * ex - ey * ey) * jnp.cos(2.0 * grain) + 2.0 * ex * ey * jnp.sin(2.0 * grain)
        factors.append(1.0 + 1.5 * a * double / (ex * ex + ey * ey))
    return 0.5 * (factors[0] + factors[1])
