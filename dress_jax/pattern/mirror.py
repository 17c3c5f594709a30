"""Which panels and edges of a placed pattern mirror each other (host; checklist S3.5, S4.1, S4.2).

Names say little: files name panels freely. The placements around the body say it: a mirrored panel
lies on its partner. The mirror plane is found with the pairs; it need not be x = 0.
"""

import dataclasses
import re
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from dress_jax.geometry.polygons import signed_area
from dress_jax.pattern.model import EdgeKind, Panel, Pattern
from dress_jax.pattern.outline import edge_points

SHAPE_TOLERANCE = 0.06
"""Largest distance between a panel and its mirrored partner, rms along the outline, over the root
of the area."""

_EXACT_TOLERANCE = 0.01
_SPREAD = 5.0
"""A constructed pattern mirrors exactly, and a panel that is off by more than `_EXACT_TOLERANCE` is
so by design; a predicted one carries noise in every panel. So panels also have to mirror at most
`_SPREAD` times worse than the median one."""

_PLACE_TOLERANCE = 0.5  # between a mirrored panel's middle and its partner's, over the same root
_VERTICAL = np.radians(5.0)  # an axis of symmetry closer to the panel's y axis is that axis
_OFF_CENTRE = 0.25  # between the plane and the middle of the garment, over the garment's width
_PER_EDGE = 4
_WINDOW = 0.02  # [m]; planes closer together are one candidate
_CANDIDATES = 8
_NAMED_BONUS = 0.02  # what left and right in two names are worth, in the unit of SHAPE_TOLERANCE


@dataclasses.dataclass(frozen=True, eq=False)
class MirrorPair:
    """Two panels that mirror each other, or one that mirrors itself.

    Attributes:
        first, second: numbers of the panels; equal for a panel with itself.
        edges: the edge of the second that mirrors each edge of the first, shape (n,).
        reversed: whether mirrored edges run against each other.
        reflection: from the first's coordinates to the second's, shape (2, 2); diag(-1, 1) where
            the axis of symmetry is vertical.
        distance: see `SHAPE_TOLERANCE`.
    """

    first: int
    second: int
    edges: Int[np.ndarray, " n"]
    reversed: bool
    reflection: Float[np.ndarray, "2 2"]
    distance: float


@dataclasses.dataclass(frozen=True, eq=False)
class Mirror:
    """The symmetry of a pattern.

    Attributes:
        normal: unit normal of the mirror plane, shape (3,).
        offset: the plane is normal . x = offset [m].
        pairs: what mirrors each other; panels without a partner are in none.
    """

    normal: Float[np.ndarray, "3"]
    offset: float
    pairs: tuple[MirrorPair, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class _Outline:
    """A panel as samples, `_PER_EDGE` on every edge from its start on."""

    flat: Float[np.ndarray, "n k 2"]
    placed: Float[np.ndarray, "n k 3"]
    weights: Float[np.ndarray, " n"]
    arcs: Bool[np.ndarray, " n"]
    cubics: Bool[np.ndarray, " n"]
    turn: int
    size: float

    @property
    def middle(self) -> Float[np.ndarray, "3"]:
        """Mean of the placed outline [m]."""
        return np.average(self.placed.mean(axis=1), axis=0, weights=self.weights)


def find_mirror(pattern: Pattern, *, tolerance: float = SHAPE_TOLERANCE) -> Mirror:
    """The mirror plane of a pattern's placement, and the panels and edges that are pairs.

    Args:
        pattern: with its panels placed around the body.
        tolerance: see `SHAPE_TOLERANCE`.

    Returns:
        The plane and the pairs. A pattern without symmetry has no pairs.
    """
    outlines = [_outline(panel) for panel in pattern.panels]
    names = [panel.name for panel in pattern.panels]
    normal = np.array([1.0, 0.0, 0.0])
    best: tuple[float, float, tuple[MirrorPair, ...]] = (-1.0, 0.0, ())
    for offset in _offsets(outlines, normal, tolerance):
        pairs = _pairs(outlines, names, normal, offset, tolerance)
        matched = sum(_matched_area(pair, outlines, tolerance) for pair in pairs)
        if matched > best[0]:
            best = (matched, offset, pairs)
    _, offset, pairs = best
    if pairs:
        normal, offset = _refined(outlines, pairs, normal)
        pairs = _pairs(outlines, names, normal, offset, tolerance)
    usual = float(np.median([pair.distance for pair in pairs])) if pairs else 0.0
    limit = max(_EXACT_TOLERANCE, _SPREAD * usual)
    return Mirror(normal, float(offset), tuple(p for p in pairs if p.distance <= limit))


def _outline(panel: Panel) -> _Outline:
    parameters = np.arange(_PER_EDGE) / _PER_EDGE
    flat = np.stack([edge_points(panel, edge, parameters) for edge in panel.edges])
    placed = flat @ panel.rotation[:, :2].T + panel.translation
    outline = flat.reshape(-1, 2)
    area = signed_area(outline)
    lengths = np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1)
    weights = lengths.reshape(len(panel.edges), -1).sum(axis=1)
    return _Outline(
        flat=flat,
        placed=placed,
        weights=weights / weights.sum(),
        arcs=np.array([edge.kind == EdgeKind.ARC for edge in panel.edges]),
        cubics=np.array([edge.kind == EdgeKind.CUBIC for edge in panel.edges]),
        turn=1 if area > 0.0 else -1,
        size=float(np.sqrt(abs(area))),
    )


