"""Parameters of a body model as a picture's tool estimated them, and their way into our world.

    x_world = W s (v(pose, shape) + transl) + o

with v the posed body of the model, s a scale, W a rotation and o an origin. Tools differ in W and
s: network regressors work in the camera's frame (x right, y down, z away), MagicMan scales the
moved body and then turns it. Keeping W, s, o beside the parameters loses nothing, and converting
them needs no body model (checklist S6.4, S7.1).
"""

import dataclasses
import enum
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dress_jax.body.model import BodyModel, forward
from dress_jax.body.skeleton import JOINTS
from dress_jax.capture.checks import numbers
from dress_jax.core.errors import InputError

CAMERA_TO_WORLD = np.diag([1.0, -1.0, -1.0])
"""From a camera that sees the front, with x right, y down, z away, into our world."""
BODY_JOINTS, HAND_JOINTS = 21, 15
_ORTHONORMAL = 1e-5
_LEAST_LENGTH = 1e-8


class BodyFamily(enum.Enum):
    """The model whose shape space the coefficients belong to; the poses agree."""

    SMPLX = "smplx"
    SMPLH = "smplh"
    SMPL = "smpl"


@dataclasses.dataclass(frozen=True, eq=False)
class BodyEstimate:
    """Pose and shape of an SMPL-X body, or of one of its relatives.

    Rotations are axis times angle [rad]; joints as in `body.skeleton`. What a tool does not
    estimate is zero.

    Args:
        betas: coefficients of shape, shape (b,).
        global_orient: of the whole body, in the tool's frame, shape (3,).
        body_pose: of the joints 1 to 21, shape (21, 3).
        left_hand_pose, right_hand_pose: of the fingers, without the model's mean hand, shape
            (15, 3).
        jaw_pose, left_eye_pose, right_eye_pose: shape (3,).
        expression: coefficients, shape (e,).
        transl: in the tool's frame, before the scale [m], shape (3,).
        scale: of the posed and translated body, positive.
        to_world: W, a rotation, shape (3, 3).
        origin: o [m], shape (3,).
        family: the model of `betas`.

    Raises:
        InputError: wrong shapes, numbers that are not finite, a scale that is not positive, or a
            matrix that is no rotation.
    """

    betas: Float[np.ndarray, " b"]
    global_orient: Float[np.ndarray, "3"]
    body_pose: Float[np.ndarray, "21 3"]
    left_hand_pose: Float[np.ndarray, "15 3"]
    right_hand_pose: Float[np.ndarray, "15 3"]
    jaw_pose: Float[np.ndarray, "3"]
    left_eye_pose: Float[np.ndarray, "3"]
    right_eye_pose: Float[np.ndarray, "3"]
    expression: Float[np.ndarray, " e"]
    transl: Float[np.ndarray, "3"]
    scale: float = 1.0
    to_world: Float[np.ndarray, "3 3"] = dataclasses.field(default_factory=lambda: np.eye(3))
    origin: Float[np.ndarray, "3"] = dataclasses.field(default_factory=lambda: np.zeros(3))
    family: BodyFamily = BodyFamily.SMPLX

    def __post_init__(self) -> None:
        shapes: dict[str, tuple[int | None, ...]] = {
            "betas": (None,),
            "global_orient": (3,),
            "body_pose": (BODY_JOINTS, 3),
            "left_hand_pose": (HAND_JOINTS, 3),
            "right_hand_pose": (HAND_JOINTS, 3),
            "jaw_pose": (3,),
            "left_eye_pose": (3,),
            "right_eye_pose": (3,),
            "expression": (None,),
            "transl": (3,),
            "to_world": (3, 3),
            "origin": (3,),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, numbers(f"body, {name}", getattr(self, name), shape))
        scale = float(numbers("body, scale", self.scale, ()))
        if scale <= 0.0:
            raise InputError(f"is {scale}; it has to be positive", where="body, scale")
        object.__setattr__(self, "scale", scale)
        if not is_rotation(self.to_world):
            raise InputError("is no rotation", where="body, to_world")

    @property
    def pose(self) -> Float[np.ndarray, "55 3"]:
        """All joints in the order of `body.skeleton` [rad]."""
        parts = (
            self.global_orient[None],
            self.body_pose,
            self.jaw_pose[None],
            self.left_eye_pose[None],
            self.right_eye_pose[None],
            self.left_hand_pose,
            self.right_hand_pose,
        )
        return np.concatenate(parts)


