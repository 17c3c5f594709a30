"""Views are checked once, and say in one line what is wrong."""

import numpy as np
import pytest
from reconstruction_scenes import ring

from dress_jax.core.errors import InputError
from dress_jax.reconstruction import ReconstructionOptions, make_body_views
from dress_jax.reconstruction.landmarks import TABLE
from dress_jax.reconstruction.options import Rates, Weights
from dress_jax.reconstruction.parameters import make_parameters
from dress_jax.render.cameras import unstack_cameras

SIZE = 16


def arrays(**changes):
    given = {
        "cameras": ring(3, size=SIZE),
        "landmarks": np.full((3, 133, 2), 5.0),
        "confidence": np.ones((3, 133)),
        "mask": np.zeros((3, SIZE, SIZE)),
        "color": np.ones((3, SIZE, SIZE, 3)),
        "occluded": np.zeros((3, SIZE, SIZE)),
    }
    return given | changes


def with_value(shape, value, place):
    array = np.zeros(shape)
    array[place] = value
    return array


def test_landmarks_come_in_the_order_of_the_table():
    landmarks = np.arange(133.0)[None, :, None] * np.ones((3, 1, 2))
    views = make_body_views(**arrays(landmarks=landmarks))
    numbers = [target.index for target in TABLE]
    np.testing.assert_array_equal(views.landmarks[0, :, 0], numbers)
    some = [16, 0, 91, 40]
    views = make_body_views(
        **arrays(landmarks=landmarks[:, some], confidence=np.ones((3, 4)), landmark_ids=some)
    )
    seen = np.asarray(views.confidence[1]) > 0.0
    assert [n for n, s in zip(numbers, seen, strict=True) if s] == [0, 16, 91]
    np.testing.assert_array_equal(np.asarray(views.landmarks)[1, seen, 0], [0, 16, 91])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cameras": ring(4, size=SIZE)}, "4 cameras for landmarks of 3 views"),
        ({"cameras": unstack_cameras(ring(1, size=SIZE))[0]}, "1 cameras for landmarks of 3"),
        ({"confidence": np.zeros((3, 133))}, "no landmark is seen"),
        ({"confidence": np.ones((3, 17))}, "are not"),
        ({"landmarks": with_value((3, 133, 2), np.nan, (1, 5, 0))}, "landmark 5 of view 1"),
        ({"confidence": with_value((3, 133), np.nan, (1, 5))}, "confidence"),
        ({"confidence": with_value((3, 133), 7.0, (1, 5))}, "confidence"),
        ({"landmark_ids": np.zeros(133, int)}, "different landmarks"),
        ({"landmark_ids": np.arange(133) + 1}, "run from 1 to 133"),
        ({"mask": np.zeros((3, SIZE, SIZE + 1))}, "mask has shape"),
        ({"mask": with_value((3, SIZE, SIZE), np.nan, (0, 0, 0))}, "mask holds"),
        ({"color": np.full((3, SIZE, SIZE, 3), 255.0)}, "color holds"),
        ({"occluded": np.zeros((2, SIZE, SIZE))}, "occluded has shape"),
        ({"mask": None}, "no masks"),
    ],
)
def test_bad_views_are_refused(changes, message):
    with pytest.raises(InputError, match=message) as caught:
        make_body_views(**arrays(**changes))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pose": np.zeros((54, 3))}, "do not fit"),
        ({"pose": np.full((55, 3), np.nan)}, "not finite"),
        ({"shape": np.zeros(17)}, "17 shape coefficients"),
        ({"scale": 0.0}, "scale is 0.0"),
        ({"translation": np.zeros(2)}, "do not fit"),
    ],
)
def test_bad_estimates_are_refused(body, changes, message):
    with pytest.raises(InputError, match=message):
        make_parameters(body, **changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"fine_iterations": -1},
        {"views_per_iteration": -2},
        {"final_rate": 0.0},
        {"weights": Weights(mask=-1.0)},
        {"rates": Rates(pose=float("nan"))},
    ],
)
def test_bad_options_are_refused(changes):
    with pytest.raises(InputError):
        ReconstructionOptions(**changes)
