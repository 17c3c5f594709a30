"""BVH motions on our skeleton, by the names of their joints (S15).

Units are whatever they are: the way of the pelvis is scaled by the length of the legs. The file's
world is found from its rest pose: up is the axis nearest to the way from the feet to the head, left
the one nearest to the way from the right hip to the left one.
"""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from dress_jax.body.skeleton import JOINTS, PARENTS
from dress_jax.core.errors import InputError
from dress_jax.io.motions.bvh import BvhFile, parse_bvh
from dress_jax.motion.retarget import LIMBS, SourceMotion

# Names without side, spaces, underscores and prefixes, by joint of ours. Where two chains of names
# disagree (a Hip that holds a leg, or the whole body), the side tells.
_SIDED = {
    "hip": ("hip", "upleg", "upperleg", "thigh"),
    "knee": ("knee", "leg", "lowleg", "lowerleg", "shin", "calf"),
    "ankle": ("ankle", "foot"),
    "foot": ("toe", "toebase", "ball"),
    "collar": ("collar", "shoulder", "clavicle", "collarbone"),
    "shoulder": ("arm", "uparm", "upperarm", "humerus", "shoulder"),
    "elbow": ("elbow", "forearm", "lowarm", "lowerarm", "radius"),
    "wrist": ("wrist", "hand"),
}
_CENTRAL = {
    "pelvis": ("hips", "hip", "pelvis", "root"),
    "spine1": ("spine", "lowerback", "abdomen", "chest", "spine0"),
    "spine2": ("spine1", "chest2"),
    "spine3": ("spine2", "chest3", "upperchest", "spine3"),
    "neck": ("neck", "neck1"),
    "head": ("head",),
}
_NEEDED = tuple(
    f"{side}_{joint}" for side in ("left", "right") for joint in ("hip", "knee", "ankle")
)


def read_bvh(path: str | Path) -> SourceMotion:
    """A motion on our skeleton.

    Raises:
        InputError: the file is missing or malformed (with the line), or has no legs by name.
    """
    path = Path(path)
    return on_our_skeleton(parse_bvh(path), path.name)


def joints_by_name(names: tuple[str, ...]) -> dict[str, int]:
    """The file's joint of each of ours that has one, by usual names."""
    found: dict[str, int] = {}
    for number, raw in enumerate(names):
        if raw.endswith("_end"):
            continue
        side, plain = _side(raw)
        table = _SIDED if side else _CENTRAL
        for ours, options in table.items():
            name = f"{side}_{ours}" if side else ours
            if plain in options and name not in found:
                found[name] = number
                break
    for side in ("left", "right"):
        # A shoulder without another joint before the elbow is the arm's, not the collar bone's.
        if f"{side}_collar" in found and f"{side}_shoulder" not in found:
            found[f"{side}_shoulder"] = found.pop(f"{side}_collar")
    return found


def _side(raw: str) -> tuple[str, str]:
    """The side that a joint's name tells, and the rest of it."""
    name = re.sub(r"^.*:", "", raw)
    camel = re.match(r"^(l|r)(?=[A-Z])", name)
    plain = re.sub(r"[\s_.\-]", "", name).lower()
    for side in ("left", "right"):
        if plain.startswith(side):
            return side, plain.removeprefix(side)
        if plain.endswith(side):
            return side, plain.removesuffix(side)
    if camel:
        return ("left" if camel.group(1) == "l" else "right"), plain[1:]
    mark = re.match(r"^([lLrR])[_.\s](.+)$", name) or re.match(r"^(.+)[_.\s]([lLrR])$", name)
    if mark:
        first, second = mark.groups()
        letter, rest = (first, second) if len(first) == 1 else (second, first)
        side = "left" if letter.lower() == "l" else "right"
        return side, re.sub(r"[\s_.\-]", "", rest).lower()
    return "", plain


def on_our_skeleton(file: BvhFile, name: str) -> SourceMotion:
    """The motion in our frame, its joints ours.

    Raises:
        InputError: a leg has no joints of a name that is known.
    """
    joints = joints_by_name(file.names)
    if "pelvis" not in joints:
        joints["pelvis"] = 0
    missing = [joint for joint in _NEEDED if joint not in joints]
    if missing:
        raise InputError(
            f"has no {', '.join(missing)} among its joints ({', '.join(file.names[:12])} ...)",
            where=name,
            mend="name them as LeftUpLeg, LeftLeg, LeftFoot (or LeftHip, LeftKnee, LeftAnkle), "
            "and so on",
        )
    places = np.zeros_like(file.offsets)
    world = np.array(file.local)
    for number, parent in enumerate(file.parents):
        if parent >= 0:
            places[number] = places[parent] + file.offsets[number]
            world[:, number] = world[:, parent] @ file.local[:, number]
    frame = _frame(places, joints, name)
    ours = np.empty((len(world), len(JOINTS), 3, 3))
    for joint, label in enumerate(JOINTS):
        if label in joints:
            ours[:, joint] = frame.T @ world[:, joints[label]] @ frame
        else:
            ours[:, joint] = ours[:, PARENTS[joint]]
    rest = {}
    for label, end in LIMBS.items():
        if label in joints and end in joints:
            bone = frame.T @ (places[joints[end]] - places[joints[label]])
            if np.linalg.norm(bone) > 0.0:
                rest[label] = bone / np.linalg.norm(bone)
    legs = [
        np.linalg.norm(places[joints[f"{side}_{b}"]] - places[joints[f"{side}_{a}"]])
        for side in ("left", "right")
        for a, b in (("hip", "knee"), ("knee", "ankle"))
    ]
    return SourceMotion(
        fps=1.0 / file.frame_time,
        world=ours,
        root=file.root @ frame,
        leg_length=0.5 * float(sum(legs)),
        rest=rest,
        name=name,
    )


def _frame(places: np.ndarray, joints: dict[str, int], name: str) -> Float[np.ndarray, "3 3"]:
    """Columns: our +x (left), +y (up) and +z (front) in the file's world."""
    top = joints.get("head", joints.get("neck", joints.get("spine3", joints["pelvis"])))
    feet = 0.5 * (places[joints["left_ankle"]] + places[joints["right_ankle"]])
    up = _axis(places[top] - feet)
    across = places[joints["left_hip"]] - places[joints["right_hip"]]
    left = _axis(across - (across @ up) * up)
    if not (up.any() and left.any()):
        raise InputError(
            "its rest pose does not stand: the hips or head and feet are at one place",
            where=name,
            mend="export the skeleton with its offsets",
        )
    return np.stack([left, up, np.cross(left, up)], axis=1)


def _axis(direction: np.ndarray) -> np.ndarray:
    """The coordinate axis nearest to a direction, with its sign; zero for none."""
    axis = np.zeros(3)
    nearest = int(np.argmax(np.abs(direction)))
    axis[nearest] = np.sign(direction[nearest])
    return axis
