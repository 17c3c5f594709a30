"""Design rules: what a pattern must keep to while something else changes it.

A rule measures how far a pattern is from it, differentiably, in metres or radians: its gaps are
zero, or with `at_least` not negative. Rules compare and hash by value, so that compiled functions
of them are found again. A rule of one's own is `OwnRule`, or any frozen dataclass with these three
members.
"""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from dress_jax.core.errors import InputError
from dress_jax.geometry.curves import end_directions
from dress_jax.pattern.model import EdgeKind, Pattern
from dress_jax.pattern.parameters import (
    EdgeTable,
    PatternParameters,
    edge_controls,
    edge_lengths,
    edge_table,
    pattern_parameters,
)

TOLERANCE = 1e-5
"""Gap up to which a rule holds [m or rad]."""


class Rule(Protocol):
    """What every rule has."""

    @property
    def name(self) -> str:
        """For messages and reports."""
        ...

    @property
    def at_least(self) -> bool:
        """Whether gaps may be positive."""
        ...

    def gap(self, parameters: PatternParameters, edges: EdgeTable) -> Float[Array, " m"]:
        """How far the pattern is from the rule [m or rad]."""
        ...


@dataclasses.dataclass(frozen=True)
class FixedEdge:
    """An edge keeps its chord's length and its curve.

    Attributes:
        name: for messages.
        corners: rows of its ends.
        rows: of its control points.
        chord: length of its chord [m].
        controls: its control points [chord lengths].
    """

    name: str
    corners: tuple[int, int]
    rows: tuple[int, ...]
    chord: float
    controls: tuple[tuple[float, float], ...]
    at_least: bool = False

    def gap(self, parameters: PatternParameters, edges: EdgeTable) -> Float[Array, " m"]:
        """Change of the chord, and of the controls in metres."""
        start, end = parameters.vertices[np.array(self.corners)]
        controls = parameters.controls[np.array(self.rows)] - jnp.asarray(self.controls)
        chord = jnp.sqrt(jnp.sum((end - start) ** 2)) - self.chord
        return jnp.concatenate([chord[None], self.chord * controls.ravel()])


@dataclasses.dataclass(frozen=True)
class EqualLengths:
    """Edges are equally long.

    Attributes:
        name: for messages.
        edges: their numbers in the pattern.
    """

    name: str
    edges: tuple[int, ...]
    at_least: bool = False

    def gap(self, parameters: PatternParameters, edges: EdgeTable) -> Float[Array, " m"]:
        """Length of each but the first, minus that of the first."""
        lengths = edge_lengths(parameters, edges)[np.array(self.edges)]
        return lengths[1:] - lengths[0]


@dataclasses.dataclass(frozen=True)
class MinimumLength:
    """An edge is at least so long.

    Attributes:
        name: for messages.
        edge: number in the pattern.
        length: [m].
    """

    name: str
    edge: int
    length: float
    at_least: bool = True

    def gap(self, parameters: PatternParameters, edges: EdgeTable) -> Float[Array, " m"]:
        """Length beyond the least."""
        return edge_lengths(parameters, edges)[self.edge][None] - self.length


@dataclasses.dataclass(frozen=True)
class MinimumWidth:
    """The corners of a panel span at least so much along its x axis.

    Attributes:
        name: for messages.
        corners: first corner of the panel, and the one after its last.
        width: [m].
    """

    name: str
    corners: tuple[int, int]
    width: float
    at_least: bool = True

    def gap(self, parameters: PatternParameters, edges: EdgeTable) -> Float[Array, " m"]:
        """Width beyond the least."""
        x = parameters.vertices[self.corners[0] : self.corners[1], 0]
        return (jnp.max(x) - jnp.min(x))[None] - self.width


