"""Which part of the body is nearest to a pixel, from landmarks alone."""

import dataclasses
import enum

import numpy as np
from jaxtyping import Bool, Float, Int

from dress_jax.capture.landmarks import USUAL_THRESHOLD, Landmarks


class Part(enum.IntEnum):
    """Parts of the body, as far as clothes differ on them."""

    HEAD = 0
    NECK = 1
    TORSO = 2
    UPPER_ARM = 3
    FOREARM = 4
    HAND = 5
    THIGH = 6
    SHIN = 7
    FOOT = 8


# Half the breadth of a part, as a share of the torso's length (shoulders to hips).
_BREADTH = {
    Part.HEAD: 0.26,
    Part.NECK: 0.14,
    Part.TORSO: 0.16,
    Part.UPPER_ARM: 0.12,
    Part.FOREARM: 0.10,
    Part.HAND: 0.12,
    Part.THIGH: 0.19,
    Part.SHIN: 0.13,
    Part.FOOT: 0.11,
}
_HAND_LENGTH, _FOOT_LENGTH = 0.55, 0.9
_NOSE, _EYES, _EARS, _SHOULDERS, _HIPS = 0, (1, 2), (3, 4), (5, 6), (11, 12)


@dataclasses.dataclass(frozen=True)
class Bone:
    """A line of the body in the picture.

    Args:
        part: what it belongs to.
        start, end: column and row [px], from the trunk outwards, shape (2,).
    """

    part: Part
    start: Float[np.ndarray, "2"]
    end: Float[np.ndarray, "2"]


@dataclasses.dataclass(frozen=True, eq=False)
class Figure:
    """The body's lines in a picture.

    Args:
        bones: of the visible parts.
        shoulders, hips: column and row of their middles [px], shape (2,).
        torso: length from shoulders to hips [px].
        face: column and row of the face's middle [px].
        face_radius: within which there is nothing but face [px].
    """

    bones: tuple[Bone, ...]
    shoulders: Float[np.ndarray, "2"]
    hips: Float[np.ndarray, "2"]
    torso: float
    face: Float[np.ndarray, "2"]
    face_radius: float


def figure(landmarks: Landmarks, *, scale: float = 1.0) -> Figure | None:
    """The body's lines, or None where shoulders or hips were not found.

    Args:
        landmarks: in the picture.
        scale: by which the picture is shrunk.
    """
    points = (landmarks.points + 0.5) * scale - 0.5
    seen = landmarks.confidence >= USUAL_THRESHOLD
    if not (seen[list(_SHOULDERS)].any() and seen[list(_HIPS)].any()):
        return None

    def middle(pair: tuple[int, int]) -> np.ndarray:
        return points[[i for i in pair if seen[i]] or list(pair)].mean(axis=0)

    shoulders, hips = middle(_SHOULDERS), middle(_HIPS)
    torso = max(float(np.linalg.norm(hips - shoulders)), 4.0)
    face = 0.5 * (points[_NOSE] + middle(_EYES))
    crown = face + 0.35 * (face - shoulders)
    bones = [
        Bone(Part.HEAD, face, crown),
        Bone(
            Part.NECK, shoulders + 0.25 * (face - shoulders), shoulders + 0.5 * (face - shoulders)
        ),
    ]
    for shoulder, hip in zip(_SHOULDERS, _HIPS, strict=True):
        if seen[shoulder] and seen[hip]:
            # Drawn in towards the middle, so that the arm outside is the arm's.
            bones.append(
                Bone(
                    Part.TORSO,
                    0.6 * points[shoulder] + 0.4 * shoulders + 0.08 * (hips - shoulders),
                    0.6 * points[hip] + 0.4 * hips,
                )
            )
    bones.append(Bone(Part.TORSO, shoulders + 0.08 * (hips - shoulders), hips))
    for shoulder, elbow, wrist, hip, knee, ankle, toe in (
        (5, 7, 9, 11, 13, 15, 17),
        (6, 8, 10, 12, 14, 16, 20),
    ):
        if seen[shoulder] and seen[elbow]:
            bones.append(Bone(Part.UPPER_ARM, points[shoulder], points[elbow]))
        if seen[elbow] and seen[wrist]:
            bones.append(Bone(Part.FOREARM, points[elbow], points[wrist]))
        if seen[wrist]:
            reach = points[wrist] - points[elbow] if seen[elbow] else np.array([0.0, 1.0])
            reach = reach / max(float(np.linalg.norm(reach)), 1e-6)
            bones.append(
                Bone(
                    Part.HAND,
                    points[wrist] + 0.08 * torso * reach,
                    points[wrist] + 0.5 * _HAND_LENGTH * torso * reach,
                )
            )
        if seen[hip] and seen[knee]:
            bones.append(Bone(Part.THIGH, points[hip], points[knee]))
        if seen[knee] and seen[ankle]:
            bones.append(Bone(Part.SHIN, points[knee], points[ankle]))
        if seen[ankle]:
            end = points[toe] if seen[toe] else points[ankle] + np.array([0.0, 0.15 * torso])
            bones.append(Bone(Part.FOOT, points[ankle], end))
    eyes = [float(np.linalg.norm(points[1] - points[2]))] if seen[1] and seen[2] else []
    radius = max([0.9 * gap for gap in eyes] + [0.07 * torso])
    return Figure(tuple(bones), shoulders, hips, torso, face, radius)


def part_map(
    body: Figure, size: tuple[int, int]
) -> tuple[Int[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """The nearest part of every pixel, and the distance from its line in units of its breadth.

    Args:
        body: see `Figure`.
        size: rows and columns.
    """
    rows, columns = np.mgrid[: size[0], : size[1]]
    pixels = np.stack([columns, rows], axis=-1).astype(np.float64)
    best, parts = np.full(size, np.inf), np.zeros(size, np.int64)
    for bone in body.bones:
        gap = distance_to(bone, pixels) / (_BREADTH[bone.part] * body.torso)
        nearer = gap < best
        best[nearer], parts[nearer] = gap[nearer], bone.part
    return parts, best


def distance_to(bone: Bone, pixels: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape"]:
    """Distance from a line of finite length [px]."""
    along = bone.end - bone.start
    length = max(float(along @ along), 1e-12)
    share = np.clip((pixels - bone.start) @ along / length, 0.0, 1.0)
    return np.linalg.norm(pixels - bone.start - share[..., None] * along, axis=-1)


def height_along(body: Figure, size: tuple[int, int]) -> Float[np.ndarray, "h w"]:
    """Place of every pixel along the trunk: 0 at the shoulders, 1 at the hips, more below."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    axis = (body.hips - body.shoulders) / body.torso**2
    return (columns - body.shoulders[0]) * axis[0] + (rows - body.shoulders[1]) * axis[1]


def beside_trunk(body: Figure, size: tuple[int, int]) -> Float[np.ndarray, "h w"]:
    """Distance of every pixel from the trunk's axis, as a share of its length."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    axis = (body.hips - body.shoulders) / body.torso**2
    return np.abs((rows - body.shoulders[1]) * axis[0] - (columns - body.shoulders[0]) * axis[1])


def near_bones(
    body: Figure, part: Part, size: tuple[int, int], *, share: float
) -> Bool[np.ndarray, "h w"]:
    """Pixels within a share of the part's breadth from one of its lines."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    pixels = np.stack([columns, rows], axis=-1).astype(np.float64)
    mask = np.zeros(size, bool)
    for bone in body.bones:
        if bone.part is part:
            mask |= distance_to(bone, pixels) <= share * _BREADTH[part] * body.torso
    return mask
