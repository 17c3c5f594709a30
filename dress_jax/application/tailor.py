"""Measurements for the pattern templates, taken from the default body."""

import jax.numpy as jnp
import numpy as np

from dress_jax.body.measurements import measure
from dress_jax.body.model import BodyModel, forward
from dress_jax.body.skeleton import joint_index
from dress_jax.pattern.templates import DEFAULT, Measurements

_SLICE = 0.012  # half-width of the slices in which the shoulders' height is looked up [m]
_NECK_ABOVE = 0.05  # the neck ends, and the head begins, this far above the neck joint [m]


def template_measurements(model: BodyModel, shape: np.ndarray) -> Measurements:
    """What `pattern.templates` needs of a body: girths by tape, heights from surface and joints.

    Args:
        model: the rig.
        shape: its shape coefficients.

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
    vertices, joints = np.asarray(state.vertices), np.asarray(state.joints)
    floor = vertices[:, 1].min()
    shoulder = joints[joint_index("left_shoulder")]
    tape = measure(vertices, np.asarray(model.faces), half_width=float(shoulder[0]))
    scale = tape.height / 1.68  # the defaults' height
    neck_width = DEFAULT.neck_width * scale
    shoulder_width = 2.0 * float(shoulder[0]) + 0.03 * scale
    neck_top = joints[joint_index("neck"), 1] + _NECK_ABOVE * scale

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
        knee_height=float(joints[joint_index("left_knee"), 1] - floor),
        armhole_depth=DEFAULT.armhole_depth * scale,
        upper_arm=DEFAULT.upper_arm * scale,
    )
