"""A body with the measures of a person."""

import numpy as np
import pytest

from dress_jax.body.measurements import measure
from dress_jax.body.skeleton import joint_index
from dress_jax.core.errors import InputError
from dress_jax.io.bodies import body_from_argument, load_default_body

TAPE = 2e-3  # [m]


def _measured(shape: str):
    body = body_from_argument("default", shape=shape)
    model = load_default_body()
    rates = np.asarray(model.joint_shapedirs)[joint_index("left_shoulder"), 0]
    half_width = float(model.joint_template[joint_index("left_shoulder"), 0] + rates @ body.shape)
    return body, measure(body.vertices, body.faces, half_width=half_width)


@pytest.mark.slow
def test_a_body_has_the_measures_that_it_is_asked_for():
    wanted = {"height": 1.72, "bust": 0.998, "waist": 0.843, "hips": 1.035}
    body, tape = _measured(",".join(f"{name}={value}" for name, value in wanted.items()))
    for name, value in wanted.items():
        assert getattr(tape, name) == pytest.approx(value, abs=TAPE), name
    assert np.linalg.norm(body.shape) < 3.0  # still an ordinary person


def test_what_is_not_asked_for_stays_ordinary():
    body, tape = _measured("height=1.6")
    assert tape.height == pytest.approx(1.6, abs=TAPE)
    assert np.linalg.norm(body.shape) < 1.0


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ("height=172", "give metres"),
        ("inseam=0.8", "unknown measures"),
        ("height=tall", "is no measure"),
        pytest.param("bust=2.5", "no shape of this body", marks=pytest.mark.slow),
    ],
)
def test_measures_that_no_body_has_are_refused(shape, message):
    with pytest.raises(InputError, match=message):
        body_from_argument("default", shape=shape)