def _matched_area(pair: MirrorPair, outlines: Sequence[_Outline], tolerance: float) -> float:
    """Area of the pair's cloth, less where it matches badly."""
    area = outlines[pair.first].size ** 2
    area += outlines[pair.second].size ** 2 if pair.second != pair.first else 0.0
    return area * (1.0 - pair.distance / tolerance)


def _offsets(outlines: Sequence[_Outline], normal: np.ndarray, tolerance: float) -> Iterable[float]:
    """Where the plane may lie: half-way between panels of mirrored shapes, the likeliest first."""
    places, votes = [], []
    for i, first in enumerate(outlines):
        for second in outlines[i:]:
            distances = [_shape(first, second, edges)[0] for edges in _alignments(first, second)]
            if distances and min(distances) < tolerance:
                places.append(0.5 * float(normal @ (first.middle + second.middle)))
                votes.append((first.size + second.size) ** 2)
    # The plane of the body, and not of a lone sleeve.
    across = np.concatenate([outline.placed.reshape(-1, 3) @ normal for outline in outlines])
    centre, reach = 0.5 * (across.min() + across.max()), _OFF_CENTRE * np.ptp(across)
    near = [k for k, place in enumerate(places) if abs(place - centre) <= reach]
    if not near:
        return []
    place, vote = np.array(places)[near], np.array(votes)[near]
    chosen: list[float] = []
    left = np.ones(len(place), dtype=bool)
    while left.any() and len(chosen) < _CANDIDATES:
        close = (np.abs(place[:, None] - place[None, :]) < _WINDOW) & left
        top = close[int(np.argmax(np.where(left, close @ vote, -1.0)))]
        chosen.append(float(np.average(place[top], weights=vote[top])))
        left &= ~top
    return chosen


def _alignments(first: _Outline, second: _Outline) -> Iterable[np.ndarray]:
    """Edges of the second for the first's, for every way around that fits their kinds."""
    count = len(first.weights)
    if len(second.weights) != count:
        return
    step = -1 if first.turn == second.turn else 1
    for shift in range(count):
        edges = (shift + step * np.arange(count)) % count
        if np.array_equal(first.arcs, second.arcs[edges]) and np.array_equal(
            first.cubics, second.cubics[edges]
        ):
            yield edges


def _partner_samples(samples: np.ndarray, edges: np.ndarray, *, backwards: bool) -> np.ndarray:
    """Samples of the second panel at the places of the first's, shape (n k, dimension)."""
    dimension = samples.shape[-1]
    if not backwards:
        return samples[edges].reshape(-1, dimension)
    # Edge e of the first, from its start on, is edge m of the second from its end on.
    ring = samples.reshape(-1, dimension)
    starts = ((edges + 1) * _PER_EDGE)[:, None] - np.arange(_PER_EDGE)[None, :]
    return ring[starts.ravel() % len(ring)]


