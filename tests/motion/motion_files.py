"""Small files of motions, written as their makers write them."""

import pickle
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

FRAMES = 6


def upright_z(frames: int = FRAMES) -> np.ndarray:
    """Root rotations of a body that stands in a world with +z up and turns to its left [rad]."""
    stand = Rotation.from_euler("x", 90.0, degrees=True)
    turns = Rotation.from_rotvec(np.arange(frames)[:, None] * np.array([[0.0, 0.0, 0.1]]))
    return (turns * stand).as_rotvec()


def write_amass(path: Path, *, width: int = 165, rate: str = "mocap_frame_rate", **other) -> Path:
    poses = np.zeros((FRAMES, width))
    poses[:, :3] = upright_z()
    poses[:, 3 * 4] = 0.3  # left knee bent
    poses[:, -3] = 0.2  # last joint of the right hand
    trans = np.stack([np.zeros(FRAMES), -0.05 * np.arange(FRAMES), np.full(FRAMES, 1.2)], axis=1)
    arrays = {
        "poses": poses,
        "trans": trans,
        "betas": np.zeros(16),
        rate: 60.0,
        "gender": "neutral",
    }
    np.savez(path, **(arrays | other))
    return path


def write_aist(path: Path, **other) -> Path:
    values = {
        "smpl_poses": np.zeros((FRAMES, 72), np.float32),
        "smpl_trans": np.tile(np.array([[0.0, 180.0, 30.0]], np.float32), (FRAMES, 1)),
        "smpl_scaling": np.array([90.0], np.float32),
        "smpl_loss": 0.1,
    }
    values["smpl_poses"][:, 1] = 0.1 * np.arange(FRAMES)
    path.write_bytes(pickle.dumps(values | other, protocol=2))
    return path


# A small skeleton, arms down at rest, in centimetres, +y up.
_TREE = """
Hips 0 90 0 | Spine 0 10 0 | Neck 0 40 0 | Head 0 15 0 ; _ 0 15 0
Neck > LeftShoulder 5 -5 0 | LeftArm 9 0 0 | LeftForeArm 0 -26 0 | LeftHand 0 -24 0 ; _ 0 -9 0
Neck > RightShoulder -5 -5 0 | RightArm -9 0 0 | RightForeArm 0 -26 0 | RightHand 0 -24 0 ; _ 0 -9 0
Hips > LeftUpLeg 10 -4 0 | LeftLeg 0 -40 0 | LeftFoot 0 -40 0 | LeftToeBase 0 -6 14 ; _ 0 0 5
Hips > RightUpLeg -10 -4 0 | RightLeg 0 -40 0 | RightFoot 0 -40 0 | RightToeBase 0 -6 14 ; _ 0 0 5
"""


def bvh_text(
    *,
    order: str = "ZXY",
    rows: dict[str, tuple[float, float, float]] | None = None,
    turn: np.ndarray | None = None,
    scale: float = 1.0,
    root: np.ndarray | None = None,
    frames: int = FRAMES,
    edit=lambda text: text,
) -> str:
    """A BVH file.

    Args:
        order: of the rotation channels.
        rows: degrees about the axes of `order` by joint, the same in every frame.
        turn: of the file's world against ours, (3, 3).
        scale: units per centimetre.
        root: places of the hips in units of the file, (frames, 3).
    """
    turn = np.eye(3) if turn is None else turn
    tree: dict[str, tuple[str, np.ndarray]] = {}
    order_of: list[str] = []
    children: dict[str, list[str]] = {}
    ends: dict[str, np.ndarray] = {}
    for line in _TREE.strip().splitlines():
        start, _, chain = line.rpartition(" > ")
        parent = start
        chain, _, end = chain.partition(" ; ")
        for part in chain.split(" | "):
            name, *numbers = part.split()
            tree[name] = parent, scale * (turn @ np.array([float(n) for n in numbers]))
            children.setdefault(parent, []).append(name)
            parent = name
        ends[parent] = scale * (turn @ np.array([float(n) for n in end.split()[1:]]))
    text = ["HIERARCHY"]

    def write(name: str, depth: int) -> None:
        indent = "  " * depth
        order_of.append(name)
        text.append(f"{indent}{'ROOT' if depth == 0 else 'JOINT'} {name}")
        text.append(indent + "{")
        text.append(f"{indent}  OFFSET {' '.join(f'{v:.9g}' for v in tree[name][1])}")
        turns = " ".join(f"{axis}rotation" for axis in order)
        moves = "Xposition Yposition Zposition " if depth == 0 else ""
        text.append(f"{indent}  CHANNELS {6 if depth == 0 else 3} {moves}{turns}")
        for child in children.get(name, []):
            write(child, depth + 1)
        if name in ends:
            text.append(f"{indent}  End Site")
            text.append(indent + "  {")
            text.append(f"{indent}    OFFSET {' '.join(f'{v:.9g}' for v in ends[name])}")
            text.append(indent + "  }")
        text.append(indent + "}")

    write("Hips", 0)
    text += ["MOTION", f"Frames: {frames}", "Frame Time: 0.025"]
    places = np.tile(tree["Hips"][1], (frames, 1)) if root is None else root
    for frame in range(frames):
        numbers = [*places[frame]]
        for name in order_of:
            numbers += (rows or {}).get(name, (0.0, 0.0, 0.0))
        text.append(" ".join(f"{number:.9g}" for number in numbers))
    return edit("\n".join(text) + "\n")
