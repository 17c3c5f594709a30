"""The frozen discretization of a pattern, and rest positions as a function of its parameters.

`build.discretize` makes one. Checklist S5.2, S5.5, S5.6, S5.7, S8.3.
"""

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Bool, Float, Int
from scipy.sparse.csgraph import connected_components

from dress_jax.core.precision import require_float64
from dress_jax.core.pytree import pytree, static
from dress_jax.geometry.curves import curve_point, from_chord_frame
from dress_jax.pattern.model import EdgeKind
from dress_jax.pattern.parameters import EdgeTable, PatternParameters, edge_controls


@pytree
class Discretization:
    """Everything about a pattern's mesh that stays fixed while its parameters move.

    Panel vertices are numbered panel by panel, each panel's outline first (in loop order, edge by
    edge, without each edge's end), its inner vertices after. Edges are numbered panel by panel.

    Args:
        edges: corners, controls, kind and panel of every pattern edge.
        sample_edge: edge of each outline vertex, panels in turn, shape (B,).
        sample_t: its curve parameter, uniform in arc length, shape (B,).
        harmonic: per panel the weights from outline to inner vertices, shape (inner, outline).
        rest_faces: triangles in panel vertices, shape (F, 3). They turn so that the sewn surface
            has one outer side, so in panel coordinates they are clockwise, with negative signed
            area, in panels whose `orientation` is -1.
        face_panel: panel of each triangle, shape (F,).
        panel_of_vertex: panel of each panel vertex, shape (P,).
        panel_offset: first panel vertex of each panel, and P, shape (panels + 1,).
        seam_vertices: pairs of panel vertices to be sewn, stitches in turn, shape (S, 2). Pairs of
            a vertex with itself (the tip of a dart) are left out.
        seam_offset: first pair of each stitch, and S, shape (stitches + 1,).
        stitch_edges: the two edges of each stitch, shape (stitches, 2).
        weld_map: welded vertex of each panel vertex, 0 to N - 1, shape (P,).
        faces: `weld_map[rest_faces]`, shape (F, 3).
        edge_samples: panel vertices along every edge, ends included, concatenated, shape (Q,).
        edge_sample_offset: first entry of each edge in `edge_samples`, and Q, shape (E + 1,).
        edge_offset: first edge of each panel, and E, shape (panels + 1,).
        orientation: +1 where a panel's triangles are counter-clockwise in panel coordinates, -1
            where they are clockwise, shape (panels,). They follow the loop, except for panels that
            `right_wrong` stitches turn around (`orientation.consistent_signs`).
        seam_consistent: whether the triangles on the two sides of a stitch turn the same way;
            False only in one-sided garments, shape (stitches,).
        rotation: panel to world, shape (panels, 3, 3).
        translation: panel to world [m], shape (panels, 3).
        meshed_positions: panel vertices as they were meshed [m], shape (P, 2).
        vertex_count: N.
        edge_length: the wanted edge length [m].
        panel_names: names in order.
    """

    edges: EdgeTable
    sample_edge: Int[np.ndarray, "B"]
    sample_t: Float[np.ndarray, "B"]
    harmonic: tuple[Float[np.ndarray, "inner outline"], ...]
    rest_faces: Int[np.ndarray, "F 3"]
    face_panel: Int[np.ndarray, "F"]
    panel_of_vertex: Int[np.ndarray, "P"]
    panel_offset: Int[np.ndarray, "panels_plus_1"]
    seam_vertices: Int[np.ndarray, "S 2"]
    seam_offset: Int[np.ndarray, "stitches_plus_1"]
    stitch_edges: Int[np.ndarray, "stitches 2"]
    weld_map: Int[np.ndarray, "P"]
    faces: Int[np.ndarray, "F 3"]
    edge_samples: Int[np.ndarray, "Q"]
    edge_sample_offset: Int[np.ndarray, "E_plus_1"]
    edge_offset: Int[np.ndarray, "panels_plus_1"]
    orientation: Int[np.ndarray, "panels"]
    seam_consistent: Bool[np.ndarray, "stitches"]
    rotation: Float[np.ndarray, "panels 3 3"]
    translation: Float[np.ndarray, "panels 3"]
    meshed_positions: Float[np.ndarray, "P 2"]
    vertex_count: int = static()
    edge_length: float = static()
    panel_names: tuple[str, ...] = static()

    @property
    def panel_count(self) -> int:
        """Number of panels."""
        return len(self.panel_names)


