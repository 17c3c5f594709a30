"""The matte's filter and faults; the network itself is held by `test_networks`."""

import numpy as np
import pytest
from mannequin import mannequin

from dress_jax.core.errors import InputError
from dress_jax.io.networks import load_matting_network
from dress_jax.vision.matting import LEAST_SIDE, find_matte, guided_filter
from dress_jax.vision.resampling import resized


def test_a_filtered_matte_moves_to_the_edge_of_the_guide():
    guide = np.zeros((60, 60))
    guide[:, 30:] = 1.0
    blurred = np.clip((np.arange(60) - 24) / 12.0, 0.0, 1.0) * np.ones((60, 1))
    found = guided_filter(blurred, guide, radius=0.2, variance=1e-4)
    assert found[:, :28].max() < 0.5 < found[:, 32:].min()
    assert (found[30, 30] - found[30, 29]) > 5 * (blurred[30, 30] - blurred[30, 29])
    flat = np.full((20, 20), 0.4)
    np.testing.assert_allclose(guided_filter(flat, np.zeros((20, 20))), 0.4)


def test_resizing_keeps_the_mean_and_the_place():
    ramp = np.mgrid[:40, :40][1].astype(float)
    small = resized(ramp, (20, 20))
    np.testing.assert_allclose(small[10, 2:-2], ramp[0].reshape(20, 2).mean(axis=1)[2:-2], atol=0.1)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((LEAST_SIDE - 1, 200, 3), np.uint8), f"200x{LEAST_SIDE - 1} pixels"),
        (np.zeros((100, 100), np.uint8), "8-bit pixels"),
        (np.zeros((100, 100, 3)), "8-bit pixels"),
    ],
)
def test_bad_pictures_are_refused(image, message):
    with pytest.raises(InputError, match=message):
        find_matte(image, load_matting_network())


@pytest.mark.slow
def test_a_drawn_person_stands_out():
    image, mask, _, _ = mannequin()
    found = find_matte(image, load_matting_network()) >= 128
    assert (found & mask).sum() / (found | mask).sum() > 0.9
