"""Meshes of the stress scenes."""

import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy.spatial import Delaunay

Mesh = tuple[Float[np.ndarray, "n d"], Int[np.ndarray, "f 3"]]


def sheet(count: int, size: float) -> Mesh:
    """Rest positions (n, 2) of a square around the origin, `count` vertices a side."""
    line = np.linspace(-size / 2, size / 2, count)
    a, b = (part.ravel() for part in np.meshgrid(line, line, indexing="ij"))
    return np.stack([a, b], 1), _squares(np.arange(count * count).reshape(count, count))


def _squares(index: np.ndarray) -> np.ndarray:
    """Two triangles for each square of a grid of vertices."""
    corners = (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    p, q, r, s = (corner.ravel() for corner in corners)
    return np.concatenate([np.stack([p, q, r], 1), np.stack([p, r, s], 1)])


def level(rest: Float[np.ndarray, "n 2"], height: float) -> Float[np.ndarray, "n 3"]:
    """Flat positions in a horizontal plane."""
    return np.stack([rest[:, 0], np.full(len(rest), height), -rest[:, 1]], axis=1)


def tube(around: int, along: int, radius: float, length: float):
    """An open cylinder about the y axis: rest positions, rest faces, positions, faces."""
    columns, rows = np.meshgrid(np.arange(around + 1), np.arange(along), indexing="ij")
    # Sides of the polygon, so that the cylinder is at rest.
    side = 2.0 * radius * np.sin(np.pi / around)
    rest = np.stack([columns.ravel() * side, rows.ravel() * length / (along - 1)], 1)
    rest_faces = _squares(np.arange((around + 1) * along).reshape(around + 1, along))
    weld = ((columns % around) * along + rows).ravel()
    angle = 2.0 * np.pi * np.arange(around) / around
    column = np.repeat(angle, along)
    height = np.tile(np.linspace(-length / 2, length / 2, along), around)
    positions = np.stack([radius * np.cos(column), height, radius * np.sin(column)], 1)
    return rest, rest_faces, positions, weld[rest_faces]


def graded(sizes: int, ratio: float, size: float, *, seed: int = 0, slivers: bool = False) -> Mesh:
    """A disc whose triangles grow from its middle outward by `ratio`; with slivers on request."""
    rng = np.random.default_rng(seed)
    radii = size / 2 * np.geomspace(1.0 / ratio, 1.0, sizes)
    angle = 2.0 * np.pi * np.arange(8) / 8
    rings = [
        radius * np.stack([np.cos(turned), np.sin(turned)], 1)
        for number, radius in enumerate(radii)
        for turned in [angle + np.pi / 8 * (number % 2)]
    ]
    points = np.concatenate([np.zeros((1, 2)), *rings])
    points += 0.02 * radii[0] * rng.normal(size=points.shape)
    faces = Delaunay(points).simplices
    return _with_slivers(points, faces) if slivers else (points, faces)


def _with_slivers(points: np.ndarray, faces: np.ndarray) -> Mesh:
    """A vertex in every third triangle, a hundredth of its height away from one of its sides."""
    split = np.arange(0, len(faces), 3)
    a, b, c = faces[split].T
    inner = np.arange(len(split)) + len(points)
    added = 0.495 * (points[a] + points[b]) + 0.01 * points[c]
    parts = [np.stack(corners, 1) for corners in ((a, b, inner), (b, c, inner), (c, a, inner))]
    kept = np.delete(faces, split, axis=0)
    return np.concatenate([points, added]), np.concatenate([kept, *parts])


def copies(rest: np.ndarray, faces: np.ndarray, count: int) -> Mesh:
    """Several sheets as one cloth, in rest coordinates apart from each other."""
    width = np.ptp(rest[:, 0]) * 1.5
    moved = [rest + np.array([number * width, 0.0]) for number in range(count)]
    return np.concatenate(moved), np.concatenate([faces + len(rest) * k for k in range(count)])


def ball(radius: float, subdivisions: int = 2) -> Mesh:
    """A sphere at the origin."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def ring(radius: float, tube_radius: float) -> Mesh:
    """A torus about the y axis."""
    mesh = trimesh.creation.torus(radius, tube_radius, major_sections=24, minor_sections=8)
    return np.asarray(mesh.vertices)[:, [0, 2, 1]], np.asarray(mesh.faces)[:, ::-1]


def plate(side: float, height: float) -> Mesh:
    """A flat box whose upper side is at the height."""
    mesh = trimesh.creation.box((side, 0.01, side)).subdivide()
    return np.asarray(mesh.vertices) + np.array([0, height - 0.005, 0]), np.asarray(mesh.faces)


def needles(count: int, spacing: float, height: float) -> Mesh:
    """A square of `count` times `count` thin pyramids, with their tips at y = 0."""
    line = spacing * (np.arange(count) - (count - 1) / 2)
    foot = 0.1 * spacing
    square = np.array([[-foot, -height, -foot], [-foot, -height, foot]])
    square = np.concatenate([square, -square * [1, -1, 1], np.zeros((1, 3))])
    sides = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    corners = [square + np.array([x, 0.0, z]) for x in line for z in line]
    faces = [sides + 5 * k for k in range(len(corners))]
    return np.concatenate(corners), np.concatenate(faces)


def together(*meshes: Mesh) -> Mesh:
    """Several meshes as one."""
    counts = np.cumsum([0] + [len(vertices) for vertices, _ in meshes])
    vertices = np.concatenate([mesh[0] for mesh in meshes])
    faces = [mesh[1] + first for mesh, first in zip(meshes, counts, strict=False)]
    return vertices, np.concatenate(faces)
