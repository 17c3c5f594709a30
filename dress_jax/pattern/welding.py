"""Sew panel meshes into one surface: weld seams and keep every mesh edge in at most two faces.

Seams of few samples can make two different mesh edges join the same two welded vertices (the tips
of a pillow, the corner of a cone), or one mesh edge join a vertex to itself. Outline segments at
fault get more samples; inner edges at fault are split.
"""

import dataclasses

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Int
from scipy.sparse.csgraph import connected_components

from dress_jax.core.errors import InputError


@dataclasses.dataclass(frozen=True, eq=False)
class PanelMesh:
    """A panel's triangles; the first `boundary_count` points are its outline.

    Args:
        points: positions in panel coordinates [m], shape (n, 2).
        faces: counter-clockwise triangles, shape (f, 3).
        boundary_count: number of outline points.
    """

    points: np.ndarray
    faces: np.ndarray
    boundary_count: int


def weld(pairs: Int[np.ndarray, "s 2"], count: int) -> Int[np.ndarray, "count"]:
    """Number the classes of vertices joined by pairs, in order of first appearance.

    Args:
        pairs: vertices to be one, shape (s, 2).
        count: number of vertices.

    Returns:
        Class of each vertex, 0 to n - 1, shape (count,).
    """
    links = scipy.sparse.coo_matrix(
        (np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count)
    )
    _, label = connected_components(links, directed=False)
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[inverse]


def edge_keys(ends: Int[np.ndarray, "n 2"]) -> Int[np.ndarray, "n"]:
    """One number per undirected edge, shape (n,)."""
    low, high = np.min(ends, axis=1).astype(np.int64), np.max(ends, axis=1).astype(np.int64)
    return low * (np.int64(1) << 31) + high


def faulty_segments(
    ends: Int[np.ndarray, "n 2"], twin: Int[np.ndarray, "n"], label: Int[np.ndarray, "b"]
) -> Bool[np.ndarray, "n"]:
    """Outline segments that collapse, or coincide with a segment they are not sewn to.

    Args:
        ends: outline vertices of each segment, shape (n, 2).
        twin: the segment each one is sewn to, or -1, shape (n,).
        label: welded vertex of each outline vertex, shape (b,).

    Returns:
        True where a segment is at fault, shape (n,).
    """
    welded = label[ends]
    _, group, sizes = np.unique(edge_keys(welded), return_inverse=True, return_counts=True)
    expected = np.where(twin >= 0, 2, 1)
    return (welded[:, 0] == welded[:, 1]) | (sizes[group] != expected)


def split_faulty_edges(
    meshes: list[PanelMesh], label: list[np.ndarray], max_rounds: int = 8
) -> list[PanelMesh]:
    """Split inner mesh edges that collapse or coincide with another edge after welding.

    Args:
        meshes: the panels' meshes.
        label: welded vertex of each outline point, one array per panel.

    Returns:
        Meshes in which every welded edge has at most two faces. New points follow the old ones.

    Raises:
        InputError: edges are still at fault after `max_rounds`.
    """
    meshes = list(meshes)
    for attempt in range(max_rounds + 1):
        faults = _faulty_inner_edges(meshes, label)
        if not faults:
            return meshes
        if attempt == max_rounds:
            break
        for panel, ends, collapsed in faults:
            meshes[panel] = _split_edge(meshes[panel], ends, pieces=3 if collapsed else 2)
    raise InputError(
        "welding its seams puts more than two triangles on one edge",
        where=f"panel number {faults[0][0]}",
        mend="use a smaller edge length, or check that no two stitches overlap",
    )


def _faulty_inner_edges(
    meshes: list[PanelMesh], label: list[np.ndarray]
) -> list[tuple[int, tuple[int, int], bool]]:
    """Inner edges to split: (panel, its two points, whether they are welded together)."""
    base = max((int(part.max()) for part in label), default=-1) + 1
    panels, ends, welded, inner = [], [], [], []
    for number, mesh in enumerate(meshes):
        count = len(mesh.points)
        directed = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        keys, first, uses = np.unique(edge_keys(directed), return_index=True, return_counts=True)
        own = np.concatenate([label[number], base + np.arange(count - mesh.boundary_count)])
        base += count - mesh.boundary_count
        panels.append(np.full(len(keys), number))
        ends.append(directed[first])
        welded.append(own[directed[first]])
        inner.append(uses == 2)
    panel, end = np.concatenate(panels), np.concatenate(ends)
    names, is_inner = np.concatenate(welded), np.concatenate(inner)
    _, group, sizes = np.unique(edge_keys(names), return_inverse=True, return_counts=True)
    collapsed = names[:, 0] == names[:, 1]
    at_fault = is_inner & (collapsed | (sizes[group] > 1))
    return [
        (int(panel[i]), (int(end[i, 0]), int(end[i, 1])), bool(collapsed[i]))
        for i in np.flatnonzero(at_fault)
    ]


def _split_edge(mesh: PanelMesh, ends: tuple[int, int], *, pieces: int) -> PanelMesh:
    """Cut an inner edge into equal pieces; both triangles at it become `pieces` triangles."""
    a, b = ends
    count = len(mesh.points)
    share = (np.arange(1, pieces) / pieces)[:, None]
    added = (1.0 - share) * mesh.points[a] + share * mesh.points[b]
    chain = [a, *range(count, count + pieces - 1), b]
    has = (mesh.faces == a).any(axis=1) & (mesh.faces == b).any(axis=1)
    new = []
    for face in mesh.faces[has].tolist():
        apex = next(v for v in face if v not in (a, b))
        forward = face[(face.index(a) + 1) % 3] == b
        path = chain if forward else chain[::-1]
        new += [(path[i], path[i + 1], apex) for i in range(pieces)]
    return PanelMesh(
        points=np.concatenate([mesh.points, added]),
        faces=np.concatenate([mesh.faces[~has], np.array(new, dtype=mesh.faces.dtype)]),
        boundary_count=mesh.boundary_count,
    )
