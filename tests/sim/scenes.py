"""Small scenes for the simulator's tests."""

import numpy as np
import trimesh

from dress_jax.energy.fabric import Fabric
from dress_jax.energy.membrane import MembraneModel
from dress_jax.sim import make_cloth, make_simulator
from dress_jax.solver import NewtonOptions

SOFT = Fabric(density=0.2, stretching_stiffness=100.0, bending_stiffness=1e-5)


def sheet(count: int, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Rest positions (n, 2) and triangles of a square sheet with `count` vertices a side."""
    grid = np.linspace(-size / 2, size / 2, count)
    a, b = np.meshgrid(grid, grid, indexing="ij")
    index = np.arange(count * count).reshape(count, count)
    p, q, r, s = (part.ravel() for part in _corners(index))
    faces = np.concatenate([np.stack([p, q, r], 1), np.stack([p, r, s], 1)])
    return np.stack([a.ravel(), b.ravel()], 1), faces


def _corners(index: np.ndarray):
    return index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]


def level(rest: np.ndarray, height: float) -> np.ndarray:
    """The sheet lying in a horizontal plane, facing up."""
    return np.stack([rest[:, 0], np.full(len(rest), height), -rest[:, 1]], axis=1)


def ball(radius: float, subdivisions: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """A sphere at the origin as vertices and triangles."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def draped_sheet(
    count: int = 6,
    *,
    tolerance: float = 1e-12,
    membrane: MembraneModel = MembraneModel.ARAP,
    **options,
):
    """A sheet pinned at two corners over a ball: cloth, simulator, rest, start, body."""
    rest, faces = sheet(count, 0.3)
    start = level(rest, 0.085)
    body, body_faces = ball(0.08)
    cloth = make_cloth(faces, pins=np.array([0, count - 1]), membrane=membrane)
    simulator = make_simulator(
        cloth,
        start,
        body_vertices=body,
        body_faces=body_faces,
        newton=NewtonOptions(tolerance=tolerance, iteration_limit=300),
        **options,
    )
    return cloth, simulator, rest, start, body
