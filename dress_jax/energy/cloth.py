"""The cloth: its index arrays and its parameters."""

import enum

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import pytree, static
from dress_jax.energy.gathers import Gathers, find_gathers, no_gathers
from dress_jax.energy.membrane import MembraneModel
from dress_jax.energy.panels import FacePanels
from dress_jax.energy.rest import rest_triangles, vertex_areas
from dress_jax.energy.strain_limit import StrainLimit
from dress_jax.energy.surface import check_faces, check_indices
from dress_jax.geometry.topology import hinges as find_hinges


@pytree
class Cloth:
    """Topology of a garment mesh: index arrays only, nothing differentiable.

    Attributes:
        faces: vertices of each triangle, (3, f).
        rest_faces: panel vertices of each triangle, (3, f).
        hinges: [v0, v1 shared edge; v2, v3 opposite], (4, h).
        hinge_faces: the two triangles of each hinge, (2, h).
        hinge_corners: the corner opposite the shared edge in each of them, (2, h).
        pins: vertices held by springs, (k,).
        stitches: pairs of vertices pulled together, (2, s).
        gathers: seam edges that are drawn up to shorter ones.
        vertex_count: n.
        membrane: which membrane energy is used.
    """

    faces: Int[Array, "3 f"]
    rest_faces: Int[Array, "3 f"]
    hinges: Int[Array, "4 h"]
    hinge_faces: Int[Array, "2 h"]
    hinge_corners: Int[Array, "2 h"]
    pins: Int[Array, " k"]
    stitches: Int[Array, "2 s"]
    gathers: Gathers
    vertex_count: int = static()
    membrane: MembraneModel = static(default=MembraneModel.ARAP)


@pytree
class Parameters:
    """Everything continuous that a drape depends on (the paper's varsigma, S2.2); all leaves are
    differentiable and independent of each other.

    Attributes:
        rest_positions: panel coordinates of the panel vertices [m], (p, 2).
        density: [kg/m^2], () or per triangle (f,).
        stretching_stiffness: k_s [N/m] of an isotropic membrane, () or (f,).
        poisson_ratio: of the neo-Hookean membrane; of the orthotropic one the geometric mean of
            its two Poisson ratios, () or (f,).
        warp_stiffness, weft_stiffness: tensile moduli times the thickness of the orthotropic
            membrane [N/m], () or (f,).
        shear_stiffness: its shear modulus times the thickness [N/m], () or (f,).
        grain_angle: of the warp, for stretching and bending, from the panel's +y, counter-clockwise
            [rad], () or (f,).
        bending_stiffness: flexural rigidity k_b [N m], the mean of warp and weft, () or per hinge
            (h,).
        bending_anisotropy: (B_warp - B_weft) / (B_warp + B_weft), between -2/3 and 2/3, () or (f,).
        gravity: [m/s^2], (3,).
        pin_targets: [m], (k, 3).
        pin_stiffness: [N/m], ().
        stitch_stiffness: [N/m], ().
        body_vertices: [m], (b, 3).
        barrier_stiffness: contact pressure scale [Pa], ().
        friction_coefficient: Coulomb's mu, ().
        strain_limit: a limit on the stretch of the triangles; None for none.
    """

    rest_positions: Float[Array, "p 2"]
    density: Float[Array, ""] | Float[Array, " f"]
    stretching_stiffness: Float[Array, ""] | Float[Array, " f"]
    poisson_ratio: Float[Array, ""] | Float[Array, " f"]
    warp_stiffness: Float[Array, ""] | Float[Array, " f"]
    weft_stiffness: Float[Array, ""] | Float[Array, " f"]
    shear_stiffness: Float[Array, ""] | Float[Array, " f"]
    grain_angle: Float[Array, ""] | Float[Array, " f"]
    bending_stiffness: Float[Array, ""] | Float[Array, " h"]
    bending_anisotropy: Float[Array, ""] | Float[Array, " f"]
    gravity: Float[Array, "3"]
    pin_targets: Float[Array, "k 3"]
    pin_stiffness: Float[Array, ""]
    stitch_stiffness: Float[Array, ""]
    body_vertices: Float[Array, "b 3"]
    barrier_stiffness: Float[Array, ""]
    friction_coefficient: Float[Array, ""]
    strain_limit: StrainLimit | None = None


# Each membrane takes its own of them; whoever makes a cloth stiffer scales all.
STRETCHING_LEAVES = (
    "stretching_stiffness",
    "warp_stiffness",
    "weft_stiffness",
    "shear_stiffness",
)
# Values of hinges; all others that vary belong to triangles.
HINGE_LEAVES = ("bending_stiffness",)


class Gravity(enum.Enum):
    """Named gravity vectors."""

    DOWN = (0.0, -9.81, 0.0)
    NONE = (0.0, 0.0, 0.0)


def make_cloth(
    faces: Int[np.ndarray, "f 3"],
    rest_faces: Int[np.ndarray, "f 3"] | None = None,
    *,
    rest_positions: Float[np.ndarray, "p 2"] | None = None,
    vertex_count: int | None = None,
    pins: Int[np.ndarray, " k"] | None = None,
    stitches: Int[np.ndarray, "s 2"] | None = None,
    membrane: MembraneModel = MembraneModel.ARAP,
    panels: FacePanels | None = None,
) -> Cloth:
    """Build the index arrays of a garment mesh.

    Args:
        faces: vertices of the (welded) triangles.
        rest_faces: panel vertices of the same triangles; default the same indices.
        rest_positions: panel coordinates [m]; where given, long edges that are sewn to short ones
            are gathered (see `gathers`).
        vertex_count: number of vertices; default the largest index plus one.
        pins: vertices to hold.
        stitches: pairs of vertices to pull together.
        panels: of the triangles, for messages.

    Raises:
        InputError: the mesh is not manifold or its index arrays disagree; the message names
            triangle and edge, and the panel where it is known.
    """
    faces = np.asarray(faces, np.int32)
    rest_faces = faces if rest_faces is None else np.asarray(rest_faces, np.int32)
    if faces.shape != rest_faces.shape:
        raise InputError(f"{len(faces)} triangles but {len(rest_faces)} rest triangles")
    count = int(faces.max()) + 1 if vertex_count is None else vertex_count
    check_faces(faces, count, panels)
    hinges = find_hinges(faces)
    pins = np.zeros(0, np.int32) if pins is None else np.asarray(pins, np.int32)
    stitches = np.zeros((0, 2), np.int32) if stitches is None else np.asarray(stitches, np.int32)
    check_indices("pins", pins, count)
    check_indices("stitches", stitches.ravel(), count)

    def columns(rows: np.ndarray) -> Array:
        return jnp.asarray(np.ascontiguousarray(rows.T), jnp.int32)

    return Cloth(
        faces=columns(faces),
        rest_faces=columns(rest_faces),
        hinges=columns(hinges.vertices),
        hinge_faces=columns(hinges.faces),
        hinge_corners=columns(hinges.local_corner),
        pins=jnp.asarray(pins),
        stitches=columns(stitches),
        gathers=no_gathers()
        if rest_positions is None
        else find_gathers(faces, rest_faces, rest_positions),
        vertex_count=count,
        membrane=membrane,
    )


def vertex_masses(parameters: Parameters, cloth: Cloth) -> Float[Array, " n"]:
    """Lumped masses [kg] (S1.4); their sum is density times area."""
    areas = rest_triangles(parameters.rest_positions, cloth.rest_faces).areas
    return vertex_areas(parameters.density * areas, cloth.faces, cloth.vertex_count)