@dataclasses.dataclass(frozen=True)
class RightAngle:
    """Two edges meet at a right angle, as a side seam and a hem do so that hems run on smoothly.

    Attributes:
        name: for messages.
        arriving, leaving: numbers in the pattern of the edges that end and start at the corner.
    """

    name: str
    arriving: int
    leaving: int
    at_least: bool = False

    def gap(self, parameters: PatternParameters, edges: EdgeTable) -> Float[Array, " m"]:
        """Cosine of the angle."""
        pair = np.array([self.arriving, self.leaving])
        first, second = (own[pair] for own in edge_controls(parameters, edges))
        arc = jnp.asarray(edges.kind)[pair] == int(EdgeKind.ARC)
        ends = parameters.vertices[jnp.asarray(edges.vertices)[pair]]
        chords = ends[:, 1] - ends[:, 0]
        leave, reach = end_directions(arc, first, second)
        one, other = _turned(reach[0], chords[0]), _turned(leave[1], chords[1])
        product = jnp.sum(one * other)
        return (product / jnp.sqrt(jnp.sum(one**2) * jnp.sum(other**2)))[None]


@dataclasses.dataclass(frozen=True)
class OwnRule:
    """A rule by the user's own function.

    Attributes:
        name: for messages; fits with other functions need other names to be told apart.
        function: gaps of parameters and edge table, (m,), differentiable.
        at_least: whether gaps may be positive.
    """

    name: str
    function: Callable[[PatternParameters, EdgeTable], Float[Array, " m"]]
    at_least: bool = False

    def gap(self, parameters: PatternParameters, edges: EdgeTable) -> Float[Array, " m"]:
        """The function's value."""
        return jnp.atleast_1d(self.function(parameters, edges))


def fixed_edge(pattern: Pattern, panel: str, edge: int) -> FixedEdge:
    """An edge that keeps the shape that it has in a pattern.

    Raises:
        InputError: there is no such edge; likewise in all of the following.
    """
    number = _edge(pattern, panel, edge)
    table, start = edge_table(pattern), pattern_parameters(pattern)
    first, second = table.vertices[number].tolist()
    way = np.asarray(start.vertices)[second] - np.asarray(start.vertices)[first]
    rows = tuple(range(int(table.controls[number, 0]), int(table.controls[number, 1]) + 1))
    controls = np.asarray(start.controls)[list(rows)]
    return FixedEdge(
        f"fixed edge {edge} of {panel!r}",
        (first, second),
        rows,
        float(np.linalg.norm(way)),
        tuple((float(x), float(y)) for x, y in controls),
    )


def equal_lengths(pattern: Pattern, edges: Sequence[tuple[str, int]]) -> EqualLengths:
    """Edges that are equally long, given as panel and number."""
    if len(edges) < 2:
        raise InputError("equal lengths need at least two edges", where="design rules")
    names = ", ".join(f"{edge} of {panel!r}" for panel, edge in edges)
    return EqualLengths(
        f"equal lengths of edges {names}", tuple(_edge(pattern, *one) for one in edges)
    )


def minimum_length(pattern: Pattern, panel: str, edge: int, length: float) -> MinimumLength:
    """An edge that is at least so long [m]."""
    name = f"edge {edge} of {panel!r} at least {100.0 * length:g} cm"
    return MinimumLength(name, _edge(pattern, panel, edge), _positive(length, name))


def minimum_width(pattern: Pattern, panel: str, width: float) -> MinimumWidth:
    """A panel that is at least so wide [m]."""
    name = f"panel {panel!r} at least {100.0 * width:g} cm wide"
    number = _panel(pattern, panel)
    first = sum(len(p.vertices) for p in pattern.panels[:number])
    corners = (first, first + len(pattern.panels[number].vertices))
    return MinimumWidth(name, corners, _positive(width, name))


def right_angle(pattern: Pattern, panel: str, edge: int) -> RightAngle:
    """A right angle where an edge starts."""
    leaving = _edge(pattern, panel, edge)
    count = len(pattern.panels[_panel(pattern, panel)].edges)
    arriving = leaving - 1 if edge else leaving + count - 1
    return RightAngle(f"right angle at the start of edge {edge} of {panel!r}", arriving, leaving)


