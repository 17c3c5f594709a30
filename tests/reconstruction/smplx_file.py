"""The embedded body under the keys of an SMPL-X file of version 1.0, with correctives."""

from pathlib import Path

import numpy as np

from dress_jax.body.skeleton import PARENTS
from dress_jax.io.bodies import load_default_body

NEAREST = 12
"""Vertices from which each joint is regressed."""


def write_smplx_file(path: Path) -> Path:
    """Write it; joints are means of the vertices around them, about where they were."""
    body = load_default_body()
    rest, joints = np.asarray(body.template), np.asarray(body.joint_template)
    regressor = np.zeros((55, len(rest)))
    for joint, place in enumerate(joints):
        near = np.argsort(np.linalg.norm(rest - place, axis=1))[:NEAREST]
        regressor[joint, near] = 1.0 / NEAREST
    rng = np.random.default_rng(0)
    tree = np.array([PARENTS, range(55)], dtype=np.int64)
    tree[0, 0] = 2**32 - 1
    np.savez(
        path,
        v_template=rest,
        f=np.asarray(body.faces).astype(np.uint32),
        shapedirs=np.concatenate([np.asarray(body.shapedirs)[:, :, :10]] * 2, axis=2),
        posedirs=1e-4 * rng.normal(size=(len(rest), 3, 486)).astype(np.float32),
        weights=np.asarray(body.skin_weights),
        J_regressor=regressor,
        kintree_table=tree,
    )
    return path
