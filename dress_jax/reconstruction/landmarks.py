"""COCO-WholeBody landmarks as points of a body model (S7.4, S7.5).

Detectors give 133 points: body 0-16, feet 17-22, face 23-90, left hand 91-111, right hand 112-132.
The table names a joint for each, or a point of the surface by a rule: of the vertices that follow
some joint, the one that lies farthest in a direction, on the mean shape in the rest pose. Rules,
rather than vertex numbers, serve any mesh. Points of the face are left out: the embedded body has
no expressions, and nose, eyes and ears tell where the head is.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from dress_jax.body.model import BodyModel
from dress_jax.body.skeleton import FINGERS, JOINTS, joint_index
from dress_jax.core.pytree import pytree, replace, static
from dress_jax.reconstruction.parameters import BodyParameters, body_in_world

COCO_WHOLEBODY = 133
"""Landmarks of COCO-WholeBody."""

HIP_TRUST = 0.5
"""Factor on the confidence of hips: annotators mark them farther out than bodies have them."""

_HAND = ("thumb", "index", "middle", "ring", "pinky")


class Target(NamedTuple):
    """The point of a body model that a landmark means.

    Attributes:
        index: number of the landmark in COCO-WholeBody.
        name: of the landmark.
        joint: a joint of the body, or the joint that a point of the surface follows.
        direction: the point of the surface lies farthest in this direction, x to the wearer's left,
            y up, z to the front; zero for the direction of a finger; None for the joint itself.
    """

    index: int
    name: str
    joint: str
    direction: tuple[float, float, float] | None = None


def _both(index: int, name: str, joint: str, direction=None, *, apart: int = 1) -> list[Target]:
    """A landmark of the left side and its twin, `apart` numbers later, mirrored."""
    mirrored = None if direction is None else (-direction[0], *direction[1:])
    left = joint if joint in JOINTS else f"left_{joint}"
    right = joint if joint in JOINTS else f"right_{joint}"
    return [
        Target(index, f"left_{name}", left, direction),
        Target(index + apart, f"right_{name}", right, mirrored),
    ]


def _table() -> tuple[Target, ...]:
    rows = [Target(0, "nose", "head", (0.0, 0.0, 1.0))]
    rows += _both(1, "eye", "eye")
    rows += _both(3, "ear", "head", (1.0, 0.0, 0.0))
    for index, name in enumerate(("shoulder", "elbow", "wrist", "hip", "knee", "ankle")):
        rows += _both(5 + 2 * index, name, name)
    rows += _both(17, "big_toe", "foot", (-0.4, 0.0, 1.0), apart=3)
    rows += _both(18, "small_toe", "foot", (1.0, 0.0, 0.5), apart=3)
    rows += _both(19, "heel", "ankle", (0.0, -0.5, -1.0), apart=3)
    rows += _both(91, "hand_root", "wrist", apart=21)
    for finger, name in enumerate(_HAND):
        assert name in FINGERS
        for k in range(3):
            rows += _both(92 + 4 * finger + k, f"{name}{k + 1}", f"{name}{k + 1}", apart=21)
        rows += _both(95 + 4 * finger, f"{name}_tip", f"{name}3", (0.0, 0.0, 0.0), apart=21)
    return tuple(sorted(rows))


TABLE = _table()
"""The 65 landmarks that are used, by their number in COCO-WholeBody."""


@pytree
class LandmarkMap:
    """Landmarks of one body model; k of them.

    Attributes:
        skin: the body model cut down to the s vertices that are landmarks.
        point: row of each landmark among the joints followed by those vertices, (k,).
        trust: factor on the confidence that a detector gives, (k,).
        indices: their numbers in COCO-WholeBody.
    """

    skin: BodyModel
    point: Array
    trust: Float[Array, " k"]
    indices: tuple[int, ...] = static()


def landmark_map(model: BodyModel) -> LandmarkMap:
    """Find the landmarks of `TABLE` on a body (host)."""
    vertices, points = [], []
    for target in TABLE:
        if target.direction is None:
            points.append(joint_index(target.joint))
        else:
            points.append(len(JOINTS) + len(vertices))
            vertices.append(_surface_vertex(model, target))
    trust = [HIP_TRUST if "hip" in target.name else 1.0 for target in TABLE]
    return LandmarkMap(
        skin=_cut(model, vertices),
        point=jnp.asarray(points, jnp.int32),
        trust=jnp.asarray(trust, model.template.dtype),
        indices=tuple(target.index for target in TABLE),
    )


def landmark_points(mapping: LandmarkMap, parameters: BodyParameters) -> Float[Array, "k 3"]:
    """Landmarks of a body in the world [m]; differentiable."""
    state = body_in_world(mapping.skin, parameters)
    return jnp.concatenate([state.joints, state.vertices])[mapping.point]


def _surface_vertex(model: BodyModel, target: Target) -> int:
    joint = joint_index(target.joint)
    rest = np.asarray(model.template)
    direction = np.asarray(target.direction)
    if not direction.any():  # along the finger
        joints = np.asarray(model.joint_template)
        direction = joints[joint] - joints[model.parents[joint]]
    own = np.flatnonzero(np.asarray(model.skin_weights).argmax(axis=1) == joint)
    if not len(own):  # a coarse mesh: the vertices that follow the joint most
        weights = np.asarray(model.skin_weights)[:, joint]
        own = np.flatnonzero(weights == weights.max())
    along = np.sum(rest[own] * direction[None, :], axis=1)
    return int(own[np.argmax(along)])


def _cut(model: BodyModel, vertices: Sequence[int]) -> BodyModel:
    """The same rig with some of the vertices and no faces."""
    rows = np.asarray(vertices, np.int64)
    return replace(
        model,
        template=model.template[rows],
        shapedirs=model.shapedirs[rows],
        posedirs=None if model.posedirs is None else model.posedirs[rows],
        skin_weights=model.skin_weights[rows],
        faces=model.faces[:0],
    )