def body_estimate(
    pose: Float[np.ndarray, "j 3"],
    betas: Float[np.ndarray, " b"],
    transl: Float[np.ndarray, "3"],
    *,
    family: BodyFamily,
    **more: Any,
) -> BodyEstimate:
    """An estimate from all joints of a model at once.

    Args:
        pose: axis times angle [rad]: 55 joints of SMPL-X; 52 of SMPL-H, which has no jaw and no
            eyes; 24 of SMPL, whose last two (the hands as a whole) have no counterpart.
        betas, transl, family, more: see `BodyEstimate`.

    Raises:
        InputError: another number of joints.
    """
    pose = np.asarray(pose, float)
    counts = {BodyFamily.SMPLX: len(JOINTS), BodyFamily.SMPLH: 52, BodyFamily.SMPL: 24}
    if pose.shape != (counts[family], 3):
        raise InputError(
            f"has shape {pose.shape}, {family.value} has {counts[family]} joints",
            where="body, pose",
        )
    face, hands = np.zeros((3, 3)), np.zeros((2 * HAND_JOINTS, 3))
    if family is BodyFamily.SMPLX:
        face, hands = pose[22:25], pose[25:]
    elif family is BodyFamily.SMPLH:
        hands = pose[22:]
    return BodyEstimate(
        betas=betas,
        global_orient=pose[0],
        body_pose=pose[1:22],
        left_hand_pose=hands[:HAND_JOINTS],
        right_hand_pose=hands[HAND_JOINTS:],
        jaw_pose=face[0],
        left_eye_pose=face[1],
        right_eye_pose=face[2],
        expression=more.pop("expression", np.zeros(0)),
        transl=transl,
        family=family,
        **more,
    )


def world_pose(
    estimate: BodyEstimate, pelvis: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "55 3"], Float[np.ndarray, "3"]]:
    """Pose and translation with which `body.model.forward` stands the body in our world.

    A model turns about its pelvis J, not about the origin, so that turning its frame changes its
    translation as well:  R' = W R,  t' = W (J + t) + o / s - J.  The world body is `scale` times
    what `forward` gives.

    Args:
        estimate: parameters in the tool's frame.
        pelvis: rest position of joint 0 for the estimate's shape [m], shape (3,).
    """
    pose = estimate.pose
    turned = estimate.to_world @ Rotation.from_rotvec(pose[0]).as_matrix()
    pose[0] = Rotation.from_matrix(turned).as_rotvec()
    moved = estimate.to_world @ (pelvis + estimate.transl)
    return pose, moved + estimate.origin / estimate.scale - pelvis


def world_vertices(estimate: BodyEstimate, model: BodyModel) -> Float[np.ndarray, "n 3"]:
    """The estimated body in our world [m], on a model that the user has.

    Args:
        estimate: its shape coefficients must be those of `model`.
        model: from `io.bodies.load_body_model`.

    Raises:
        InputError: there are more shape coefficients than the model has.
    """
    real = model.template.dtype
    count, components = len(estimate.betas), model.shapedirs.shape[2]
    if count > components:
        raise InputError(
            f"has {count} shape coefficients, the model {components}", where="body, betas"
        )
    # Always the full number, so that one compiled program serves every estimate.
    betas = jnp.asarray(np.pad(estimate.betas, (0, components - count)), real)
    pelvis = model.joint_template[0] + model.joint_shapedirs[0] @ betas
    pose, translation = world_pose(estimate, np.asarray(pelvis, np.float64))
    state = forward(model, jnp.asarray(pose, real), betas, jnp.asarray(translation, real))
    return estimate.scale * np.asarray(state.vertices, np.float64)


def to_axis_angle(
    values: Float[np.ndarray, "*any"], joints: int, *, where: str
) -> Float[np.ndarray, "j 3"]:
    """Axis times angle [rad] of rotations in any of three forms, told apart by their number.

    Args:
        values: per joint 3 numbers (axis times angle), 6 (the first two columns of the matrix,
            row by row: r00 r01 r10 r11 r20 r21) or 9 (the matrix, row by row), any shape.
        joints: how many.
        where: the field, for messages.

    Raises:
        InputError: another number of values, or columns that span no plane.
    """
    flat = numbers(where, np.ravel(np.asarray(values, float)), (None,))
    if flat.size == 3 * joints:
        return flat.reshape(joints, 3)
    if flat.size == 9 * joints:
        matrices = flat.reshape(joints, 3, 3)
    elif flat.size == 6 * joints:
        matrices = _complete(flat.reshape(joints, 3, 2), where)
    else:
        raise InputError(
            f"holds {flat.size} numbers for {joints} joints",
            where=where,
            mend="give 3 (axis times angle), 6 (two columns) or 9 (matrix) per joint",
        )
    if not all(is_rotation(matrix, tolerance=1e-3) for matrix in matrices):
        raise InputError("holds a matrix that is no rotation", where=where)
    return Rotation.from_matrix(matrices).as_rotvec()


def is_rotation(matrix: Float[np.ndarray, "3 3"], *, tolerance: float = _ORTHONORMAL) -> bool:
    """Whether a matrix is orthonormal and keeps orientation."""
    error = np.abs(matrix @ matrix.T - np.eye(3)).max()
    return bool(error <= tolerance and np.linalg.det(matrix) > 0.0)


def _complete(columns: Float[np.ndarray, "j 3 2"], where: str) -> Float[np.ndarray, "j 3 3"]:
    """Orthonormal matrices out of two columns each, by Gram and Schmidt."""
    first, second = columns[..., 0], columns[..., 1]
    length = np.linalg.norm(first, axis=1, keepdims=True)
    first = first / np.maximum(length, _LEAST_LENGTH)
    second = second - np.sum(first * second, axis=1, keepdims=True) * first
    height = np.linalg.norm(second, axis=1, keepdims=True)
    if min(length.min(), height.min()) < _LEAST_LENGTH:
        raise InputError("holds two columns that span no plane", where=where)
    second = second / height
    return np.stack([first, second, np.cross(first, second)], axis=2)
