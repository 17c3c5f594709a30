"""One tube, its images, and a wrong pattern to recover it from; made once, as draping compiles."""

import pytest
from fit_scenes import draped_observation, tube_pattern, tube_problem

from dress_jax.optimisation import FitMethod, init


@pytest.fixture(scope="session")
def truth():
    """The true pattern, its images and its drape."""
    pattern = tube_pattern()
    observation, drape = draped_observation(pattern)
    return pattern, observation, drape


@pytest.fixture(scope="session")
def fresh(truth):
    """Makes a new problem, as a resumed program would, with its start positions."""
    wrong = tube_pattern(length=0.22, girth=0.83)
    return lambda **options: tube_problem(
        wrong, truth[1], **{"method": FitMethod.ADAM, "iterations": 12, **options}
    )


@pytest.fixture(scope="session")
def problem(fresh):
    """The wrong pattern with the default weights."""
    return fresh(stage_one=2)[0]


@pytest.fixture(scope="session")
def state(problem, fresh):
    """Its initial state."""
    return init(problem, fresh()[1])
