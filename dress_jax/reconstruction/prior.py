"""What keeps a body human where pictures leave it open, when there is no estimate to stay near.

    E = sum_j |theta_j / sigma_j|^2 + sum_j |excess(theta_j) / 5 deg|^2 + |beta|^2

with sigma a quarter of a joint's range, and the excess how far a rotation vector's components leave
the range. The ranges are general anatomical knowledge, the ranges of motion that goniometry
textbooks give for adults, rounded and a little widened: the components of a rotation vector are
not quite clinical angles, and some motions are shared by several joints (spine, neck and head;
collar and shoulder; elbow and wrist).
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from dress_jax.body.skeleton import JOINTS

LIMIT_SOFTNESS = np.radians(5.0)
"""Excess over a range that costs as much as one standard deviation of the shape [rad]."""

Range = tuple[float, float]

# About x, y, z from the T pose [degrees], +x to the wearer's left, +y up, +z to the front; of the
# left side, the right one being its mirror image. Bending forward turns about +x for trunk, neck
# and head, the knee bends about +x, the hip forward about -x, the left elbow about -y, and the left
# arm is lowered about -z.
_MIDDLE: dict[str, tuple[Range, Range, Range]] = {
    "spine1": ((-20, 35), (-25, 25), (-20, 20)),
    "spine2": ((-20, 35), (-25, 25), (-20, 20)),
    "spine3": ((-20, 35), (-25, 25), (-20, 20)),
    "neck": ((-30, 35), (-45, 45), (-25, 25)),
    "head": ((-30, 35), (-40, 40), (-25, 25)),
    "jaw": ((-5, 35), (-10, 10), (-5, 5)),
}
_LEFT: dict[str, tuple[Range, Range, Range]] = {
    "hip": ((-120, 25), (-45, 45), (-30, 45)),
    "knee": ((-5, 150), (-15, 15), (-10, 10)),
    "ankle": ((-25, 50), (-25, 25), (-30, 30)),
    "foot": ((-60, 30), (-5, 5), (-5, 5)),
    "collar": ((-15, 15), (-25, 25), (-15, 45)),
    "shoulder": ((-90, 90), (-135, 45), (-100, 100)),
    "elbow": ((-90, 90), (-150, 10), (-15, 15)),
    "wrist": ((-45, 45), (-35, 35), (-80, 75)),
    "eye": ((-30, 30), (-30, 30), (-5, 5)),
}
_FINGER: tuple[Range, Range, Range] = ((-20, 20), (-25, 25), (-100, 30))
_THUMB: tuple[Range, Range, Range] = ((-45, 45), (-70, 70), (-60, 60))


def joint_range(joint: str) -> Float[np.ndarray, "2 3"]:
    """Lowest and highest components of a joint's rotation vector [rad]; infinite for the pelvis."""
    if joint == "pelvis":
        return np.array([[-np.inf] * 3, [np.inf] * 3])
    if joint in _MIDDLE:
        return np.radians(np.array(_MIDDLE[joint]).T)
    side, name = joint.split("_")
    own = _LEFT.get(name, _THUMB if name.startswith("thumb") else _FINGER)
    low, high = np.radians(np.array(own).T)
    if side == "left":
        return np.stack([low, high])
    mirror = np.array([1.0, -1.0, -1.0])  # of a rotation vector, in the plane x = 0
    return np.sort(np.stack([mirror * low, mirror * high]), axis=0)


def pose_limits() -> tuple[Float[np.ndarray, "55 3"], Float[np.ndarray, "55 3"]]:
    """`joint_range` of all joints, lowest and highest."""
    ranges = np.stack([joint_range(joint) for joint in JOINTS])
    return ranges[:, 0], ranges[:, 1]


def prior_residuals(pose: Float[Array, "55 3"], shape: Float[Array, " b"]) -> Float[Array, " r"]:
    """Numbers whose squares add up to the prior; the global rotation is free.

    Args:
        pose: rotation vectors [rad].
        shape: coefficients (standard deviations).
    """
    low, high = (jnp.asarray(limit[1:], pose.dtype) for limit in pose_limits())
    joints = pose[1:]
    excess = jnp.maximum(joints - high, 0.0) + jnp.minimum(joints - low, 0.0)
    return jnp.concatenate(
        [
            (4.0 * joints / (high - low)).reshape(-1),
            (excess / LIMIT_SOFTNESS).reshape(-1),
            shape,
        ]
    )
