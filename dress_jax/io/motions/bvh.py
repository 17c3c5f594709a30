"""BVH files: a hierarchy of joints and the channels of every frame (S15).

A file says how the channels of each joint are ordered; a rotation is the product of its channels in
that order.
"""

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dress_jax.core.errors import InputError

_MOVES = 0.02  # of a joint that is not the root against its parent, over the height


@dataclasses.dataclass(frozen=True)
class _Joint:
    name: str
    parent: int
    offset: np.ndarray
    channels: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class BvhFile:
    """What a BVH file holds.

    Args:
        names, parents: of the joints; ends of chains are joints without channels.
        offsets: against the parents, in units of the file, (j, 3).
        local: rotations against the parents, (t, j, 3, 3).
        root: places of the root, (t, 3).
        frame_time: [s].
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Float[np.ndarray, "j 3"]
    local: Float[np.ndarray, "t j 3 3"]
    root: Float[np.ndarray, "t 3"]
    frame_time: float


def parse_bvh(path: str | Path) -> BvhFile:
    """Read hierarchy and frames.

    Raises:
        InputError: the file is missing or malformed; the message names the line.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8", errors="strict")
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", where=str(path), mend="check the path"
        ) from error
    except UnicodeDecodeError as error:
        raise InputError("is no text file", where=str(path), mend="give a BVH file") from error
    lines = _Lines(path, text)
    joints = _hierarchy(lines)
    count, frame_time = _motion_header(lines)
    width = sum(len(joint.channels) for joint in joints)
    rows = np.empty((count, width))
    for row in range(count):
        words = lines.words(f"frame {row + 1} of {count}")
        if len(words) != width:
            raise lines.fault(f"{len(words)} numbers, the joints have {width} channels")
        rows[row] = lines.numbers(words)
    return _decoded(path, joints, rows, frame_time)


class _Lines:
    """Lines of the file that are not empty, with their numbers for messages."""

    def __init__(self, path: Path, text: str):
        self._path = path
        self._rows = [
            (number, line.split())
            for number, line in enumerate(text.splitlines(), start=1)
            if line.strip()
        ]
        self._next = 0

    def words(self, expected: str) -> list[str]:
        if self._next == len(self._rows):
            raise InputError(
                f"ends where {expected} should be", where=str(self._path), mend="copy it again"
            )
        self._next += 1
        return self._rows[self._next - 1][1]

    def fault(self, problem: str) -> InputError:
        number = self._rows[max(self._next - 1, 0)][0] if self._rows else 1
        return InputError(problem, where=f"{self._path}, line {number}", mend="export it again")

    def numbers(self, words: list[str]) -> np.ndarray:
        try:
            found = np.array([float(word) for word in words])
        except ValueError as error:
            raise self.fault(f"{' '.join(words)[:40]!r} holds no numbers") from error
        if not np.isfinite(found).all():
            raise self.fault("a number is not finite")
        return found


