"""A person whose landmarks are known."""

import numpy as np
import pytest
from reconstruction_scenes import person, seen_landmarks

from dress_jax.io.bodies import load_default_body
from dress_jax.reconstruction import landmark_map, make_body_views


@pytest.fixture(scope="session")
def body():
    return load_default_body()


@pytest.fixture(scope="session")
def mapping(body):
    return landmark_map(body)


@pytest.fixture(scope="session")
def truth(body):
    return person(body)


@pytest.fixture(scope="session")
def views(mapping, truth):
    """Exact landmarks of the table, and nothing else, in four views."""
    cameras, landmarks, ids = seen_landmarks(mapping, truth)
    return make_body_views(cameras, landmarks, np.ones(landmarks.shape[:2]), landmark_ids=ids)
