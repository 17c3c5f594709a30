"""How many samples each pattern edge gets, and where (host; checklist S5.1, S5.2, S5.3)."""

import math

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from dress_jax.core.errors import InputError
from dress_jax.geometry.curves import relative_lengths, turning_angle, uniform_parameters
from dress_jax.pattern.model import Edge, EdgeKind, Panel, Pattern
from dress_jax.pattern.outline import crossing_edges, cubic_controls, edge_points
from dress_jax.pattern.validation import crossing_error

_MAX_TURN = math.radians(30.0)  # turning per segment of a sampled curve
_MAX_REFINEMENTS = 6


def edge_count_minimum(pattern: Pattern, edge_length: float) -> Int[np.ndarray, "E"]:
    """Segments of every edge on its own: at most `edge_length` long, at most 30 degrees of turning.

    Returns:
        Counts, at least 1, shape (E,).
    """
    counts = []
    for panel in pattern.panels:
        for edge in panel.edges:
            first, second = cubic_controls(edge)
            is_arc = edge.kind == EdgeKind.ARC
            chord = np.hypot(*(panel.vertices[edge.end] - panel.vertices[edge.start]))
            flag = np.array([is_arc])
            length = chord * relative_lengths(flag, first[None], second[None], xp=np)[0]
            turning = 0.0 if edge.kind == EdgeKind.LINE else turning_angle(is_arc, first, second)
            counts.append(
                max(1, math.ceil(length / edge_length - 1e-9), math.ceil(turning / _MAX_TURN))
            )
    return np.array(counts, dtype=np.int64)


def stitched_edges(pattern: Pattern) -> Int[np.ndarray, "n 2"]:
    """Edge numbers (panel by panel) of both sides of every stitch, shape (n, 2)."""
    offsets = dict(
        zip(
            (panel.name for panel in pattern.panels),
            np.cumsum([0] + [len(panel.edges) for panel in pattern.panels]),
            strict=False,
        )
    )
    pairs = [
        (
            offsets[stitch.first.panel] + stitch.first.edge,
            offsets[stitch.second.panel] + stitch.second.edge,
        )
        for stitch in pattern.stitches
    ]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def synchronise(
    counts: Int[np.ndarray, "E"], stitched: Int[np.ndarray, "n 2"]
) -> Int[np.ndarray, "E"]:
    """Give all edges that are linked by stitches the largest count among them, shape (E,)."""
    size = len(counts)
    links = scipy.sparse.coo_matrix(
        (np.ones(len(stitched)), (stitched[:, 0], stitched[:, 1])), shape=(size, size)
    )
    _, group = connected_components(links, directed=False)
    largest = np.zeros(size, dtype=counts.dtype)
    np.maximum.at(largest, group, counts)
    return largest[group]


def panel_samples(
    panel: Panel, counts: Int[np.ndarray, "edges"]
) -> tuple[Float[np.ndarray, "b 2"], Float[np.ndarray, "b"], Int[np.ndarray, "b"]]:
    """Samples of a panel's outline, uniform in arc length along every edge.

    Each edge contributes its start and its inner samples; its end belongs to the next edge.

    Returns:
        Points [m], shape (b, 2); curve parameters, shape (b,); edge of each sample, shape (b,).
    """
    points, parameters, owners = [], [], []
    for i, edge in enumerate(panel.edges):
        t = sample_parameters(edge, int(counts[i]))
        points.append(edge_points(panel, edge, t))
        parameters.append(t)
        owners.append(np.full(len(t), i))
    return np.concatenate(points), np.concatenate(parameters), np.concatenate(owners)


def sample_parameters(edge: Edge, count: int) -> Float[np.ndarray, "count"]:
    """Curve parameters of an edge's samples without its end, shape (count,)."""
    if edge.kind == EdgeKind.LINE:
        return np.arange(count) / count
    first, second = cubic_controls(edge)
    return uniform_parameters(edge.kind == EdgeKind.ARC, first, second, count)[:-1]


def resolve_crossings(
    pattern: Pattern, counts: Int[np.ndarray, "E"], stitched: Int[np.ndarray, "n 2"]
) -> Int[np.ndarray, "E"]:
    """Double the samples of edges whose polylines cross although the curves do not.

    Raises:
        InputError: an outline still crosses itself after six doublings; names panel and edges.
    """
    offsets = np.cumsum([0] + [len(panel.edges) for panel in pattern.panels])
    counts = synchronise(counts, stitched)
    for attempt in range(_MAX_REFINEMENTS + 1):
        raised = counts.copy()
        for number, panel in enumerate(pattern.panels):
            base = offsets[number]
            points, _, owners = panel_samples(panel, counts[base : base + len(panel.edges)])
            found = crossing_edges(points, owners)
            if found is None:
                continue
            (i, j), point = found
            curved = [e for e in {i, j} if panel.edges[e].kind != EdgeKind.LINE]
            if attempt == _MAX_REFINEMENTS or not curved:
                raise crossing_error(panel.name, (i, j), point, source=pattern.source)
            for e in curved:
                raised[base + e] = 2 * counts[base + e]
        if np.array_equal(raised, counts):
            return counts
        counts = synchronise(raised, stitched)
    raise InputError("an outline cannot be sampled without crossings", where=pattern.source)
