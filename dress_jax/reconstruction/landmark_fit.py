"""Stages that need landmarks only: coarse (S7.3), then pose and shape as well.

Seven to two hundred unknowns and smooth residuals. Levenberg-Marquardt ends in a minimum and knows
no rate; Adam takes about as long and does not always arrive (measured: docs/reconstruction.md).
"""

import jax
import jax.numpy as jnp
import numpy as np

from dress_jax.core.pytree import replace
from dress_jax.reconstruction.landmarks import LandmarkMap
from dress_jax.reconstruction.levenberg_marquardt import Minimum, minimize
from dress_jax.reconstruction.losses import (
    Strengths,
    landmark_residuals,
    regularizer_residuals,
)
from dress_jax.reconstruction.options import Free
from dress_jax.reconstruction.parameters import (
    BodyParameters,
    free_columns,
    pack,
    unpack,
    wrap_rotations,
)
from dress_jax.reconstruction.views import BodyViews
from dress_jax.render.cameras import Camera, CameraKind

TURNS = (0.0, 90.0, 180.0, 270.0)
"""Starts of the coarse stage, about the body's vertical axis [degrees]."""


def fit_landmarks(
    mapping: LandmarkMap,
    views: BodyViews,
    start: BodyParameters,
    estimate: BodyParameters | None,
    strengths: Strengths,
    free: Free,
    *,
    iterations: int,
) -> tuple[BodyParameters, Minimum]:
    """Lower the landmark loss and the regularizers over the free parameters.

    Args:
        mapping: the landmarks of the model.
        views: what was seen.
        start: parameters to begin with.
        estimate: to stay near (S7.10), or None for the human prior.
        strengths: weights.
        free: what may change.
        iterations: steps at most.
    """
    joints, dtype = start.pose.shape[0], start.pose.dtype
    data = (mapping, _without_images(views), estimate, strengths)

    def tidy(vector: np.ndarray) -> np.ndarray:
        tidied = vector.copy()
        end = 4 + 3 * joints
        tidied[4:end] = wrap_rotations(vector[4:end].reshape(joints, 3)).ravel()
        return tidied

    found = minimize(
        lambda vector: np.asarray(_residuals(jnp.asarray(vector, dtype), *data)),
        lambda vector: np.asarray(_jacobian(jnp.asarray(vector, dtype), *data)),
        np.asarray(pack(start)),
        free_columns(free, start.shape.shape[0]),
        iterations=iterations,
        tidy=tidy,
    )
    return unpack(jnp.asarray(found.vector, dtype), joints), found


def fit_coarse(
    mapping: LandmarkMap,
    views: BodyViews,
    start: BodyParameters,
    estimate: BodyParameters | None,
    strengths: Strengths,
    free: Free,
    *,
    iterations: int,
) -> tuple[BodyParameters, Minimum]:
    """`fit_landmarks` from several turns about the vertical axis, where the rotation is free.

    A body seen from behind has a minimum of its own; the lowest of them is kept.
    """
    turns = TURNS if free.rotation else TURNS[:1]
    fits = [
        fit_landmarks(
            mapping, views, _turned(start, turn), estimate, strengths, free, iterations=iterations
        )
        for turn in turns
    ]
    return min(fits, key=lambda fit: fit[1].loss if np.isfinite(fit[1].loss) else np.inf)


def middle_of_view(cameras: Camera) -> np.ndarray:
    """The point that a stack of cameras looks at [m], where a person is looked for first.

    Closest to the lines of sight of all image centres; weakly drawn to three metres before the
    eyes, which decides where the lines are parallel.
    """
    toward = np.asarray(cameras.rotation, np.float64)[:, 2]
    rotation = np.asarray(cameras.rotation, np.float64)
    eye = np.asarray(cameras.position, np.float64)
    middle = 0.5 * np.array([cameras.width - 1.0, cameras.height - 1.0])
    offset = (middle - np.asarray(cameras.principal, np.float64)) / np.asarray(cameras.scale)
    across = offset[:, :1] * rotation[:, 0] - offset[:, 1:] * rotation[:, 1]
    if cameras.kind is CameraKind.ORTHOGRAPHIC:
        origin, direction = eye + across, -toward
    else:
        direction = across - toward
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        origin = eye
    projector = np.eye(3)[None] - direction[:, :, None] * direction[:, None, :]
    weak = 1e-6
    matrix = projector.sum(axis=0) + weak * len(eye) * np.eye(3)
    goal = np.sum(projector * origin[:, None, :], axis=(0, 2))
    goal = goal + weak * np.sum(origin + 3.0 * direction, axis=0)
    return np.linalg.solve(matrix, goal)


def _turned(start: BodyParameters, degrees: float) -> BodyParameters:
    from scipy.spatial.transform import Rotation

    if degrees == 0.0:
        return start
    turn = Rotation.from_rotvec([0.0, np.radians(degrees), 0.0])
    row = (turn * Rotation.from_rotvec(np.array(start.pose[0], np.float64))).as_rotvec()
    return replace(start, pose=start.pose.at[0].set(jnp.asarray(row, start.pose.dtype)))


def _without_images(views: BodyViews) -> BodyViews:
    """Pictures would be part of the signature of a program that does not look at them."""
    return replace(views, mask=None, color=None, visible=None)


@jax.jit
def _residuals(vector, mapping, views, estimate, strengths):
    return _all_residuals(vector, mapping, views, estimate, strengths)


@jax.jit
def _jacobian(vector, mapping, views, estimate, strengths):
    return jax.jacfwd(_all_residuals)(vector, mapping, views, estimate, strengths)


def _all_residuals(vector, mapping, views, estimate, strengths):
    parameters = unpack(vector, len(mapping.skin.parents))
    landmarks = landmark_residuals(mapping, views, parameters).reshape(-1)
    weight = jnp.sqrt(strengths.landmark.astype(landmarks.dtype))
    rest = regularizer_residuals(parameters, estimate, strengths)
    return jnp.concatenate([weight * landmarks, rest])