def _hierarchy(lines: _Lines) -> list[_Joint]:
    if lines.words("HIERARCHY")[0].upper() != "HIERARCHY":
        raise lines.fault("does not begin with HIERARCHY")
    joints: list[_Joint] = []
    open_joints: list[int] = []
    pending: tuple[str, bool] | None = None
    while True:
        words = lines.words("the hierarchy or MOTION")
        key = words[0].upper()
        if key == "MOTION":
            break
        if key in ("ROOT", "JOINT", "END"):
            if key == "ROOT" and joints:
                raise lines.fault("a second ROOT")
            end = key == "END"
            name = f"{joints[open_joints[-1]].name}_end" if end and open_joints else words[-1]
            pending = (name, end)
        elif key == "{":
            if pending is None:
                raise lines.fault("a brace without a joint")
            parent = open_joints[-1] if open_joints else -1
            joints.append(_Joint(pending[0], parent, np.zeros(3), ()))
            open_joints.append(len(joints) - 1)
            pending = None
        elif key == "}":
            if not open_joints:
                raise lines.fault("a closing brace too many")
            open_joints.pop()
        elif key == "OFFSET" and open_joints:
            offset = lines.numbers(words[1:])
            if len(offset) != 3:
                raise lines.fault(f"an offset of {len(offset)} numbers")
            joints[open_joints[-1]] = dataclasses.replace(joints[open_joints[-1]], offset=offset)
        elif key == "CHANNELS" and open_joints:
            channels = tuple(word.lower() for word in words[2:])
            known = {axis + kind for axis in "xyz" for kind in ("position", "rotation")}
            if words[1:2] != [str(len(channels))] or not set(channels) <= known:
                raise lines.fault(f"unknown channels: {' '.join(words[1:])}")
            joints[open_joints[-1]] = dataclasses.replace(
                joints[open_joints[-1]], channels=channels
            )
        else:
            raise lines.fault(f"{words[0]!r} is not expected here")
    if open_joints or not joints:
        raise lines.fault("the hierarchy is not closed, or empty")
    return joints


def _motion_header(lines: _Lines) -> tuple[int, float]:
    words = lines.words("Frames:")
    if words[0].lower() != "frames:" or len(words) != 2 or not words[1].isdigit():
        raise lines.fault("expected 'Frames: N'")
    count = int(words[1])
    words = lines.words("Frame Time:")
    if [word.lower() for word in words[:2]] != ["frame", "time:"] or len(words) != 3:
        raise lines.fault("expected 'Frame Time: SECONDS'")
    seconds = float(lines.numbers(words[2:])[0])
    if count < 1 or not seconds > 0.0:
        raise lines.fault(f"{count} frames of {seconds} s")
    return count, seconds


def _decoded(path: Path, joints: list[_Joint], rows: np.ndarray, frame_time: float) -> BvhFile:
    offsets = np.array([joint.offset for joint in joints])
    height = float(np.max(np.ptp(_places(joints, offsets), axis=0), initial=0.0))
    local = np.tile(np.eye(3), (len(rows), len(joints), 1, 1))
    root = np.tile(offsets[0], (len(rows), 1))
    column = 0
    for number, joint in enumerate(joints):
        values = rows[:, column : column + len(joint.channels)]
        column += len(joint.channels)
        turns = [k for k, name in enumerate(joint.channels) if name.endswith("rotation")]
        if turns:
            order = "".join(joint.channels[k][0].upper() for k in turns)
            local[:, number] = _turned(order, values[:, turns])
        moves = [k for k, name in enumerate(joint.channels) if name.endswith("position")]
        for k in moves:
            axis = "xyz".index(joint.channels[k][0])
            if number == 0:
                root[:, axis] = values[:, k]
            elif np.ptp(values[:, k]) > _MOVES * height:
                raise InputError(
                    f"joint {joint.name} moves by {np.ptp(values[:, k]):.3g} against its parent",
                    where=str(path),
                    mend="export the motion with rotations only, and positions of the root",
                )
    return BvhFile(
        names=tuple(joint.name for joint in joints),
        parents=tuple(joint.parent for joint in joints),
        offsets=offsets,
        local=local,
        root=root,
        frame_time=frame_time,
    )


def _turned(order: str, degrees: np.ndarray) -> np.ndarray:
    """The product of rotations about the axes of `order`; axes may repeat or be missing."""
    total = np.tile(np.eye(3), (len(degrees), 1, 1))
    for axis, angle in zip(order, degrees.T, strict=True):
        total = total @ Rotation.from_euler(axis, angle[:, None], degrees=True).as_matrix()
    return total


def _places(joints: list[_Joint], offsets: np.ndarray) -> np.ndarray:
    places = np.zeros_like(offsets)
    for number, joint in enumerate(joints):
        if joint.parent >= 0:
            places[number] = places[joint.parent] + offsets[number]
    return places
