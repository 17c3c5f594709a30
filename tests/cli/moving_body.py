"""The small body without limbs as an SMPL-X file, so that it can move."""

from pathlib import Path

import numpy as np
from command_scenes import turned_body

from dress_jax.body.skeleton import JOINTS, PARENTS

# Heights and sides of joints in a tube of 1.6 m; all others are where their parents are [m].
_PLACES = {
    "pelvis": (0.0, 0.85), "spine1": (0.0, 0.95), "spine2": (0.0, 1.05), "spine3": (0.0, 1.15),
    "neck": (0.0, 1.35), "head": (0.0, 1.45),
    "left_hip": (0.05, 0.80), "left_knee": (0.05, 0.45), "left_ankle": (0.05, 0.05),
    "right_hip": (-0.05, 0.80), "right_knee": (-0.05, 0.45), "right_ankle": (-0.05, 0.05),
}  # fmt: skip
# The trunk bends, the legs are one and go with the pelvis.
_BENDS = ("pelvis", "spine1", "spine2", "spine3", "neck", "head")


def write_moving_body(path: Path) -> Path:
    """Write it."""
    vertices, faces = turned_body()
    places = np.zeros((len(JOINTS), 3))
    for joint, name in enumerate(JOINTS):
        side, height = _PLACES.get(name, (0.0, 0.0))
        places[joint] = (side, height, 0.0) if name in _PLACES else places[PARENTS[joint]]
    # Joints as combinations of vertices that give their places exactly.
    basis = np.concatenate([vertices.T, np.ones((1, len(vertices)))])
    wanted = np.concatenate([places.T, np.ones((1, len(JOINTS)))])
    regressor = (np.linalg.pinv(basis) @ wanted).T
    weights = np.zeros((len(vertices), len(JOINTS)))
    bends = [JOINTS.index(name) for name in _BENDS]
    heights = places[bends, 1]
    for vertex, y in enumerate(vertices[:, 1]):
        place = np.interp(y, heights, np.arange(len(bends)))
        low, part = int(place), place - int(place)
        weights[vertex, bends[low]] += 1.0 - part
        if part > 0.0:
            weights[vertex, bends[low + 1]] += part
    tree = np.array([PARENTS, range(len(JOINTS))], dtype=np.int64)
    tree[0, 0] = 2**32 - 1
    np.savez(
        path,
        v_template=vertices,
        f=faces.astype(np.uint32),
        shapedirs=np.zeros((len(vertices), 3, 16)),
        weights=weights,
        J_regressor=regressor,
        kintree_table=tree,
    )
    return path