def samples_of_edge(
    discretization: Discretization, panel: int, edge: int
) -> Int[np.ndarray, "count_plus_1"]:
    """Panel vertices along one edge from start to end (host), shape (segments + 1,)."""
    number = int(discretization.edge_offset[panel]) + edge
    start, stop = discretization.edge_sample_offset[number : number + 2]
    return np.asarray(discretization.edge_samples[start:stop])


def outline_positions(
    parameters: PatternParameters, discretization: Discretization
) -> Float[Array, "B 2"]:
    """Outline vertices of all panels in turn [m], shape (B, 2): curves at the frozen t (S5.2)."""
    edges = discretization.edges
    first, second = edge_controls(parameters, edges)
    arc = jnp.asarray(edges.kind) == int(EdgeKind.ARC)
    start = parameters.vertices[edges.vertices[:, 0]]
    end = parameters.vertices[edges.vertices[:, 1]]
    owner = discretization.sample_edge
    t = jnp.asarray(discretization.sample_t)
    local = curve_point(arc[owner], first[owner], second[owner], t)
    return from_chord_frame(start[owner], end[owner], local)


def rest_positions(
    parameters: PatternParameters, discretization: Discretization
) -> Float[Array, "P 2"]:
    """Panel vertices in panel coordinates, differentiable in the parameters (S5.5, S5.7).

    V_B = curves at t, V_I = H V_B, with t and H frozen (S5.6).

    Args:
        parameters: the pattern's parameters.
        discretization: made from the same pattern; pass it as an argument of jitted functions, so
            that its tables are not captured as constants, and `jax.device_put` it once where
            copying the weights at every call would cost.

    Returns:
        Positions [m], shape (P, 2).

    Raises:
        RuntimeError: 64-bit arrays are off.
    """
    require_float64("rest_positions")
    return _rest_positions(parameters, discretization)


@jax.jit
def _rest_positions(
    parameters: PatternParameters, discretization: Discretization
) -> Float[Array, "P 2"]:
    outline = outline_positions(parameters, discretization)
    parts, start = [], 0
    for weights in discretization.harmonic:
        count = weights.shape[1]
        own = outline[start : start + count]
        parts.append(own)
        if weights.shape[0]:
            parts.append(jnp.asarray(weights) @ own)
        start += count
    return jnp.concatenate(parts)


def placed_positions(
    rest: Float[Array, "P 2"], discretization: Discretization
) -> Float[Array, "P 3"]:
    """Panel vertices at their panels' places in the world: R (x, y, 0) + translation.

    Args:
        rest: panel coordinates [m], shape (P, 2).
        discretization: holds the placements.

    Returns:
        World positions [m], shape (P, 3).
    """
    owner = discretization.panel_of_vertex
    rotation = jnp.asarray(discretization.rotation)[owner]
    translation = jnp.asarray(discretization.translation)[owner]
    return rotation[:, :, 0] * rest[:, 0:1] + rotation[:, :, 1] * rest[:, 1:2] + translation


def components(discretization: Discretization) -> Int[np.ndarray, "panels"]:
    """Connected components of panels through seams (host; S8.3).

    Returns:
        Component of each panel, numbered from 0 in order of first appearance, shape (panels,).
    """
    count = discretization.panel_count
    owner = np.asarray(discretization.edges.panel)[np.asarray(discretization.stitch_edges)]
    links = scipy.sparse.coo_matrix(
        (np.ones(len(owner)), (owner[:, 0], owner[:, 1])), shape=(count, count)
    )
    _, label = connected_components(links, directed=False)
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[inverse]
