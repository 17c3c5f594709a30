"""Motions of our own, free of anyone's data: a walk, a turn on the spot, a sway (S15).

Angles of the joints follow closed curves of the gait cycle; the way of the pelvis follows from the
feet: whatever of them is lowest stays where it is on the floor.
"""

import enum

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from dress_jax.body.skeleton import JOINTS, PARENTS, joint_index
from dress_jax.core.errors import InputError
from dress_jax.motion.chain import joint_places, matrices, world_rotations
from dress_jax.motion.clip import Motion

_STRIDE = 1.15  # two steps of the walk [s]
_SWAY = 2.4  # there and back [s]
_TURN = 4.0  # once around [s]
_STEPS_PER_TURN = 4.0  # strides
_ARMS = 64.0  # arms lowered from the T pose [degrees]
_ELBOWS = 18.0  # bent [degrees]
# Points that may carry the body: the heel from the ankle, the ball and the toes from the foot's
# joint, as shares of the height of that joint above the sole and lengths forward [m].
_HEEL_BACK, _BALL_FORWARD, _TOE_FORWARD = -0.035, 0.0, 0.06
_SMOOTHING = 0.12  # of the way on the floor: a trunk does not follow every joint of its feet [s]
_SOFTNESS = 0.004  # a point this much higher carries e times less [m]


class Procedure(enum.Enum):
    """Motions made here."""

    WALK = "walk"
    TURN = "turn"
    SWAY = "sway"


def procedural_motion(
    procedure: Procedure, joints: Float[np.ndarray, "55 3"], *, frames: int, fps: float
) -> Motion:
    """A motion for a body.

    Args:
        procedure: which.
        joints: of the body in its rest pose, feet on the floor at y = 0 [m].
        frames: how many.
        fps: per second.

    Raises:
        InputError: fewer than one frame, or a rate that is not positive.
    """
    if frames < 1 or not fps > 0.0:
        raise InputError(
            f"{frames} frames at {fps} per second", where=procedure.value, mend="give positive ones"
        )
    # Some frames more at both ends, so that the smoothed way of the pelvis has no ends inside.
    more = int(np.ceil(3.0 * _SMOOTHING * fps)) + 1
    times = np.arange(-more, frames + more) / fps
    make = {Procedure.WALK: _walk, Procedure.TURN: _turn, Procedure.SWAY: _sway}[procedure]
    pose = make(times)
    root = _planted(pose, joints, smoothing=_SMOOTHING * fps)
    kept = slice(more, more + frames)
    root = root[kept] - root[more] * [1.0, 0.0, 1.0]
    return Motion(fps=fps, pose=pose[kept], root=root, name=procedure.value)


