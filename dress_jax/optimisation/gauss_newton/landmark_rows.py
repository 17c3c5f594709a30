"""Differences between landmarks of a garment and where they are seen, linearized. Host, numpy."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse
from jaxtyping import Float

from dress_jax.optimisation.landmarks import Landmark, landmark_weights
from dress_jax.pattern import Discretization
from dress_jax.render.cameras import Camera, CameraKind


class LandmarkRows(NamedTuple):
    """Differences of d components.

    Attributes:
        value: landmark minus its place [m], (q, d).
        jacobian: in the flattened positions, (q d, 3 n).
    """

    value: Float[np.ndarray, "q d"]
    jacobian: scipy.sparse.csr_array


def rows_in_space(
    landmarks: Sequence[Landmark],
    discretization: Discretization,
    positions: Float[np.ndarray, "n 3"],
) -> LandmarkRows:
    """Differences in space, of the landmarks that have a position."""
    own = [mark for mark in landmarks if mark.position is not None]
    weights = landmark_weights(own, discretization)
    wanted = np.array([mark.position for mark in own], float).reshape(-1, 3)
    return LandmarkRows(weights.dot(positions) - wanted, _to_space(weights))


def rows_in_pictures(
    landmarks: Sequence[Landmark],
    discretization: Discretization,
    positions: Float[np.ndarray, "n 3"],
    cameras: Camera,
) -> LandmarkRows:
    """Differences across the line of sight, of the landmarks that have a pixel.

    Along the camera's right and up, between the landmark and the line of sight through the pixel,
    in the landmark's plane; linear in the positions.
    """
    own = [mark for mark in landmarks if mark.pixel is not None]
    weights = landmark_weights(own, discretization)
    views = np.array([mark.view for mark in own], int)
    wanted = np.array([mark.pixel for mark in own], float).reshape(-1, 2)
    rotation, eye, scale, principal = (
        np.asarray(part, np.float64)[views]
        for part in (cameras.rotation, cameras.position, cameras.scale, cameras.principal)
    )
    offset = weights.dot(positions) - eye
    # Where the line of sight runs, per metre of depth or in metres; rows grow downward.
    sight = np.array([1.0, -1.0]) * (wanted - principal) / scale
    value = np.stack([np.sum(offset * rotation[:, k], axis=1) for k in (0, 1)], axis=1)
    if cameras.kind is CameraKind.PERSPECTIVE:
        depth = -np.sum(offset * rotation[:, 2], axis=1)
        value = value - depth[:, None] * sight
        slope = rotation[:, :2] + sight[:, :, None] * rotation[:, 2:]
    else:
        value, slope = value - sight, rotation[:, :2]
    count = len(own)
    columns = 3 * np.arange(count)[:, None, None] + np.zeros((2, 1), int) + np.arange(3)
    blocks = scipy.sparse.csr_array(
        (slope.ravel(), (np.repeat(np.arange(2 * count), 3), columns.ravel())),
        shape=(2 * count, 3 * count),
    )
    return LandmarkRows(value, scipy.sparse.csr_array(blocks.dot(_to_space(weights))))


def _to_space(weights: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
    """The same weights for all three coordinates."""
    spread = scipy.sparse.kron(weights, scipy.sparse.eye_array(3), format="csr")
    return scipy.sparse.csr_array(spread)
