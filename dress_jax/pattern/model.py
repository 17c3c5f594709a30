"""The pattern object on the host: panels, edges and stitches as frozen dataclasses.

Lengths are metres. Curve controls are in the frame of their edge's chord (`geometry.curves`), so a
control keeps its place relative to the edge when the endpoints move (checklist S21.7). Checklist
S3.2, S3.3, S3.7.
"""

import dataclasses
import enum
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float


class EdgeKind(enum.IntEnum):
    """The shape of an edge; its value is the number stored in `EdgeTable.kind`."""

    LINE = 0
    QUADRATIC = 1
    CUBIC = 2
    ARC = 3

    @property
    def control_count(self) -> int:
        """Control points that `Edge.controls` holds."""
        return (0, 1, 2, 1)[self.value]


@dataclasses.dataclass(frozen=True, eq=False)
class Edge:
    """One edge of a panel's loop.

    Args:
        kind: the curve's shape.
        start, end: indices of the endpoints in `Panel.vertices`.
        controls: control points [chord lengths], shape (0 | 1 | 2, 2). An arc has one row
            (0.5, height): the arc's apex, its height signed towards the chord's left.
        label: name of an interface such as `lower_interface`, or "".
        extras: keys of the file that this package does not know.
    """

    kind: EdgeKind
    start: int
    end: int
    controls: Float[np.ndarray, "k 2"]
    label: str = ""
    extras: Mapping[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True, eq=False)
class Panel:
    """One piece of cloth: a closed loop of edges and its placement in the world.

    Args:
        name: unique in the pattern.
        vertices: corners in panel coordinates, y up [m], shape (n, 2).
        edges: the loop in order; each edge starts where the one before it ends. The loop's
            direction sets the outward normal: counter-clockwise means panel +z.
        rotation: panel to world, shape (3, 3).
        translation: panel to world [m], shape (3,).
        label: part of the body (`body`, `arm`, `leg`), or "".
        extras: keys of the file that this package does not know.
    """

    name: str
    vertices: Float[np.ndarray, "n 2"]
    edges: tuple[Edge, ...]
    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, "3"]
    label: str = ""
    extras: Mapping[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Side:
    """One side of a stitch: a panel's name and the index of an edge in its loop."""

    panel: str
    edge: int
    extras: Mapping[str, Any] = dataclasses.field(default_factory=dict, compare=False)


@dataclasses.dataclass(frozen=True)
class Stitch:
    """Two edges sewn together over their whole lengths.

    Args:
        first, second: the two sides.
        reversed: True pairs the start of one edge with the end of the other, which is what two
            outlines with the same sense of direction need; False (`right_wrong` in files) pairs
            start with start.
        extras: options of the file that this package does not know.
    """

    first: Side
    second: Side
    reversed: bool = True
    extras: tuple[Any, ...] = ()


@dataclasses.dataclass(frozen=True)
class Dialect:
    """How a file writes a pattern; kept so that it is written back the way it was read.

    Args:
        units_in_meter: file units in one metre (100 for centimetres).
        absolute_curvature: controls are in panel coordinates instead of the edge's frame.
        bare_curvature: quadratic controls are bare lists instead of typed dictionaries.
        euler: order of the rotation angles: "zyx" is Rz Ry Rx, "xyz" is Rx Ry Rz.
        centred_translation: translations refer to the mean of a panel's vertices.
    """

    units_in_meter: float = 100.0
    absolute_curvature: bool = False
    bare_curvature: bool = False
    euler: str = "zyx"
    centred_translation: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class Pattern:
    """A sewing pattern.

    Args:
        panels: in the file's order, which numbers panels everywhere.
        stitches: in the file's order.
        source: name for error messages, such as the file's name.
        dialect: how the file writes numbers.
        extras: the document without its panels and stitches (parameters, properties, unknown
            keys).
    """

    panels: tuple[Panel, ...]
    stitches: tuple[Stitch, ...] = ()
    source: str = ""
    dialect: Dialect = Dialect()
    extras: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def panel(self, name: str) -> Panel:
        """The panel of that name.

        Raises:
            KeyError: there is none.
        """
        for panel in self.panels:
            if panel.name == name:
                return panel
        raise KeyError(name)


def line(start: int, end: int, *, label: str = "") -> Edge:
    """A straight edge."""
    return Edge(EdgeKind.LINE, start, end, np.zeros((0, 2)), label)


def quadratic(start: int, end: int, control: tuple[float, float], *, label: str = "") -> Edge:
    """A quadratic Bézier edge; `control` in chord lengths."""
    return Edge(EdgeKind.QUADRATIC, start, end, np.array([control], dtype=float), label)


def cubic(
    start: int,
    end: int,
    first: tuple[float, float],
    second: tuple[float, float],
    *,
    label: str = "",
) -> Edge:
    """A cubic Bézier edge; both controls in chord lengths."""
    return Edge(EdgeKind.CUBIC, start, end, np.array([first, second], dtype=float), label)


def arc(start: int, end: int, height: float, *, label: str = "") -> Edge:
    """A circular arc; `height` of its apex in chord lengths, positive to the chord's left."""
    return Edge(EdgeKind.ARC, start, end, np.array([[0.5, height]]), label)
