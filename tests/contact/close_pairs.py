"""Loose triangles, and the pairs among them that come close, by brute force."""

import itertools

import numpy as np
from ipctk import edge_edge_distance, point_triangle_distance

TIMES = np.linspace(0.0, 1.0, 9)


def soup(n, rng, size):
    """Positions and faces of n triangles that share no vertex."""
    centres = rng.uniform(size=(n, 1, 3))
    return (centres + size * rng.normal(size=(n, 3, 3))).reshape(-1, 3), np.arange(3 * n).reshape(
        -1, 3
    )


def _point_segment(p, a, b):
    along = b - a
    part = np.clip(np.dot(p - a, along) / max(np.dot(along, along), 1e-300), 0.0, 1.0)
    return np.sum((p - a - part * along) ** 2)


def _segments(a, b, c, d):
    # ipctk returns 0 where an edge has no length.
    if np.array_equal(a, b):
        return _point_segment(a, c, d)
    if np.array_equal(c, d):
        return _point_segment(c, a, b)
    return edge_edge_distance(a, b, c, d)


def required_pairs(mesh, start, end, radius):
    """Pairs within the radius at one of some times, by brute force."""

    def near(distance, rows):
        return any(distance(*((1 - t) * start[rows] + t * end[rows])) < radius**2 for t in TIMES)

    def welded(a, b):
        return bool(set(mesh.weld_ids[list(a)]) & set(mesh.weld_ids[list(b)]))

    vertex_face, edge_edge = set(), set()
    for vertices, faces in (
        (mesh.cloth_vertices, mesh.cloth_faces),
        (mesh.cloth_vertices, mesh.body_faces),
        (mesh.body_vertices, mesh.cloth_faces),
    ):
        for v, f in itertools.product(vertices, faces):
            rows = np.concatenate([v, f])
            if not welded(v, f) and near(point_triangle_distance, rows):
                vertex_face.add(tuple(rows))
    pairs = itertools.chain(
        itertools.combinations(mesh.cloth_edges, 2),
        itertools.product(mesh.cloth_edges, mesh.body_edges),
    )
    for a, b in pairs:
        rows = np.concatenate([a, b])
        if not welded(a, b) and near(_segments, rows):
            edge_edge.add(tuple(rows))
    return vertex_face, edge_edge
