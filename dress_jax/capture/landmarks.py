"""The 133 whole-body landmarks of COCO-WholeBody, and the orders in which tools write them.

Order: 17 of the body, 6 of the feet, 68 of the face, 21 of the left and 21 of the right hand.
Left and right are the person's own.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from dress_jax.capture.checks import numbers
from dress_jax.core.errors import InputError

COUNT = 133
BODY, FEET, FACE = slice(0, 17), slice(17, 23), slice(23, 91)
LEFT_HAND, RIGHT_HAND = slice(91, 112), slice(112, 133)
# fmt: off
BODY_NAMES = (
    "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder",
    "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee",
    "right_knee", "left_ankle", "right_ankle", "left_big_toe", "left_small_toe", "left_heel",
    "right_big_toe", "right_small_toe", "right_heel",
)
"""Names of the first 23 landmarks."""
LIMBS = (
    (5, 6), (5, 7), (7, 9), (6, 8), (8, 10), (5, 11), (6, 12), (11, 12), (11, 13), (13, 15),
    (12, 14), (14, 16), (15, 17), (15, 19), (16, 20), (16, 22), (0, 1), (0, 2),
)
"""Pairs of landmarks that pictures join by a line."""

# For each of the 17 landmarks of the body: its place in OpenPose's 18 and 25 points.
_OPENPOSE_18 = (0, 15, 14, 17, 16, 5, 2, 6, 3, 7, 4, 11, 8, 12, 9, 13, 10)
_OPENPOSE_25 = (0, 16, 15, 18, 17, 5, 2, 6, 3, 7, 4, 12, 9, 13, 10, 14, 11)
_OPENPOSE_25_FEET = (19, 20, 21, 22, 23, 24)
# fmt: on
USUAL_THRESHOLD = 0.3
"""Confidence from which DWPose's and rtmlib's own programs use a landmark."""


@dataclasses.dataclass(frozen=True, eq=False)
class Landmarks:
    """Landmarks of one person in a picture.

    Args:
        points: column and row, pixel centres at whole numbers [px], shape (133, 2). They may lie
            outside the picture; where the confidence is zero they mean nothing.
        confidence: 0 for a landmark that was not found; networks scale it differently, some
            beyond 1, shape (133,).

    Raises:
        InputError: wrong shapes, numbers that are not finite, or a negative confidence.
    """

    points: Float[np.ndarray, "133 2"]
    confidence: Float[np.ndarray, "133"]

    def __post_init__(self) -> None:
        where = "landmarks"
        object.__setattr__(self, "points", numbers(f"{where}, points", self.points, (COUNT, 2)))
        confidence = numbers(f"{where}, confidence", self.confidence, (COUNT,))
        if (confidence < 0.0).any():
            raise InputError(
                f"landmark {int(np.argmin(confidence))} has confidence {confidence.min():.3g}",
                where=where,
                mend="give 0 for landmarks that were not found",
            )
        object.__setattr__(self, "confidence", confidence)


def without_neck(rows: Float[np.ndarray, "134 c"]) -> Float[np.ndarray, "133 c"]:
    """COCO-WholeBody order out of 134 rows in the OpenPose order of DWPose and rtmlib.

    Their OpenPose mode puts a neck (the mean of the shoulders) among the points and sorts the body
    as OpenPose does; feet, face and hands follow unchanged.

    Args:
        rows: one per landmark, any columns, shape (134, c).

    Raises:
        InputError: another number of rows.
    """
    rows = np.asarray(rows)
    if rows.ndim != 2 or len(rows) != COUNT + 1:
        raise InputError(
            f"rows have shape {rows.shape}, not ({COUNT + 1}, c)", where="OpenPose order"
        )
    return np.concatenate([rows[list(_OPENPOSE_18)], rows[18:]])


def from_openpose(
    body: Float[np.ndarray, "k 3"],
    *,
    face: Float[np.ndarray, "f 3"] | None = None,
    left_hand: Float[np.ndarray, "21 3"] | None = None,
    right_hand: Float[np.ndarray, "21 3"] | None = None,
) -> Landmarks:
    """Landmarks out of OpenPose's lists of column, row and confidence.

    Args:
        body: 25 points (BODY_25, with feet) or 18 (COCO, without), shape (k, 3).
        face: 70 points, of which the last two (pupils) have no counterpart, or 68.
        left_hand, right_hand: 21 points each.

    Raises:
        InputError: a list of another length.
    """
    body = np.asarray(body, float)
    rows = np.zeros((COUNT, 3))
    if body.shape == (25, 3):
        rows[BODY], rows[FEET] = body[list(_OPENPOSE_25)], body[list(_OPENPOSE_25_FEET)]
    elif body.shape == (18, 3):
        rows[BODY] = body[list(_OPENPOSE_18)]
    else:
        raise InputError(
            f"the body has {len(body)} points",
            where="OpenPose landmarks",
            mend="give 25 (BODY_25) or 18 (COCO)",
        )
    for name, place, points, counts in (
        ("face", FACE, face, (70, 68)),
        ("left hand", LEFT_HAND, left_hand, (21,)),
        ("right hand", RIGHT_HAND, right_hand, (21,)),
    ):
        if points is None or len(points) == 0:
            continue
        if len(points) not in counts:
            raise InputError(
                f"the {name} has {len(points)} points, not {counts[0]}",
                where="OpenPose landmarks",
            )
        rows[place] = np.asarray(points, float)[: place.stop - place.start]
    return Landmarks(points=rows[:, :2], confidence=rows[:, 2])
