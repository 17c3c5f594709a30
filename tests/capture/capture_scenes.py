"""Small bundles and folders of other tools, made by the tests themselves."""

import json

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from dress_jax.capture import BodyEstimate, Bundle, ClothesLabel, Landmarks, Surface, View
from dress_jax.capture.body import CAMERA_TO_WORLD
from dress_jax.capture.landmarks import COUNT
from dress_jax.pattern.specification import parse_specification
from dress_jax.render.rings import ring_cameras

SIZE = 48
SQUARE = {
    "pattern": {
        "panels": {
            "front": {
                "vertices": [[0, 0], [20.3, 0], [20, 30], [0, 31.7]],
                "edges": [{"endpoints": [k, (k + 1) % 4]} for k in range(4)],
                "translation": [0.1, 100, 20],
                "rotation": [0, 30, 0],
            }
        },
        "stitches": [],
    },
    "properties": {"curvature_coords": "relative", "units_in_meter": 100},
}


def body(rng, **changes):
    values = {
        "betas": rng.normal(size=10),
        "global_orient": rng.normal(size=3),
        "body_pose": 0.3 * rng.normal(size=(21, 3)),
        "left_hand_pose": rng.normal(size=(15, 3)),
        "right_hand_pose": rng.normal(size=(15, 3)),
        "jaw_pose": rng.normal(size=3),
        "left_eye_pose": rng.normal(size=3),
        "right_eye_pose": rng.normal(size=3),
        "expression": rng.normal(size=10),
        "transl": rng.normal(size=3),
        "to_world": CAMERA_TO_WORLD,
        "origin": rng.normal(size=3),
    }
    return BodyEstimate(**(values | changes))


def landmarks(rng, size=SIZE):
    return Landmarks(points=size * rng.random((COUNT, 2)), confidence=rng.random(COUNT))


def labels():
    """An asymmetric map: a dress left of the middle, hair above it, skin at the right."""
    result = np.zeros((SIZE, SIZE), np.uint8)
    result[10:40, 8:20] = ClothesLabel.DRESS
    result[4:10, 8:14] = ClothesLabel.HAIR
    result[20:30, 30:36] = ClothesLabel.SKIN
    return result


def camera(azimuth=30.0, size=SIZE):
    [made] = ring_cameras([azimuth], size=size, center=[0.1, 0.9, -0.2], half_extent=1.1)
    return made


def view(rng, name, azimuth=30.0):
    normal = rng.normal(size=(SIZE, SIZE, 3)).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    normal[:5] = 0.0
    gray = [rng.integers(0, 256, (SIZE, SIZE), dtype=np.uint8) for _ in range(4)]
    return View(
        name=name,
        camera=camera(azimuth),
        rgb=rng.integers(0, 256, (SIZE, SIZE, 3), dtype=np.uint8),
        matte=gray[0],
        mask=gray[1],
        parts={"top": gray[2], "bottom": gray[3]},
        hidden=gray[0] // 2,
        normal=normal,
        landmarks=landmarks(rng),
    )


def full_bundle():
    """Every part, and no value that a coarser form could hold."""
    rng = np.random.default_rng(5)
    vertices = rng.normal(size=(7, 3))
    faces = np.array([[0, 1, 2], [2, 3, 6]])
    return Bundle(
        image=rng.integers(0, 256, (SIZE, SIZE, 3), dtype=np.uint8),
        matte=rng.integers(0, 256, (SIZE, SIZE), dtype=np.uint8),
        labels=labels(),
        landmarks=landmarks(rng),
        body=body(rng, scale=1.23),
        body_mesh=Surface(vertices, faces),
        scan=Surface(
            vertices[::-1],
            np.zeros((0, 3), int),
            labels=np.arange(7, dtype=np.uint8),
            colors=rng.integers(0, 256, (7, 3), dtype=np.uint8),
        ),
        views=(view(rng, "018"), View("bare", camera(-70.0))),
        pattern=parse_specification(SQUARE, source="square"),
        sources={"image": "camera", "views": "a generator"},
    )


def save(path, pixels, mode=None):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels, mode).save(path)
    return path


def write(path, document):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document))
    return path


def magicman_body(vectors):
    """MagicMan's file for 53 joint rotations, hands as matrices and the rest as two columns."""
    matrices = Rotation.from_rotvec(vectors).as_matrix()
    return {
        "betas": np.arange(10.0).tolist(),
        "global_orient": matrices[0, :, :2].ravel().tolist(),
        "body_pose": matrices[1:22, :, :2].tolist(),
        "exp": [0.5] * 10,
        "jaw_pose": matrices[22].tolist(),
        "left_hand_pose": matrices[23:38].tolist(),
        "right_hand_pose": matrices[38:53].tolist(),
        "trans": [0.1, 0.2, 0.3],
        "scale": 0.8,
    }
