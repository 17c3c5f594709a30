"""What is reconstructed: the model-to-world matrix, the pose and the shape of a body (S7.3, S7.13).

    x = S (V(theta, beta) - p) + t

with S the scale, V the posed model, p its pelvis and t the pelvis in the world. Row 0 of the pose
is the rotation R, about the pelvis. Scaled about the pelvis, a body changes its size and stays
where it is; about the model's origin, at the feet, scale and place would be entangled.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from dress_jax.body.model import BodyModel, BodyState, forward
from dress_jax.body.skeleton import JOINTS, joint_index
from dress_jax.core.errors import InputError
from dress_jax.core.pytree import pytree
from dress_jax.reconstruction.options import Free

FACE = ("jaw", "left_eye", "right_eye")
"""Joints that no landmark of the table tells anything about; they keep their rotation."""


@pytree
class BodyParameters:
    """A body in the world, or a derivative in it; j joints, b shape components.

    Attributes:
        log_scale: logarithm of the scale S, so that it stays positive, ().
        translation: the pelvis in the world [m], (3,).
        pose: rotation vectors against the parent joint [rad], (j, 3); row 0 is the global rotation.
        shape: coefficients (standard deviations), (b,).
    """

    log_scale: Float[Array, ""]
    translation: Float[Array, "3"]
    pose: Float[Array, "j 3"]
    shape: Float[Array, " b"]

    @property
    def scale(self) -> float:
        """The scale S."""
        return float(np.exp(np.asarray(self.log_scale, np.float64)))


def body_in_world(model: BodyModel, parameters: BodyParameters) -> BodyState:
    """Vertices and joints in the world [m]; differentiable in all parameters."""
    dtype = parameters.pose.dtype
    posed = forward(model, parameters.pose, parameters.shape, jnp.zeros(3, dtype))
    pelvis, scale = posed.joints[0][None, :], jnp.exp(parameters.log_scale)
    place = parameters.translation[None, :]
    return BodyState(
        vertices=scale * (posed.vertices - pelvis) + place,
        joints=scale * (posed.joints - pelvis) + place,
    )


def rest_pelvis(model: BodyModel, shape: Float[np.ndarray, " b"]) -> Float[np.ndarray, "3"]:
    """The pelvis of the model before it is posed [m]; the global rotation leaves it there."""
    directions = np.asarray(model.joint_shapedirs)[0, :, : len(shape)]
    return np.asarray(model.joint_template)[0] + np.sum(directions * shape[None, :], axis=1)


def model_translation(model: BodyModel, parameters: BodyParameters) -> Float[np.ndarray, "3"]:
    """The translation c of the equal form x = S (V + c), in which body files are often written."""
    pelvis = rest_pelvis(model, np.asarray(parameters.shape))
    return np.asarray(parameters.translation) / parameters.scale - pelvis


def make_parameters(
    model: BodyModel,
    *,
    pose: Float[np.ndarray, "j 3"] | None = None,
    shape: Float[np.ndarray, " b"] | None = None,
    scale: float = 1.0,
    translation: Float[np.ndarray, "3"] | None = None,
) -> BodyParameters:
    """Parameters from arrays, checked once on the host.

    Args:
        model: the body; its joints must be the 55 of `body.skeleton`.
        pose: rotation vectors [rad]; zeros when None.
        shape: the first shape coefficients; the rest, or all when None, are zero.
        scale: the scale S.
        translation: the pelvis in the world [m]; the origin when None.

    Raises:
        InputError: a body of other joints, wrong shapes, or numbers that are not finite.
    """
    joints, components = len(model.parents), model.shapedirs.shape[2]
    if joints != len(JOINTS):
        raise InputError(
            f"the body has {joints} joints, not {len(JOINTS)}",
            where="body reconstruction",
            mend="give an SMPL-X-shaped body",
        )
    turned = np.zeros((joints, 3)) if pose is None else np.asarray(pose, np.float64)
    given = np.zeros(0) if shape is None else np.asarray(shape, np.float64)
    place = np.zeros(3) if translation is None else np.asarray(translation, np.float64)
    if turned.shape != (joints, 3) or given.ndim != 1 or place.shape != (3,):
        raise InputError(
            f"pose {turned.shape}, shape {given.shape} and translation {place.shape} do not fit "
            f"({joints}, 3), (b,) and (3,)",
            where="body estimate",
        )
    if len(given) > components:
        raise InputError(
            f"{len(given)} shape coefficients, but the body has {components} components",
            where="body estimate",
            mend="load more components, or give fewer coefficients",
        )
    if not all(np.all(np.isfinite(array)) for array in (turned, given, place)):
        raise InputError("holds a number that is not finite", where="body estimate")
    if not (np.isfinite(scale) and scale > 0.0):
        raise InputError(f"the scale is {scale}", where="body estimate", mend="give one above zero")
    full = np.zeros(components)
    full[: len(given)] = given
    real = model.template.dtype
    return BodyParameters(
        log_scale=jnp.asarray(np.log(scale), real),
        translation=jnp.asarray(place, real),
        pose=jnp.asarray(turned, real),
        shape=jnp.asarray(full, real),
    )


def pack(parameters: BodyParameters) -> Float[Array, " u"]:
    """All parameters as one vector: scale, translation, pose, shape."""
    return jnp.concatenate(
        [
            parameters.log_scale[None],
            parameters.translation,
            parameters.pose.reshape(-1),
            parameters.shape,
        ]
    )


def unpack(vector: Float[Array, " u"], joints: int) -> BodyParameters:
    """The inverse of `pack`."""
    return BodyParameters(
        log_scale=vector[0],
        translation=vector[1:4],
        pose=vector[4 : 4 + 3 * joints].reshape(joints, 3),
        shape=vector[4 + 3 * joints :],
    )


def free_parameters(free: Free, components: int) -> BodyParameters:
    """One where a number may change, zero elsewhere; float64 numpy arrays."""
    pose = np.full((len(JOINTS), 3), float(free.pose))
    pose[0] = float(free.rotation)
    hands = [k for k, name in enumerate(JOINTS) if name[-1].isdigit() and "spine" not in name]
    pose[hands] = float(free.pose and free.hands)
    pose[[joint_index(name) for name in FACE]] = 0.0
    return BodyParameters(
        log_scale=np.asarray(float(free.scale)),  # type: ignore[arg-type]
        translation=np.full(3, float(free.translation)),  # type: ignore[arg-type]
        pose=pose,  # type: ignore[arg-type]
        shape=np.full(components, float(free.shape)),  # type: ignore[arg-type]
    )


def free_columns(free: Free, components: int) -> Bool[np.ndarray, " u"]:
    """Which entries of the packed vector may change."""
    return np.asarray(pack(free_parameters(free, components))) > 0.0


def wrap_rotations(pose: Float[np.ndarray, "j 3"]) -> Float[np.ndarray, "j 3"]:
    """The same rotations by vectors no longer than pi: beyond, at 2 pi, they have no derivative."""
    angle = np.linalg.norm(pose, axis=1, keepdims=True)
    turns = np.round(angle / (2.0 * np.pi))
    safe = np.where(angle > 0.0, angle, 1.0)
    return np.where(turns > 0.0, pose * (1.0 - 2.0 * np.pi * turns / safe), pose)