def gaps(
    rules: Sequence[Rule], parameters: PatternParameters, edges: EdgeTable
) -> Float[Array, " m"]:
    """The gaps of all rules in turn."""
    own = [jnp.zeros(0), *(rule.gap(parameters, edges) for rule in rules)]
    return jnp.concatenate(own)


def parse_rules(document: Mapping[str, Any], pattern: Pattern, *, where: str) -> tuple[Rule, ...]:
    """Rules of a document, `{"rules": [{"rule": "right-angle", "panel": "front", "edge": 1}]}`.

    Kinds and their keys: `fixed` (panel, edge), `equal` (edges: [panel, edge] pairs), `right-angle`
    (panel, edge, at the edge's start), `minimum-length` (panel, edge, length_cm), `minimum-width`
    (panel, width_cm).

    Args:
        document: as read from a JSON file.
        pattern: that the rules are about.
        where: the document's name, for messages.

    Raises:
        InputError: names the rule and what is wrong with it.
    """
    listed = document.get("rules")
    if not isinstance(listed, list):
        raise InputError("has no list 'rules'", where=where, mend='write {"rules": [...]}')
    return tuple(
        _parsed(entry, pattern, f"{where}, rule {number}") for number, entry in enumerate(listed)
    )


def _parsed(entry: Any, pattern: Pattern, where: str) -> Rule:
    makers: dict[str, tuple[Callable[..., Rule], tuple[str, ...]]] = {
        "fixed": (fixed_edge, ("panel", "edge")),
        "equal": (equal_lengths, ("edges",)),
        "right-angle": (right_angle, ("panel", "edge")),
        "minimum-length": (minimum_length, ("panel", "edge", "length_cm")),
        "minimum-width": (minimum_width, ("panel", "width_cm")),
    }
    kind = entry.get("rule") if isinstance(entry, dict) else None
    if kind not in makers:
        raise InputError(
            f"{kind!r} is no rule", where=where, mend=f"give 'rule' as one of {sorted(makers)}"
        )
    maker, keys = makers[kind]
    wrong = sorted(set(entry) ^ {"rule", *keys})
    if wrong:
        raise InputError(
            f"{kind!r} has keys missing or too many: {wrong}",
            where=where,
            mend=f"its keys are {list(keys)}",
        )
    try:
        return maker(pattern, *(_value(entry[key], key) for key in keys))
    except InputError as error:
        raise InputError(error.problem, where=f"{where}: {error.where}", mend=error.mend) from error


def _value(value: Any, key: str) -> Any:
    """An entry's value in the units of the functions above."""
    if key.endswith("_cm"):
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(f"{value!r} is no number", where=key)
        return 0.01 * value
    if key == "edges":
        pairs = value if isinstance(value, list) else [value]
        if not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs):
            raise InputError(f"{value!r} is no list of [panel, edge]", where=key)
        return [tuple(pair) for pair in pairs]
    return value


def _panel(pattern: Pattern, panel: str) -> int:
    names = [p.name for p in pattern.panels]
    if panel not in names:
        raise InputError(
            f"there is no panel {panel!r}", where="design rules", mend=f"panels: {sorted(names)}"
        )
    return names.index(panel)


def _edge(pattern: Pattern, panel: str, edge: int) -> int:
    """Number of an edge in the pattern."""
    number = _panel(pattern, panel)
    counts = [len(p.edges) for p in pattern.panels]
    if isinstance(edge, bool) or not isinstance(edge, int) or not 0 <= edge < counts[number]:
        raise InputError(
            f"panel {panel!r} has no edge {edge!r}",
            where="design rules",
            mend=f"its edges are 0 to {counts[number] - 1}",
        )
    return [0, *itertools.accumulate(counts)][number] + edge


def _positive(value: float, name: str) -> float:
    if not (np.isfinite(value) and value > 0.0):
        raise InputError(f"{value} is no positive length", where=name)
    return float(value)


def _turned(local: Array, chord: Array) -> Array:
    """A direction in a chord's frame in panel coordinates."""
    return local[0] * chord + local[1] * jnp.stack([-chord[1], chord[0]])
