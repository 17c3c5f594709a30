"""Named poses of the 55-joint body and interpolation between poses."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from dress_jax.body.skeleton import JOINTS, joint_index

Pose = Float[np.ndarray, "55 3"]


def t_pose() -> Pose:
    """Arms straight out to the sides: all rotations zero."""
    return np.zeros((len(JOINTS), 3))


def a_pose(*, angle: float = 45.0) -> Pose:
    """Arms lowered by `angle` [degrees] from the T pose, sideways."""
    return _arms(lower=angle)


def relaxed_pose() -> Pose:
    """Arms hanging beside the body, clear of it, elbows slightly bent."""
    return _arms(lower=65.0, bend=10.0)


def arms_up_pose() -> Pose:
    """Arms raised to a V; the collar bones take a third of the lift."""
    return _arms(lower=-45.0, collar=1.0 / 3.0)


POSES: dict[str, Callable[[], Pose]] = {
    "t": t_pose,
    "a": a_pose,
    "relaxed": relaxed_pose,
    "arms_up": arms_up_pose,
}


def named_pose(name: str) -> Pose:
    """A pose by name.

    Returns:
        Axis times angle per joint [rad], shape (55, 3).

    Raises:
        ValueError: there is no such pose; the message lists all names.
    """
    if name not in POSES:
        raise ValueError(f"there is no pose '{name}'; the poses are {', '.join(POSES)}")
    return POSES[name]()


def interpolate_poses(start: Pose, end: Pose, *, steps: int) -> Float[np.ndarray, "steps 55 3"]:
    """Poses from `start` to `end`, both included, each joint turning at a constant rate (S8.6).

    Args:
        start: axis times angle per joint [rad], shape (55, 3).
        end: likewise.
        steps: number of poses, at least 2.

    Raises:
        ValueError: fewer than two steps.
    """
    from scipy.spatial.transform import Rotation

    if steps < 2:
        raise ValueError(f"an interpolation needs at least two steps, not {steps}")
    first = Rotation.from_rotvec(np.asarray(start))
    # Along the shortest rotation between the two, not along the difference of the vectors.
    turn = (first.inv() * Rotation.from_rotvec(np.asarray(end))).as_rotvec()
    return np.stack(
        [
            (first * Rotation.from_rotvec(fraction * turn)).as_rotvec()
            for fraction in np.linspace(0.0, 1.0, steps)
        ]
    )


def _arms(*, lower: float, collar: float = 0.0, bend: float = 0.0) -> Pose:
    """Arms turned down about the front axis [degrees]; `bend` turns the forearms forward."""
    pose = t_pose()
    for side, sign in (("left", -1.0), ("right", 1.0)):
        pose[joint_index(f"{side}_collar"), 2] = sign * np.radians(lower * collar)
        pose[joint_index(f"{side}_shoulder"), 2] = sign * np.radians(lower * (1.0 - collar))
        pose[joint_index(f"{side}_elbow"), 1] = sign * np.radians(bend)
    return pose
