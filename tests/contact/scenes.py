"""Small meshes that several contact tests use."""

import numpy as np


def grid(k: int, *, spacing: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """A flat square of k x k vertices in the plane y = 0."""
    i = np.arange(k * k).reshape(k, k)
    x, z = np.meshgrid(spacing * np.arange(k), spacing * np.arange(k), indexing="ij")
    positions = np.stack([x.ravel(), np.zeros(k * k), z.ravel()], axis=1)
    lower = np.stack([i[:-1, :-1], i[1:, :-1], i[1:, 1:]], axis=-1).reshape(-1, 3)
    upper = np.stack([i[:-1, :-1], i[1:, 1:], i[:-1, 1:]], axis=-1).reshape(-1, 3)
    return positions, np.concatenate([lower, upper])


def two_layers(k: int, *, gap: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Two curved, slightly rough squares above each other, shifted by a third of a cell."""
    rng = np.random.default_rng(seed)
    lower, faces = grid(k)
    upper = lower + np.array([0.007, gap, 0.005])
    positions = np.concatenate([lower, upper])
    positions[:, 1] += 2.0 * positions[:, 0] ** 2
    positions += 0.02 * gap * rng.normal(size=positions.shape)
    return positions, np.concatenate([faces, faces + k * k])