def _shape(
    first: _Outline, second: _Outline, edges: np.ndarray
) -> tuple[float, Float[np.ndarray, "2 2"]]:
    """Distance of two shapes under the best reflection, and that reflection."""
    weights = np.repeat(first.weights / _PER_EDGE, _PER_EDGE)
    backwards = first.turn == second.turn
    own = first.flat.reshape(-1, 2)
    other = _partner_samples(second.flat, edges, backwards=backwards)
    own = own - weights @ own
    other = other - weights @ other
    product = (weights[:, None] * other).T @ own
    cosine, sine = product[0, 0] - product[1, 1], product[0, 1] + product[1, 0]
    length = float(np.hypot(cosine, sine))
    if length == 0.0:
        return np.inf, np.diag([-1.0, 1.0])
    cosine, sine = cosine / length, sine / length
    # The axis of [[c, s], [s, -c]] lies at half the angle of (c, s); vertical is (-1, 0).
    if abs(np.arctan2(sine, -cosine)) < 2.0 * _VERTICAL:
        cosine, sine = -1.0, 0.0
    reflection = np.array([[cosine, sine], [sine, -cosine]])
    squared = np.sum((own @ reflection.T - other) ** 2, axis=1)
    size = 0.5 * (first.size + second.size)
    return float(np.sqrt(weights @ squared)) / size, reflection


def _pairs(
    outlines: Sequence[_Outline],
    names: Sequence[str],
    normal: np.ndarray,
    offset: float,
    tolerance: float,
) -> tuple[MirrorPair, ...]:
    """The panels that mirror each other in a plane, each in one pair at most."""
    found = []
    for i, first in enumerate(outlines):
        middle = first.middle - 2.0 * (normal @ first.middle - offset) * normal
        for j in range(i, len(outlines)):
            second = outlines[j]
            size = 0.5 * (first.size + second.size)
            apart = float(np.linalg.norm(middle - second.middle)) / size
            if apart > _PLACE_TOLERANCE:
                continue
            pair = _aligned(outlines, i, j, normal)
            if pair is None or pair.distance > tolerance:
                continue
            bonus = _NAMED_BONUS if i != j and _opposite_names(names[i], names[j]) else 0.0
            found.append((pair.distance + apart * tolerance - bonus, len(found), pair))
    taken: set[int] = set()
    chosen = []
    for _, _, pair in sorted(found, key=lambda item: item[:2]):
        if pair.first not in taken and pair.second not in taken:
            taken |= {pair.first, pair.second}
            chosen.append(pair)
    return tuple(sorted(chosen, key=lambda pair: pair.first))


def _aligned(outlines: Sequence[_Outline], i: int, j: int, normal: np.ndarray) -> MirrorPair | None:
    """The two panels as a pair, edges matched by where the mirrored first lies."""
    first, second = outlines[i], outlines[j]
    weights = np.repeat(first.weights / _PER_EDGE, _PER_EDGE)
    backwards = first.turn == second.turn
    mirrored = first.placed.reshape(-1, 3)
    mirrored = mirrored - 2.0 * (mirrored @ normal)[:, None] * normal
    mirrored = mirrored - weights @ mirrored
    best: tuple[float, np.ndarray] | None = None
    for edges in _alignments(first, second):
        if i == j and not np.array_equal(edges[edges], np.arange(len(edges))):
            continue
        other = _partner_samples(second.placed, edges, backwards=backwards)
        other = other - weights @ other
        apart = float(weights @ np.sum((mirrored - other) ** 2, axis=1))
        if best is None or apart < best[0]:
            best = (apart, edges)
    if best is None:
        return None
    distance, reflection = _shape(first, second, best[1])
    return MirrorPair(i, j, best[1], backwards, reflection, distance)


def _refined(
    outlines: Sequence[_Outline], pairs: Sequence[MirrorPair], normal: np.ndarray
) -> tuple[np.ndarray, float]:
    """The plane that the pairs ask for: its normal lies along the ways between partners."""
    ways, middles, weights = [], [], []
    for pair in pairs:
        first, second = outlines[pair.first], outlines[pair.second]
        own = first.placed.reshape(-1, 3)
        other = _partner_samples(second.placed, pair.edges, backwards=pair.reversed)
        ways.append(own - other)
        middles.append(0.5 * (own + other))
        weights.append(np.repeat(first.weights, _PER_EDGE) * first.size**2)
    way, weight = np.concatenate(ways), np.concatenate(weights)
    _, _, axes = np.linalg.svd(way * np.sqrt(weight)[:, None], full_matrices=False)
    refined = axes[0] * np.sign(axes[0] @ normal)
    if refined @ normal < np.cos(_VERTICAL):
        refined = normal
    return refined, float(np.average(np.concatenate(middles) @ refined, weights=weight))


def _opposite_names(first: str, second: str) -> bool:
    """Whether two names differ in nothing but left and right."""

    def sides(name: str, swap: dict[str, str]) -> str:
        return re.sub("left|right", lambda found: swap[found.group()], name.lower())

    other = {"left": "right", "right": "left"}
    return first != second and sides(first, other) == second.lower()
