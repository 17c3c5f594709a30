"""A small garment of order one in every quantity, so that finite differences are well scaled."""

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from dress_jax.core import components as c
from dress_jax.energy.cloth import Cloth, Parameters, make_cloth
from dress_jax.energy.elastic import TimeStep
from dress_jax.energy.membrane import MembraneModel
from dress_jax.energy.rest import RestTriangles, rest_triangles


def rotation(rng: np.random.Generator) -> np.ndarray:
    """A random rotation matrix."""
    return Rotation.random(random_state=rng).as_matrix()


def grid(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit squares cut along one diagonal: rest positions (n, 2) and triangles."""
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    k = np.arange(rows * columns).reshape(rows, columns)
    p, q, r, s = (part.ravel() for part in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    faces = np.concatenate([np.stack([p, q, r], 1), np.stack([p, r, s], 1)])
    return np.stack([i.ravel(), j.ravel()], 1).astype(float), faces


def garment(
    membrane: MembraneModel = MembraneModel.ARAP, seed: int = 0
) -> tuple[Cloth, Parameters, TimeStep, np.ndarray]:
    """Cloth, parameters, time step and bent, stretched positions of a 3x3 sheet."""
    rng = np.random.default_rng(seed)
    rest, faces = grid(3, 3)
    rest = rest + 0.1 * rng.normal(size=rest.shape)
    positions = np.c_[1.1 * rest[:, 0], 0.2 * rest[:, 0] * rest[:, 1], 0.9 * rest[:, 1]]
    positions = positions + 0.1 * rng.normal(size=positions.shape)
    stitches = np.array([[0, 2], [6, 8]])
    cloth = make_cloth(faces, pins=np.array([0, 6]), stitches=stitches, membrane=membrane)
    scalar = jnp.asarray
    parameters = Parameters(
        rest_positions=scalar(rest),
        density=scalar(0.7),
        stretching_stiffness=scalar(1.3),
        poisson_ratio=scalar(0.3),
        warp_stiffness=scalar(2.1),
        weft_stiffness=scalar(1.2),
        shear_stiffness=scalar(0.6),
        grain_angle=scalar(0.4),
        bending_stiffness=scalar(0.4),
        bending_anisotropy=scalar(0.25),
        gravity=scalar([0.1, -1.0, 0.2]),
        pin_targets=scalar(rng.normal(size=(2, 3))),
        pin_stiffness=scalar(1.7),
        stitch_stiffness=scalar(0.9),
        body_vertices=jnp.zeros((0, 3)),
        barrier_stiffness=scalar(1.0),
        friction_coefficient=scalar(0.5),
    )
    step = TimeStep(
        start=scalar(rng.normal(size=positions.shape)),
        velocity=scalar(rng.normal(size=positions.shape)),
        inverse_step=scalar(1.5),
    )
    return cloth, parameters, step, positions


def stretched_triangles(
    stretches: np.ndarray, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, RestTriangles, np.ndarray]:
    """Separate random triangles with given singular values of the deformation gradient.

    Every other triangle runs clockwise in its panel, as in a mirrored panel.

    Args:
        stretches: singular values, (f, 2).

    Returns:
        Positions (3 f, 3), faces (3, f), the rest triangles, and their rest positions (3 f, 2).
    """
    rng = np.random.default_rng(seed)
    rest, positions = [], []
    for k, values in enumerate(stretches):
        corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.3, 0.9]]) + 0.2 * rng.normal(size=(3, 2))
        corners = corners[::-1] if k % 2 else corners
        angle = rng.uniform(0.0, 2.0 * np.pi)
        right = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        gradient = rotation(rng)[:, :2] @ np.diag(values) @ right.T
        rest.append(corners)
        positions.append(corners @ gradient.T + rng.normal(size=3))
    faces = np.arange(3 * len(stretches)).reshape(-1, 3).T
    flat = np.concatenate(rest)
    triangles = rest_triangles(jnp.asarray(flat), jnp.asarray(faces))
    return np.concatenate(positions), faces, triangles, flat


def columns(positions: np.ndarray) -> c.Components:
    """Components of an array of row vectors."""
    return c.split(jnp.asarray(positions))
