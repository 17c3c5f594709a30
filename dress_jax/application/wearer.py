"""Who wears the garment: the body to dress, and its way to the pose that is asked for (S8.6)."""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from dress_jax.body.model import BodyModel, forward
from dress_jax.body.poses import POSES, interpolate_poses, named_pose
from dress_jax.core.errors import InputError
from dress_jax.io.bodies import body_from_argument

DEFAULT_BODY = "default"
_LARGEST_TURN = np.radians(5.0)  # of a joint from one frame to the next


@dataclasses.dataclass(frozen=True)
class Wearer:
    """A body from the pose in which it is dressed to the pose in which it ends.

    Args:
        start: vertices in the dressing pose [m], shape (b, 3).
        faces: triangles, shape (k, 3).
        way: vertices of the poses that follow, the last one being the pose that is asked for; none
            where it is the dressing pose, shape (frames, b, 3).
        settings: the options that the body came from, for reports.
    """

    start: Float[np.ndarray, "b 3"]
    faces: Int[np.ndarray, "k 3"]
    way: Float[np.ndarray, "frames b 3"]
    settings: dict[str, str] = dataclasses.field(default_factory=dict)

    @property
    def vertices(self) -> Float[np.ndarray, "b 3"]:
        """The body in its final pose [m]."""
        return self.way[-1] if len(self.way) else self.start


def static_wearer(
    vertices: Float[np.ndarray, "b 3"], faces: Int[np.ndarray, "k 3"], **settings: str
) -> Wearer:
    """A body that keeps its pose."""
    vertices = np.asarray(vertices, np.float64)
    return Wearer(
        start=vertices,
        faces=np.asarray(faces),
        way=np.zeros((0, *vertices.shape)),
        settings=settings,
    )


def find_wearer(
    body: str | Path = DEFAULT_BODY,
    *,
    pose: str | Path | None = None,
    shape: str = "average",
    dressing_pose: str | None = None,
) -> Wearer:
    """The body that options name.

    A rigged body stands with its feet at y = 0 in the dressing pose, where patterns are placed.

    Args:
        body: "default", an SMPL-X `.npz` file, or a static mesh in metres.
        pose: a named pose or an `.npz` file; None for the dressing pose.
        shape: a named shape of the default body.
        dressing_pose: named pose for which the pattern's panels are placed; None for "t".

    Raises:
        InputError: an unknown name, an unusable file, or a pose asked of a static mesh.
    """
    settings = {
        "body": str(body),
        "pose": "" if pose is None else str(pose),
        "shape": shape,
        "dressing_pose": "" if dressing_pose is None else dressing_pose,
    }
    if dressing_pose is not None and dressing_pose not in POSES:
        raise InputError(
            f"'{dressing_pose}' is no named pose",
            where="dressing pose",
            mend=f"give one of {', '.join(POSES)}",
        )
    # A file may hold a shape too, so the body is always found through the final pose.
    final = body_from_argument(body, pose="t" if pose is None else pose, shape=shape)
    if final.model is None or final.pose is None or final.shape is None:
        if dressing_pose is not None:
            raise InputError(
                "a static mesh has no dressing pose", where=str(body), mend="leave it out"
            )
        return static_wearer(final.vertices, final.faces, **settings)
    first = named_pose("t" if dressing_pose is None else dressing_pose)
    last = first if pose is None else final.pose
    start = _posed(final.model, first, final.shape)
    floor = np.array([0.0, start[:, 1].min(), 0.0])
    way = [_posed(final.model, turned, final.shape) - floor for turned in _between(first, last)]
    return Wearer(
        start=start - floor,
        faces=np.asarray(final.faces),
        way=np.array(way).reshape(-1, *start.shape),
        settings=settings,
    )


def fitted_wearer(
    model: BodyModel,
    pose: Float[np.ndarray, "55 3"],
    shape: Float[np.ndarray, " b"],
    *,
    scale: float = 1.0,
    dressing_pose: str = "t",
    **settings: str,
) -> Wearer:
    """A body that was fitted to pictures, from the dressing pose into its own (S8.6).

    It stands with its feet at y = 0 in the dressing pose and turns about its pelvis from there, so
    that nothing but the joints moves on the way; `pelvis_of` says where the pelvis stays.

    Args:
        model: the rig.
        pose: of the pictures [rad], row 0 the global rotation.
        shape: coefficients.
        scale: of the whole body.
        dressing_pose: named pose for which panels are placed.
        settings: for reports.
    """
    first, last = named_pose(dressing_pose), np.asarray(pose, np.float64)
    start = scale * _posed(model, first, shape)
    floor = np.array([0.0, start[:, 1].min(), 0.0])
    way = [scale * _posed(model, turned, shape) - floor for turned in _between(first, last)]
    return Wearer(
        start=start - floor,
        faces=np.asarray(model.faces),
        way=np.array(way).reshape(-1, *start.shape),
        settings={"dressing_pose": dressing_pose, **settings},
    )


def pelvis_of(
    model: BodyModel, shape: Float[np.ndarray, " b"], *, scale: float, dressing_pose: str = "t"
) -> Float[np.ndarray, "3"]:
    """Where `fitted_wearer` has its pelvis, from first to last [m]."""
    floor = scale * float(_posed(model, named_pose(dressing_pose), shape)[:, 1].min())
    directions = np.asarray(model.joint_shapedirs)[0, :, : len(shape)]
    pelvis = np.asarray(model.joint_template)[0] + directions @ np.asarray(shape)
    return scale * pelvis - np.array([0.0, floor, 0.0])


def _between(first: np.ndarray, last: np.ndarray) -> list[np.ndarray]:
    """Poses after the first one, at most `_LARGEST_TURN` apart."""
    turn = float(np.max(np.linalg.norm(last - first, axis=1), initial=0.0))
    if turn == 0.0:
        return []
    return list(interpolate_poses(first, last, steps=int(np.ceil(turn / _LARGEST_TURN)) + 1)[1:])


def _posed(model: BodyModel, pose: np.ndarray, shape: np.ndarray) -> np.ndarray:
    real = model.template.dtype
    state = forward(model, jnp.asarray(pose, real), jnp.asarray(shape, real), jnp.zeros(3, real))
    return np.asarray(state.vertices, np.float64)
