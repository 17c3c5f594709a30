"""Connectivity of triangle meshes on the host: edges, hinges, boundaries, validation."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components as _graph_components

from dress_jax.core.errors import InputError


@dataclass(frozen=True)
class Hinges:
    """Pairs of faces that share an edge.

    Attributes:
        vertices: [v0, v1, v2, v3], shape (h, 4); v0 -> v1 is the shared edge in the direction in
            which face `a` runs along it, v2 is opposite in face `a` and v3 in face `b`.
        faces: the two faces [a, b], a < b, shape (h, 2).
        local_corner: corner (0, 1 or 2) of the opposite vertex in each face, shape (h, 2). Corners
            `local + 1` and `local + 2` (mod 3) are the shared edge, in that face's direction.
    """

    vertices: Int[np.ndarray, "h 4"]
    faces: Int[np.ndarray, "h 2"]
    local_corner: Int[np.ndarray, "h 2"]


@dataclass(frozen=True)
class _HalfEdges:
    """Half-edge 3 f + k runs from corner k to corner k + 1 of face f."""

    origin: np.ndarray
    target: np.ndarray
    twin: np.ndarray  # the other half-edge on the same edge, or -1


def _as_faces(faces: np.ndarray) -> np.ndarray:
    faces = np.asarray(faces)
    if faces.size == 0:
        return np.zeros((0, 3), np.int64)
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise InputError(
            f"faces have shape {faces.shape}, expected (f, 3)", mend="give triangles only"
        )
    if not np.issubdtype(faces.dtype, np.integer):
        raise InputError(f"faces have type {faces.dtype}", mend="give integer vertex indices")
    return faces.astype(np.int64, copy=False)


def _edge_keys(origin: np.ndarray, target: np.ndarray) -> np.ndarray:
    low, high = np.minimum(origin, target), np.maximum(origin, target)
    return (low << 32) | high


def _half_edges(faces: np.ndarray) -> _HalfEdges:
    origin = faces.reshape(-1)
    target = np.roll(faces, -1, axis=1).reshape(-1)
    keys = _edge_keys(origin, target)
    order = np.argsort(keys, kind="stable")
    same = keys[order][1:] == keys[order][:-1]
    if np.any(same[1:] & same[:-1]):
        at = order[np.flatnonzero(same[1:] & same[:-1])[0]]
        raise InputError(
            f"edge ({origin[at]}, {target[at]}) belongs to more than two faces",
            where="faces",
            mend="split the vertices along that edge",
        )
    twin = np.full(origin.shape, -1, np.int64)
    first, second = order[:-1][same], order[1:][same]
    twin[first], twin[second] = second, first
    return _HalfEdges(origin, target, twin)


def neighbour_graph(faces: Int[np.ndarray, "f 3"], count: int) -> csr_array:
    """Which vertices share an edge: a symmetric matrix of ones, (count, count)."""
    edges = unique_edges(faces)
    both = np.concatenate([edges, edges[:, ::-1]])
    return csr_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(count, count))


def neighbour_mean(graph: csr_array) -> csr_array:
    """The matrix that takes values of vertices to the means over their neighbours, 0 for none."""
    degree = np.maximum(graph.sum(axis=1), 1.0)
    return csr_array(diags_array(1.0 / degree) @ graph)


def unique_edges(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "e 2"]:
    """Every edge once, smaller index first, in lexicographic order.

    Args:
        faces: vertex indices, shape (f, 3).

    Returns:
        Edges, shape (e, 2), int64.
    """
    faces = _as_faces(faces)
    keys = np.unique(_edge_keys(faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)))
    return np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1)


def hinges(faces: Int[np.ndarray, "f 3"]) -> Hinges:
    """The inner edges of a mesh with their two faces, ordered by face and corner.

    Args:
        faces: vertex indices, shape (f, 3), at most two faces at an edge.

    Raises:
        InputError: an edge has more than two faces.
    """
    faces = _as_faces(faces)
    half = _half_edges(faces)
    a = np.flatnonzero(half.twin > np.arange(half.twin.size))
    b = half.twin[a]
    corner_a, corner_b = (a % 3 + 2) % 3, (b % 3 + 2) % 3
    face_a, face_b = a // 3, b // 3
    return Hinges(
        vertices=np.stack(
            [half.origin[a], half.target[a], faces[face_a, corner_a], faces[face_b, corner_b]],
            axis=1,
        ),
        faces=np.stack([face_a, face_b], axis=1),
        local_corner=np.stack([corner_a, corner_b], axis=1),
    )


def boundary_loops(faces: Int[np.ndarray, "f 3"]) -> list[Int[np.ndarray, "k"]]:
    """Closed boundary curves, each with the mesh on its left for counter-clockwise faces.

    Where two boundary curves touch in one vertex they are told apart by walking around that vertex
    through its faces.

    Args:
        faces: vertex indices, shape (f, 3), consistently oriented.

    Returns:
        One array of vertices per loop, starting at its smallest vertex, ordered by that vertex.

    Raises:
        InputError: an edge has more than two faces, or the orientation is inconsistent.
    """
    faces = _as_faces(faces)
    half = _half_edges(faces)
    _require_oriented(half)

    def following(edge: int) -> int:
        return edge - edge % 3 + (edge + 1) % 3

    unvisited = dict.fromkeys(np.flatnonzero(half.twin < 0).tolist())
    loops = []
    while unvisited:
        edge = next(iter(unvisited))
        loop = []
        while edge in unvisited:
            del unvisited[edge]
            loop.append(half.origin[edge])
            edge = following(edge)
            while half.twin[edge] >= 0:
                edge = following(int(half.twin[edge]))
        array = np.array(loop, np.int64)
        loops.append(np.roll(array, -int(np.argmin(array))))
    return sorted(loops, key=lambda loop: tuple(loop[:2]))


def boundary_vertices(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "k"]:
    """The vertices of edges with one face, in order; any orientation will do."""
    half = _half_edges(_as_faces(faces))
    alone = half.twin < 0
    return np.unique(np.concatenate([half.origin[alone], half.target[alone]]))


def connected_components(faces: Int[np.ndarray, "f 3"], n: int) -> Int[np.ndarray, "n"]:
    """The component of every vertex, numbered from 0; a vertex without faces is its own component.

    Args:
        faces: vertex indices, shape (f, 3).
        n: number of vertices.
    """
    edges = unique_edges(faces)
    graph = coo_array((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), shape=(n, n))
    return _graph_components(graph, directed=False)[1].astype(np.int64)


def inconsistent_edges(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "k 2"]:
    """Edges that both of their faces run along in the same direction (flipped neighbours)."""
    half = _half_edges(_as_faces(faces))
    flipped = _flipped(half)
    edges = np.stack([half.origin[flipped], half.target[flipped]], axis=1)
    return np.sort(edges, axis=1)


def _flipped(half: _HalfEdges) -> Bool[np.ndarray, "h"]:
    inner = half.twin > np.arange(half.twin.size)
    return inner & (half.origin == half.origin[half.twin])


def _require_oriented(half: _HalfEdges) -> None:
    flipped = np.flatnonzero(_flipped(half))
    if flipped.size:
        at = flipped[0]
        raise InputError(
            f"the faces at edge ({half.origin[at]}, {half.target[at]}) have opposite orientations "
            f"({flipped.size} such edges)",
            where="faces",
            mend="flip faces until neighbours agree",
        )


def validate_manifold(
    faces: Int[np.ndarray, "f 3"], n: int | None = None, *, require_orientation: bool = True
) -> None:
    """Check that faces describe a surface (with or without boundary).

    Args:
        faces: vertex indices, shape (f, 3).
        n: number of vertices; None checks only for negative indices.
        require_orientation: also demand that neighbouring faces agree in orientation.

    Raises:
        InputError: an index out of range, a face that names a vertex twice, an edge with more than
            two faces, or (if asked) neighbours of opposite orientation.
    """
    faces = _as_faces(faces)
    outside = (faces < 0) if n is None else (faces < 0) | (faces >= n)
    if outside.any():
        row = int(np.flatnonzero(outside.any(axis=1))[0])
        limit = "" if n is None else f" but there are {n} vertices"
        raise InputError(
            f"names vertices {faces[row].tolist()}{limit}",
            where=f"face {row}",
            mend="indices count from 0",
        )
    repeated = (faces == np.roll(faces, -1, axis=1)).any(axis=1)
    if repeated.any():
        row = int(np.flatnonzero(repeated)[0])
        raise InputError(
            f"names a vertex twice: {faces[row].tolist()}",
            where=f"face {row}",
            mend="remove the face",
        )
    half = _half_edges(faces)
    if require_orientation:
        _require_oriented(half)
