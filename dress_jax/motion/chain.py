"""Forward kinematics of whole clips on the host: world rotations and joints of every frame."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation


def matrices(vectors: Float[np.ndarray, "*s 3"]) -> Float[np.ndarray, "*s 3 3"]:
    """Rotation matrices of rotation vectors [rad] of any leading shape."""
    vectors = np.asarray(vectors, np.float64)
    return Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(*vectors.shape, 3)


def vectors(rotations: Float[np.ndarray, "*s 3 3"]) -> Float[np.ndarray, "*s 3"]:
    """Rotation vectors [rad], at most half a turn long, of matrices of any leading shape."""
    shape = rotations.shape[:-1]
    return Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_rotvec().reshape(shape)


def world_rotations(
    parents: tuple[int, ...], local: Float[np.ndarray, "t j 3 3"]
) -> Float[np.ndarray, "t j 3 3"]:
    """Rotations against the world of rotations against the parents.

    Args:
        parents: of the joints, -1 for the root; parents come first.
        local: rotations of every frame, shape (t, j, 3, 3).
    """
    world = np.array(local)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            world[:, joint] = world[:, parent] @ local[:, joint]
    return world


def local_rotations(
    parents: tuple[int, ...], world: Float[np.ndarray, "t j 3 3"]
) -> Float[np.ndarray, "t j 3 3"]:
    """The inverse of `world_rotations`."""
    local = np.array(world)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            local[:, joint] = np.swapaxes(world[:, parent], -1, -2) @ world[:, joint]
    return local


def joint_places(
    parents: tuple[int, ...],
    world: Float[np.ndarray, "t j 3 3"],
    joints: Float[np.ndarray, "j 3"],
) -> Float[np.ndarray, "t j 3"]:
    """Joints of every frame relative to the root [m].

    Args:
        parents: of the joints.
        world: from `world_rotations`.
        joints: in the rest pose [m], shape (j, 3).
    """
    places = np.zeros((*world.shape[:2], 3))
    for joint, parent in enumerate(parents):
        if parent >= 0:
            bone = joints[joint] - joints[parent]
            places[:, joint] = places[:, parent] + world[:, parent] @ bone
    return places
