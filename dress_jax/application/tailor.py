"""Measurements for the pattern templates, taken from a rigged body."""

import jax.numpy as jnp
import numpy as np

from dress_jax.body.measurements import measure
from dress_jax.body.model import BodyModel, forward
from dress_jax.body.skeleton import joint_index
from dress_jax.pattern.templates import DEFAULT, Measurements

_SLICE = 0.012  # half-width of the slices in which the shoulders' height is looked up [m]
_NECK_ABOVE = 0.05  # the neck ends, and the head begins, this far above the neck joint [m]


def template_measurements(
    model: BodyModel, shape: np.ndarray, *, scale: float = 1.0
) -> Measurements:
    """What `pattern.templates` needs of a body: girths by tape, heights from surface and joints.

    Args:
        model: the rig.
        shape: its shape coefficients.
        scale: of the whole body.

    Raises:
        ValueError: the body has no sections where they are looked for.
    """
    real = model.template.dtype
    state = forward(
        model,
        jnp.zeros((len(model.parents), 3), real),
        jnp.asarray(shape, real),
        jnp.zeros(3, real),
    )
    vertices, joints = scale * np.asarray(state.vertices), scale * np.asarray(state.joints)
    floor = vertices[:, 1].min()
    shoulder = joints[joint_index("left_shoulder")]
    tape = measure(vertices, np.asarray(model.faces), half_width=float(shoulder[0]))
    size = tape.height / 1.68  # the defaults' height
    neck_width = DEFAULT.neck_width * size
    shoulder_width = 2.0 * float(shoulder[0]) + 0.03 * size
    neck_top = joints[joint_index("neck"), 1] + _NECK_ABOVE * size

    knee = joints[joint_index("left_knee"), 1]
    middle = vertices[(np.abs(vertices[:, 0]) < _SLICE) & (vertices[:, 1] > knee), 1]

    def surface(x: float) -> float:
        near = (np.abs(vertices[:, 0] - x) < _SLICE) & (vertices[:, 1] < neck_top)
        return float(vertices[near, 1].max() - floor)

    return Measurements(
        chest=tape.bust,
        waist=tape.waist,
        hips=tape.hips,
        neck_width=neck_width,
        shoulder_width=shoulder_width,
        shoulder_height=surface(0.5 * neck_width),
        shoulder_tip_height=surface(0.5 * shoulder_width),
        waist_height=tape.waist_level,
        hips_height=tape.hips_level,
        crotch_height=float(middle.min() - floor),
        knee_height=float(knee - floor),
        armhole_depth=DEFAULT.armhole_depth * size,
        upper_arm=DEFAULT.upper_arm * size,
        wrist=DEFAULT.wrist * size,
        thigh=DEFAULT.thigh * tape.hips / DEFAULT.hips,
        ankle=DEFAULT.ankle * size,
        leg_distance=float(joints[joint_index("left_ankle"), 0]),
    )
