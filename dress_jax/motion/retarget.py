"""Motions of other skeletons on ours: limbs point where theirs point (S15).

A joint's world rotation in the source, R, turns its rest pose. Where the rest poses differ, ours is
first turned into theirs: R A, with A the smallest rotation that takes our limb's direction at rest
to theirs. Then the limb points where it points in the source, whatever the two rest poses are.
Hands go with their forearms; trunk, head and feet keep R, because a foot that is flat at rest in
both skeletons has to be flat where the source's is. The way of the pelvis is scaled by the length
of the legs, so that the feet do not slide.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from dress_jax.body.skeleton import JOINTS, PARENTS, joint_index
from dress_jax.core.errors import InputError
from dress_jax.motion.chain import local_rotations, matrices, vectors, world_rotations
from dress_jax.motion.clip import Motion

# Joints whose limb is aligned, and the joint where the limb ends.
LIMBS = {
    f"{side}_{joint}": f"{side}_{end}"
    for side in ("left", "right")
    for joint, end in (
        ("hip", "knee"),
        ("knee", "ankle"),
        ("shoulder", "elbow"),
        ("elbow", "wrist"),
    )
}
# What takes the alignment of the joint above it.
_FOLLOWS = ("wrist", "index", "middle", "pinky", "ring", "thumb")


@dataclasses.dataclass(frozen=True)
class SourceMotion:
    """A motion on another skeleton with joints of the same meaning.

    Args:
        fps: frames per second.
        world: rotations against the world, in our frame (+y up), of our joints, (t, 55, 3, 3);
            joints that the source lacks turn with their parents.
        root: way of the pelvis in our frame, in units of the source, (t, 3).
        leg_length: of the source, hip to knee to ankle, in the same units.
        rest: unit directions of the limbs at rest in our frame, by joint of `LIMBS`; limbs that are
            left out are at rest as ours are.
        name: for reports.
    """

    fps: float
    world: Float[np.ndarray, "t 55 3 3"]
    root: Float[np.ndarray, "t 3"]
    leg_length: float
    rest: dict[str, Float[np.ndarray, "3"]]
    name: str = "motion"


def leg_length(joints: Float[np.ndarray, "55 3"]) -> float:
    """From hip to knee to ankle, the mean of both legs [m].

    Args:
        joints: in the rest pose [m].
    """
    return 0.5 * sum(
        float(
            np.linalg.norm(joints[joint_index(f"{side}_{b}")] - joints[joint_index(f"{side}_{a}")])
        )
        for side in ("left", "right")
        for a, b in (("hip", "knee"), ("knee", "ankle"))
    )


def retarget(source: SourceMotion, joints: Float[np.ndarray, "55 3"]) -> Motion:
    """A motion on a body of ours.

    The height of the pelvis is relative to the source's own origin; `clip.lifted` puts the feet
    onto the floor.

    Args:
        source: the motion.
        joints: of our body in its rest pose [m].

    Raises:
        InputError: the source has no legs to compare with.
    """
    if not (np.isfinite(source.leg_length) and source.leg_length > 0.0):
        raise InputError(
            f"the legs of the skeleton are {source.leg_length} long",
            where=source.name,
            mend="give a skeleton with hips, knees and ankles apart from each other",
        )
    turned = {joint: np.eye(3) for joint in range(len(JOINTS))}
    for name, end in LIMBS.items():
        if name in source.rest:
            own = joints[joint_index(end)] - joints[joint_index(name)]
            if own.any():  # a body may lack a limb; its joints are then at one place
                turned[joint_index(name)] = rotation_between(own, source.rest[name])
    for joint, name in enumerate(JOINTS):
        if any(part in name for part in _FOLLOWS):
            turned[joint] = turned[PARENTS[joint]]
    aligned = np.stack([turned[joint] for joint in range(len(JOINTS))])
    world = source.world @ aligned
    scale = leg_length(joints) / source.leg_length
    return Motion(
        fps=source.fps,
        pose=vectors(local_rotations(PARENTS, world)),
        root=scale * source.root,
        name=source.name,
    )


def rotation_between(
    first: Float[np.ndarray, "3"], second: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3 3"]:
    """The smallest rotation that takes one direction to another.

    Opposite directions have no smallest one; half a turn about some axis across them is taken.
    """
    a, b = (np.asarray(v, np.float64) / np.linalg.norm(v) for v in (first, second))
    cosine = float(a @ b)
    if cosine < -1.0 + 1e-12:
        across = np.cross(a, np.eye(3)[int(np.argmin(np.abs(a)))])
        across /= np.linalg.norm(across)
        return 2.0 * np.outer(across, across) - np.eye(3)
    cross = np.cross(a, b)
    skew = np.array(
        [[0.0, -cross[2], cross[1]], [cross[2], 0.0, -cross[0]], [-cross[1], cross[0], 0.0]]
    )
    return np.eye(3) + skew + skew @ skew / (1.0 + cosine)


# The SMPL family

SMPL_LEG_LENGTH = 0.78
"""Of the mean SMPL and SMPL-X bodies, about; a clip's shape coefficients are not looked at [m]."""


def _degrees(*, out: float = 0.0, back: float = 0.0, down: bool) -> Float[np.ndarray, "3"]:
    """Direction of a left limb near straight down, or near straight to the side."""
    if down:
        return np.array([np.tan(np.radians(out)), -1.0, -np.tan(np.radians(back))])
    return np.array([1.0, np.tan(np.radians(out)), -np.tan(np.radians(back))])


# The rest pose of the SMPL family in whole degrees: a T pose with the thighs a little apart, the
# shanks and the upper arms a little back.
_SMPL_LEFT = {
    "hip": _degrees(out=5.0, back=1.0, down=True),
    "knee": _degrees(out=-2.0, back=6.0, down=True),
    "shoulder": _degrees(out=-3.0, back=6.0, down=False),
    "elbow": _degrees(out=2.0, back=0.0, down=False),
}


def smpl_rest() -> dict[str, Float[np.ndarray, "3"]]:
    """Directions of the limbs of the SMPL family at rest."""
    mirrored = np.array([-1.0, 1.0, 1.0])
    return {f"left_{name}": v for name, v in _SMPL_LEFT.items()} | {
        f"right_{name}": mirrored * v for name, v in _SMPL_LEFT.items()
    }


def smpl_motion(
    pose: Float[np.ndarray, "t 55 3"],
    root: Float[np.ndarray, "t 3"],
    *,
    fps: float,
    z_up: bool,
    name: str,
    same_rest: bool = False,
) -> SourceMotion:
    """A motion of an SMPL, SMPL-H or SMPL-X body.

    Args:
        pose: rotation vectors in the order of our skeleton [rad].
        root: translation [m].
        fps: frames per second.
        z_up: whether the file's world has +z up; it is then turned by -90 degrees about x.
        name: for reports.
        same_rest: the body that will move is of the SMPL family itself.
    """
    local = Motion(fps=fps, pose=pose, root=root, name=name)
    world = world_rotations(PARENTS, matrices(local.pose))
    if z_up:
        turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
        world, root = turn @ world, root @ turn.T
    return SourceMotion(
        fps=fps,
        world=world,
        root=root,
        leg_length=SMPL_LEG_LENGTH,
        rest={} if same_rest else smpl_rest(),
        name=name,
    )
