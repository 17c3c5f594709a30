"""Values of panels or vertices as values of triangles and hinges, differentiably.

The parameters of a cloth hold stiffness and density per triangle and per hinge; a garment is made
of panels, and a painted map has a value at each vertex.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int


def panels_to_triangles(
    values: Float[Array, " panels"], face_panel: Int[Array, " f"]
) -> Float[Array, " f"]:
    """The value of the panel that each triangle belongs to.

    Args:
        values: one per panel.
        face_panel: panel of each triangle.
    """
    return jnp.asarray(values)[jnp.asarray(face_panel)]


def vertices_to_triangles(
    values: Float[Array, " n"], faces: Int[Array, "3 f"]
) -> Float[Array, " f"]:
    """The mean over the corners of each triangle.

    Args:
        values: one per vertex; with `Cloth.rest_faces` as faces one per panel vertex.
        faces: corners of each triangle, as in `Cloth.faces`.
    """
    values = jnp.asarray(values)
    return (values[faces[0]] + values[faces[1]] + values[faces[2]]) / 3.0


def triangles_to_hinges(
    values: Float[Array, " f"], hinge_faces: Int[Array, "2 h"]
) -> Float[Array, " h"]:
    """The mean over the two triangles of each hinge: a seam between two fabrics takes both halves.

    Args:
        values: one per triangle.
        hinge_faces: the two triangles of each hinge, as in `Cloth.hinge_faces`.
    """
    values = jnp.asarray(values)
    return 0.5 * (values[hinge_faces[0]] + values[hinge_faces[1]])
