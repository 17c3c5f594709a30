"""A motion as data: joint rotations and the way of the pelvis, frame by frame (S15).

World frame as everywhere: +y up, +z front, +x the wearer's left, the floor at y = 0.
"""

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dress_jax.body.skeleton import JOINTS
from dress_jax.core.errors import InputError


@dataclasses.dataclass(frozen=True)
class Motion:
    """Poses of the 55-joint skeleton at a constant rate.

    Args:
        fps: frames per second.
        pose: rotation of each joint against its parent, axis times angle [rad], (t, 55, 3); row 0
            turns the whole body about its pelvis.
        root: where the pelvis is, less where it is when the body stands in its rest pose at the
            origin with its feet on the floor [m], (t, 3).
        name: what it is, for reports.
    """

    fps: float
    pose: Float[np.ndarray, "t 55 3"]
    root: Float[np.ndarray, "t 3"]
    name: str = "motion"

    def __post_init__(self) -> None:
        count = len(self.root)
        if self.pose.shape != (count, len(JOINTS), 3) or self.root.shape != (count, 3) or not count:
            raise InputError(
                f"poses of shape {self.pose.shape} and a root of shape {self.root.shape}",
                where=self.name,
                mend=f"give at least one frame, (t, {len(JOINTS)}, 3) and (t, 3)",
            )
        if not (np.isfinite(self.pose).all() and np.isfinite(self.root).all()):
            bad = np.flatnonzero(
                ~(np.isfinite(self.pose).all(axis=(1, 2)) & np.isfinite(self.root).all(axis=1))
            )
            raise InputError(
                "a number is not finite",
                where=f"{self.name}, frame {bad[0]}",
                mend="cut such frames out",
            )
        if not (np.isfinite(self.fps) and self.fps > 0.0):
            raise InputError(
                f"the rate is {self.fps} frames per second",
                where=self.name,
                mend="give a positive number",
            )

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.root)

    @property
    def seconds(self) -> float:
        """From the first frame to the last."""
        return (self.frames - 1) / self.fps

    def at(self, times: Float[np.ndarray, " k"]) -> "Motion":
        """Poses at any times, each joint turning at a constant rate between two frames.

        Args:
            times: [s] after the first frame, within the clip; the result keeps the rate by name
                only, so times of another spacing belong to `resampled`.

        Raises:
            InputError: a time lies outside of the clip.
        """
        times = np.asarray(times, np.float64)
        place = times * self.fps
        slack = 1e-9 * self.frames
        if len(times) and not (place.min() >= -slack and place.max() <= self.frames - 1 + slack):
            raise InputError(
                f"times from {times.min():.3f} to {times.max():.3f} s",
                where=self.name,
                mend=f"the clip runs from 0 to {self.seconds:.3f} s",
            )
        first = np.clip(np.floor(place).astype(int), 0, max(self.frames - 2, 0))
        second = np.minimum(first + 1, self.frames - 1)
        part = place - first
        return dataclasses.replace(
            self,
            pose=blended(self.pose[first], self.pose[second], part),
            root=self.root[first] + part[:, None] * (self.root[second] - self.root[first]),
        )

    def resampled(self, fps: float) -> "Motion":
        """The same motion at another rate; its last frame may lie up to a frame earlier."""
        if fps == self.fps:
            return self
        count = int(np.floor(self.seconds * fps + 1e-9)) + 1
        return dataclasses.replace(self.at(np.arange(count) / fps), fps=fps)


def blended(
    first: Float[np.ndarray, "t 55 3"],
    second: Float[np.ndarray, "t 55 3"],
    part: Float[np.ndarray, " t"],
) -> Float[np.ndarray, "t 55 3"]:
    """Poses between two, along the shortest rotation of each joint.

    Args:
        first, second: [rad].
        part: of the way from the first to the second, per frame.
    """
    start = Rotation.from_rotvec(first.reshape(-1, 3))
    turn = (start.inv() * Rotation.from_rotvec(second.reshape(-1, 3))).as_rotvec()
    turn = np.repeat(part, first.shape[1])[:, None] * turn
    return (start * Rotation.from_rotvec(turn)).as_rotvec().reshape(first.shape)


def heading(pose: Float[np.ndarray, "55 3"]) -> float:
    """Where a body faces, turned about +y from +z [rad]; of one that lies, where its head points.

    Args:
        pose: of one frame [rad].
    """
    turned = Rotation.from_rotvec(pose[0])
    forward = turned.apply([0.0, 0.0, 1.0])
    if np.hypot(forward[0], forward[2]) < 1e-3:
        forward = turned.apply([0.0, 1.0, 0.0])
    return float(np.arctan2(forward[0], forward[2]))


def placed(motion: Motion, *, facing: float = 0.0) -> Motion:
    """The motion turned and moved on the floor so that it begins at the origin, facing a way.

    Args:
        motion: of any place and direction.
        facing: heading of the first frame, turned about +y from +z [rad].
    """
    turn = Rotation.from_rotvec([0.0, facing - heading(motion.pose[0]), 0.0])
    pose = np.array(motion.pose)
    pose[:, 0] = (turn * Rotation.from_rotvec(pose[:, 0])).as_rotvec()
    begin = motion.root[0] * [1.0, 0.0, 1.0]
    return dataclasses.replace(motion, pose=pose, root=turn.apply(motion.root - begin))


def lifted(motion: Motion, lowest: Float[np.ndarray, " t"], *, share: float = 0.02) -> Motion:
    """The motion raised or lowered as a whole, so that its feet meet the floor.

    Args:
        motion: the motion.
        lowest: height of the lowest point of the body in every frame [m].
        share: of the frames that may reach below the floor: a few frames of noise do not lift all.
    """
    floor = float(np.quantile(lowest, share))
    return dataclasses.replace(motion, root=motion.root - [0.0, floor, 0.0])


def eased(
    motion: Motion,
    pose: Float[np.ndarray, "55 3"],
    root: Float[np.ndarray, "3"],
    *,
    seconds: float,
) -> Motion:
    """The motion with a smooth way in: it begins at rest in a pose and blends into its course.

    While the blend lasts, the motion's own time speeds up from rest, so velocity is continuous at
    both ends, and half of the blend's seconds are used up.

    Args:
        motion: what follows.
        pose, root: of the beginning [rad, m].
        seconds: of the blend, up to twice the clip.

    Raises:
        InputError: the clip is too short for the blend.
    """
    if seconds < 0.0 or 0.5 * seconds > motion.seconds:
        raise InputError(
            f"a blend of {seconds} s into a clip of {motion.seconds:.3f} s",
            where=motion.name,
            mend="give between 0 and twice the length of the clip",
        )
    count = int(np.floor((motion.seconds + 0.5 * seconds) * motion.fps + 1e-9)) + 1
    times = np.arange(count) / motion.fps
    u = np.minimum(times / seconds, 1.0) if seconds > 0.0 else np.minimum(times * motion.fps, 1.0)
    own = np.where(u < 1.0, seconds * (u**3 - 0.5 * u**4), times - 0.5 * seconds)
    weight = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    course = motion.at(np.clip(own, 0.0, motion.seconds))
    begin = np.broadcast_to(pose, course.pose.shape)
    return dataclasses.replace(
        motion,
        pose=blended(begin, course.pose, weight),
        root=root + weight[:, None] * (course.root - root),
    )