def _walk(times: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t 55 3"]:
    phase = 2.0 * np.pi * times / _STRIDE
    turns = _standing(len(times))
    for side, own in (("left", phase), ("right", phase + np.pi)):
        # The second part holds the swinging foot up until it is in front.
        thigh = 0.06 + 0.30 * np.cos(own) + 0.15 * _bump(own, 1.60, 3.0)
        knee = 0.10 + 0.14 * _bump(own, 0.30, 3.0) + 0.80 * _bump(own, 1.35, 2.5)
        # The foot is flat while it carries, its heel rises behind, its toes rise in front.
        pitch = 0.60 * _bump(own, 1.15, 4.0) - 0.22 * _bump(own, -0.10, 5.0)
        _legs(turns, side, thigh=thigh, knee=knee, pitch=pitch, close=7.0)
        _arm(turns, side, swing=-0.06 + 0.30 * np.cos(own), bend=_ELBOWS - 8.0 * np.cos(own))
    # The left hip goes forward with the left leg; the chest and the head do not follow.
    _about(turns, "pelvis", y=-0.08 * np.cos(phase), z=0.035 * np.sin(phase))
    _about(turns, "spine1", y=0.05 * np.cos(phase), z=-0.02 * np.sin(phase))
    _about(turns, "spine2", x=np.full(len(times), 0.02), y=0.05 * np.cos(phase))
    _about(turns, "spine3", y=0.04 * np.cos(phase), z=-0.015 * np.sin(phase))
    _about(turns, "neck", y=-0.06 * np.cos(phase))
    return _as_pose(turns)


def _turn(times: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t 55 3"]:
    """Once around on the spot, with small steps that lift one foot after the other."""
    phase = 2.0 * np.pi * times * _STEPS_PER_TURN / _TURN
    turns = _standing(len(times))
    for side, own in (("left", phase), ("right", phase + np.pi)):
        lift = _bump(own, 0.5, 2.0)
        thigh = 0.05 + 0.30 * lift
        _legs(turns, side, thigh=thigh, knee=0.08 + 0.55 * lift, pitch=0.15 * lift, close=6.0)
        _arm(turns, side, swing=0.08 * np.sin(own), bend=np.full(len(times), _ELBOWS), raised=8.0)
    _about(turns, "spine2", y=np.full(len(times), 0.08))
    _about(turns, "neck", y=np.full(len(times), 0.15))
    _about(turns, "pelvis", y=2.0 * np.pi * times / _TURN)
    return _as_pose(turns)


def _sway(times: Float[np.ndarray, " t"]) -> Float[np.ndarray, "t 55 3"]:
    """Hips from side to side and around, arms rising and falling, feet on the floor."""
    phase = 2.0 * np.pi * times / _SWAY
    turns = _standing(len(times))
    tilt = 0.10 * np.sin(phase)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        # The hip that is up has its knee straight.
        bend = 0.16 - 0.14 * sign * np.sin(phase)
        _legs(turns, side, thigh=0.5 * bend + 0.02, knee=bend, pitch=0.0 * phase, close=5.0)
        # The legs stay upright under a pelvis that tilts.
        _about(turns, f"{side}_hip", z=-tilt)
        _about(turns, f"{side}_ankle", z=0.0 * phase)
        _arm(
            turns,
            side,
            swing=-0.15 + 0.10 * np.sin(phase),
            bend=20.0 + 10.0 * np.cos(phase),
            raised=18.0 + 14.0 * np.sin(0.5 * phase) ** 2,
        )
    _about(turns, "pelvis", y=0.12 * np.cos(phase), z=tilt)
    for spine in ("spine1", "spine2", "spine3"):
        _about(turns, spine, y=-0.06 * np.cos(phase), z=-0.05 * np.sin(phase))
    return _as_pose(turns)


# Pieces of poses

_Turns = dict[str, Rotation]
_Angle = float | np.ndarray


def _standing(frames: int) -> _Turns:
    return {name: Rotation.identity(frames) for name in JOINTS}


def _as_pose(turns: _Turns) -> Float[np.ndarray, "t 55 3"]:
    return np.stack([turns[name].as_rotvec() for name in JOINTS], axis=1)


def _about(turns: _Turns, name: str, *, x: _Angle = 0.0, y: _Angle = 0.0, z: _Angle = 0.0) -> None:
    """Turn a joint about y, then x, then z, after what it has already [rad per frame]."""
    count = len(turns[name])
    angles = np.stack([np.broadcast_to(angle, count) for angle in (y, x, z)], axis=1)
    turns[name] = turns[name] * Rotation.from_euler("YXZ", angles)


def _bump(phase: np.ndarray, place: float, sharpness: float) -> np.ndarray:
    """A smooth hump of height 1 once a cycle, at `place` times pi."""
    return np.exp(sharpness * (np.cos(phase - np.pi * place) - 1.0))


def _legs(turns: _Turns, side: str, *, thigh, knee, pitch, close: float) -> None:
    """A leg: thigh forward, knee bent, the pitch of the foot against the floor [rad]; legs are
    drawn together by `close` [degrees], feet staying level."""
    sign = 1.0 if side == "left" else -1.0
    inward = -sign * np.radians(close)
    _about(turns, f"{side}_hip", x=-thigh)
    _about(turns, f"{side}_hip", z=inward)
    _about(turns, f"{side}_knee", x=knee)
    _about(turns, f"{side}_ankle", x=pitch + thigh - knee)
    _about(turns, f"{side}_ankle", z=-inward)


def _arm(turns: _Turns, side: str, *, swing, bend, raised: float | np.ndarray = 0.0) -> None:
    """An arm: swung back [rad], bent at the elbow, raised from hanging [degrees]."""
    sign = 1.0 if side == "left" else -1.0
    _about(turns, f"{side}_shoulder", x=swing)
    _about(turns, f"{side}_shoulder", z=-sign * np.radians(_ARMS - raised))
    _about(turns, f"{side}_elbow", y=-sign * np.radians(bend))


def _planted(
    pose: Float[np.ndarray, "t 55 3"], joints: Float[np.ndarray, "55 3"], *, smoothing: float
) -> Float[np.ndarray, "t 3"]:
    """Way of the pelvis for which the lowest points of the feet rest on the floor [m].

    Every point of a sole carries with a weight that falls with its height above the lowest one;
    the pelvis moves against the weighted mean of their velocities.

    Args:
        pose: of every frame [rad].
        joints: in the rest pose, the floor at y = 0 [m].
        smoothing: standard deviation of what averages the way on the floor [frames].
    """
    world = world_rotations(PARENTS, matrices(pose))
    places = joint_places(PARENTS, world, joints)
    points = []
    for side in ("left", "right"):
        for name, forward in (
            ("ankle", _HEEL_BACK),
            ("foot", _BALL_FORWARD),
            ("foot", _TOE_FORWARD),
        ):
            joint = joint_index(f"{side}_{name}")
            offset = np.array([0.0, -joints[joint, 1], forward])
            points.append(places[:, joint] + world[:, joint] @ offset)
    soles = np.stack(points, axis=1)
    heights = soles[..., 1]
    weight = np.exp(-(heights - heights.min(axis=1, keepdims=True)) / _SOFTNESS)
    weight /= weight.sum(axis=1, keepdims=True)
    between = 0.5 * (weight[1:] + weight[:-1])
    moved = np.sum(between[..., None] * np.diff(soles, axis=0), axis=1)
    root = np.zeros((len(pose), 3))
    smooth = gaussian_filter1d(moved, smoothing, axis=0, mode="nearest", truncate=3.0)
    root[1:] = -np.cumsum(smooth, axis=0)
    root[:, 1] = -joints[0, 1] - np.sum(weight * heights, axis=1)
    return root
