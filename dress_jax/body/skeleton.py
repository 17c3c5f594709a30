"""The 55-joint skeleton in SMPL-X order: names, parents and depth levels."""

import numpy as np

BODY_JOINTS = (
    "pelvis",
    "left_hip",
    "right_hip",
    "spine1",
    "left_knee",
    "right_knee",
    "spine2",
    "left_ankle",
    "right_ankle",
    "spine3",
    "left_foot",
    "right_foot",
    "neck",
    "left_collar",
    "right_collar",
    "head",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "jaw",
    "left_eye",
    "right_eye",
)
FINGERS = ("index", "middle", "pinky", "ring", "thumb")
JOINTS = BODY_JOINTS + tuple(
    f"{side}_{finger}{k}" for side in ("left", "right") for finger in FINGERS for k in (1, 2, 3)
)
# fmt: off
PARENTS = (
    -1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 15,
    20, 25, 26, 20, 28, 29, 20, 31, 32, 20, 34, 35, 20, 37, 38,
    21, 40, 41, 21, 43, 44, 21, 46, 47, 21, 49, 50, 21, 52, 53,
)
# fmt: on


def joint_index(name: str) -> int:
    """The index of a joint by name.

    Raises:
        ValueError: there is no such joint; the message lists all names.
    """
    if name not in JOINTS:
        raise ValueError(f"there is no joint '{name}'; the joints are {', '.join(JOINTS)}")
    return JOINTS.index(name)


def depth_levels(parents: tuple[int, ...]) -> tuple[tuple[int, ...], ...]:
    """Joints grouped by depth in the tree, the root alone in the first group.

    Raises:
        ValueError: the parents do not form one tree with its root at joint 0.
    """
    if not parents or parents[0] != -1 or any(parent < 0 for parent in parents[1:]):
        raise ValueError("joint 0 must be the only root (parent -1)")
    depth = np.zeros(len(parents), dtype=int)
    for joint, parent in enumerate(parents[1:], start=1):
        if parent >= joint:
            raise ValueError(f"joint {joint} comes before its parent {parent}")
        depth[joint] = depth[parent] + 1
    return tuple(tuple(np.flatnonzero(depth == d).tolist()) for d in range(depth.max() + 1))
