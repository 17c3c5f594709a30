"""Landmarks of a person by BlazePose, found where the matte is, in COCO-WholeBody's order.

The network (Bazarevsky et al. 2020; "MediaPipe BlazePose GHUM 3D" model card) looks at an upright
square around one person. Of its 39 points two are helpers: the middle of the hips and the rim of a
circle around the whole person. The first square comes from the matte, the second one from the
helpers that were found in the first.
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, UInt8

from dress_jax.capture.landmarks import COUNT, Landmarks
from dress_jax.core.errors import InputError
from dress_jax.vision.matting import checked_size, nothing_found
from dress_jax.vision.networks import Network, run_network
from dress_jax.vision.resampling import square_window

# fmt: off
BLAZEPOSE = {
    0: 0, 1: 2, 2: 5, 3: 7, 4: 8, 5: 11, 6: 12, 7: 13, 8: 14, 9: 15, 10: 16, 11: 23, 12: 24,
    13: 25, 14: 26, 15: 27, 16: 28, 17: 31, 19: 29, 20: 32, 22: 30,
}
"""Our landmark, and BlazePose's. It has no small toes, no face and no fingers as ours has them."""
# fmt: on
LEAST_PRESENCE = 0.5
"""The network's own probability of a person, below which there is none."""
POINTS, COLUMNS = 39, 5
_CENTRE, _RIM = 33, 34
_MARGIN = 1.25
_PASSES = 2
_OPAQUE = 128


@dataclasses.dataclass(frozen=True, eq=False)
class PersonLandmarks:
    """What the network says of a person.

    Args:
        landmarks: in our order; where the network has no point the confidence is zero.
        presence: probability that the square shows a person.
    """

    landmarks: Landmarks
    presence: float


def find_landmarks(
    image: UInt8[np.ndarray, "h w 3"], matte: UInt8[np.ndarray, "h w"], network: Network
) -> PersonLandmarks:
    """Landmarks of the person under the matte.

    A landmark's confidence is the smaller of two probabilities: that it lies within the square,
    and that nothing hides it. Outside of the picture it is zero.

    Args:
        image: RGB, shape (h, w, 3).
        matte: coverage by the person, 0 to 255, shape (h, w).
        network: of `io.networks.load_landmark_network`.

    Raises:
        InputError: the picture is too small, the matte is empty, or the network sees no person.
    """
    colours = checked_size(image).astype(np.float32) / 255.0
    centre, side = matte_square(matte >= _OPAQUE)
    rows, presence = np.zeros((POINTS, COLUMNS)), 0.0
    for _ in range(_PASSES):
        rows, presence = _look(colours, centre, side, network)
        if presence < LEAST_PRESENCE:
            raise InputError(
                f"shows no person: the landmark network gives {presence:.2f}",
                where="image",
                mend="give a picture of one whole person, upright",
            )
        centre, side = rows[_CENTRE, :2], helper_side(rows)
    landmarks = from_blazepose(rows)
    # Beyond the picture the network only guesses, with confidence.
    height, width = colours.shape[:2]
    inside = (landmarks.points >= -0.5) & (landmarks.points <= [width - 0.5, height - 0.5])
    seen = np.where(inside.all(axis=1), landmarks.confidence, 0.0)
    return PersonLandmarks(Landmarks(points=landmarks.points, confidence=seen), presence)


def matte_square(mask: Bool[np.ndarray, "h w"]) -> tuple[Float[np.ndarray, "2"], float]:
    """Middle (column, row) and side of a square around a mask with a margin [px].

    Raises:
        InputError: the mask is empty.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        raise nothing_found()
    low, high = np.array([columns[0], rows[0]]), np.array([columns[-1], rows[-1]])
    return 0.5 * (low + high), _MARGIN * float((high - low).max() + 1)


def helper_side(rows: Float[np.ndarray, "39 5"]) -> float:
    """Side of the square around the circle that the two helping points describe [px]."""
    return 2.0 * _MARGIN * float(np.linalg.norm(rows[_RIM, :2] - rows[_CENTRE, :2]))


def from_blazepose(rows: Float[np.ndarray, "39 5"]) -> Landmarks:
    """Landmarks in COCO-WholeBody's order.

    Args:
        rows: column and row in the picture [px], depth, and two logits: visible, present; shape
            (39, 5).
    """
    points, confidence = np.zeros((COUNT, 2)), np.zeros(COUNT)
    ours, theirs = list(BLAZEPOSE), list(BLAZEPOSE.values())
    points[ours] = rows[theirs, :2]
    confidence[ours] = 1.0 / (1.0 + np.exp(-np.clip(rows[theirs, 3:].min(axis=1), -50.0, 50.0)))
    return Landmarks(points=points, confidence=confidence)


def _look(
    colours: Float[np.ndarray, "h w 3"], centre: np.ndarray, side: float, network: Network
) -> tuple[Float[np.ndarray, "39 5"], float]:
    size = network.graph.input_size[0]
    window = square_window(colours, centre, side, size)
    flat, presence = run_network(network, window[None])
    rows = flat.reshape(POINTS, COLUMNS).astype(np.float64)
    # The network counts from the corner of the first pixel; our centres are whole numbers.
    rows[:, :2] = centre + (rows[:, :2] - 0.5 * size) * side / size
    return rows, float(presence[0, 0])
