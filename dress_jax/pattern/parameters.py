"""What of a pattern can be optimised: corner positions and control points, as one pytree.

Every edge is a curve with free controls: a line is a quadratic whose control sits at the middle of
its chord (checklist S3.6), a cubic keeps two controls, an arc keeps the height of its apex and
stays an exact arc. Controls are relative to the chord (S21.7). Checklist S3.3, S3.8.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.core.errors import InputError
from dress_jax.core.precision import require_float64
from dress_jax.core.pytree import pytree
from dress_jax.geometry.curves import elevate, relative_lengths
from dress_jax.pattern.model import Edge, EdgeKind, Pattern

_CHORD_MIDPOINT = np.array([[0.5, 0.0]])


@pytree
class PatternParameters:
    """The differentiable unknowns of a pattern.

    Args:
        vertices: corners of all panels in turn, in panel coordinates [m], shape (V, 2).
        controls: control points of all edges in turn [chord lengths], shape (K, 2): one row for a
            line, a quadratic or an arc, two for a cubic. Of an arc's row only the second number
            (signed height of the apex) has an effect.
    """

    vertices: Float[Array, "V 2"]
    controls: Float[Array, "K 2"]


@pytree
class EdgeTable:
    """Where each edge finds its corners and controls; edges are numbered panel by panel.

    Args:
        vertices: rows of `PatternParameters.vertices`: start and end, shape (E, 2).
        controls: rows of `PatternParameters.controls`: first and last, shape (E, 2).
        kind: `EdgeKind` values, shape (E,).
        panel: panel of each edge, shape (E,).
    """

    vertices: Int[np.ndarray, "E 2"]
    controls: Int[np.ndarray, "E 2"]
    kind: Int[np.ndarray, "E"]
    panel: Int[np.ndarray, "E"]


def edge_table(pattern: Pattern) -> EdgeTable:
    """Number a pattern's corners, controls and edges (host)."""
    vertices, controls, kinds, panels = [], [], [], []
    vertex_base = control_base = 0
    for number, panel in enumerate(pattern.panels):
        for edge in panel.edges:
            rows = max(edge.kind.control_count, 1)
            vertices.append((vertex_base + edge.start, vertex_base + edge.end))
            controls.append((control_base, control_base + rows - 1))
            kinds.append(int(edge.kind))
            panels.append(number)
            control_base += rows
        vertex_base += len(panel.vertices)
    return EdgeTable(
        vertices=np.array(vertices, dtype=np.int32).reshape(-1, 2),
        controls=np.array(controls, dtype=np.int32).reshape(-1, 2),
        kind=np.array(kinds, dtype=np.int32),
        panel=np.array(panels, dtype=np.int32),
    )


def pattern_parameters(pattern: Pattern) -> PatternParameters:
    """The parameters of a pattern as it stands.

    Raises:
        RuntimeError: 64-bit arrays are off.
    """
    require_float64("pattern_parameters")
    controls = [
        _CHORD_MIDPOINT if edge.kind == EdgeKind.LINE else edge.controls
        for panel in pattern.panels
        for edge in panel.edges
    ]
    return PatternParameters(
        vertices=jnp.asarray(np.concatenate([panel.vertices for panel in pattern.panels])),
        controls=jnp.asarray(np.concatenate(controls)),
    )


def with_parameters(pattern: Pattern, parameters: PatternParameters) -> Pattern:
    """The pattern with optimised corners and controls (host).

    A line whose control left the middle of the chord becomes a quadratic. The result is not
    validated; `validation.validate` or `discretize` does that.

    Args:
        pattern: the pattern that the parameters came from.
        parameters: new values of the same shapes.

    Raises:
        InputError: the shapes do not fit, or a number is not finite.
    """
    vertices = np.asarray(parameters.vertices, dtype=float)
    controls = np.asarray(parameters.controls, dtype=float)
    table = edge_table(pattern)
    expected = sum(len(panel.vertices) for panel in pattern.panels)
    if vertices.shape != (expected, 2) or controls.shape != (table.controls[-1, 1] + 1, 2):
        raise InputError(
            f"parameters of shapes {vertices.shape} and {controls.shape} do not fit the pattern",
            where=pattern.source,
            mend=f"{(expected, 2)} and {(int(table.controls[-1, 1]) + 1, 2)} are expected",
        )
    if not (np.isfinite(vertices).all() and np.isfinite(controls).all()):
        raise InputError("a parameter is not finite", where=pattern.source)
    panels, vertex_base, number = [], 0, 0
    for panel in pattern.panels:
        edges = []
        for edge in panel.edges:
            first, last = table.controls[number]
            edges.append(_with_controls(edge, controls[first : last + 1]))
            number += 1
        corners = vertices[vertex_base : vertex_base + len(panel.vertices)].copy()
        panels.append(dataclasses.replace(panel, vertices=corners, edges=tuple(edges)))
        vertex_base += len(panel.vertices)
    return dataclasses.replace(pattern, panels=tuple(panels))


def _with_controls(edge: Edge, controls: np.ndarray) -> Edge:
    if edge.kind == EdgeKind.LINE:
        if np.array_equal(controls, _CHORD_MIDPOINT):
            return edge
        return dataclasses.replace(edge, kind=EdgeKind.QUADRATIC, controls=controls.copy())
    return dataclasses.replace(edge, controls=controls.copy())


def edge_controls(
    parameters: PatternParameters, edges: EdgeTable
) -> tuple[Float[Array, "E 2"], Float[Array, "E 2"]]:
    """Every edge's controls as `geometry.curves` takes them: cubic, or an arc's apex in the first.

    Returns:
        First and second control [chord lengths], each of shape (E, 2).
    """
    kind = jnp.asarray(edges.kind)
    own_first = parameters.controls[edges.controls[:, 0]]
    own_second = parameters.controls[edges.controls[:, 1]]
    first, second = elevate(own_first)
    elevated = ((kind == int(EdgeKind.LINE)) | (kind == int(EdgeKind.QUADRATIC)))[:, None]
    return jnp.where(elevated, first, own_first), jnp.where(elevated, second, own_second)


def edge_lengths(parameters: PatternParameters, edges: EdgeTable) -> Float[Array, "E"]:
    """Arc length of every edge, differentiable (checklist S11.7).

    Args:
        parameters: the pattern's parameters.
        edges: its edge table.

    Returns:
        Lengths [m], shape (E,), to 1e-9 relative for smooth curves.
    """
    first, second = edge_controls(parameters, edges)
    arc = jnp.asarray(edges.kind) == int(EdgeKind.ARC)
    start = parameters.vertices[edges.vertices[:, 0]]
    end = parameters.vertices[edges.vertices[:, 1]]
    chord = jnp.sqrt(jnp.sum((end - start) ** 2, axis=1))
    return chord * relative_lengths(arc, first, second)
