"""A synthetic person: a random body in loose clothes, seen by a ring of cameras (S7.12)."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from dress_jax.body.model import BodyModel
from dress_jax.body.poses import named_pose
from dress_jax.body.skeleton import JOINTS, joint_index
from dress_jax.reconstruction.landmarks import TABLE, landmark_map, landmark_points
from dress_jax.reconstruction.parameters import (
    FACE,
    BodyParameters,
    body_in_world,
    make_parameters,
)
from dress_jax.reconstruction.prior import pose_limits
from dress_jax.reconstruction.views import BodyViews, make_body_views
from dress_jax.render.cameras import project, stack_cameras
from dress_jax.render.images import render_views
from dress_jax.render.mesh import make_render_mesh
from dress_jax.render.rings import frame_body, magicman_cameras

CLOTH = (0.25, 0.35, 0.6)
_EASE = 0.03  # of the top, along the normals [m]
_FLARE = 1.2  # of the skirt's hem
_TOP = ("spine1", "spine2", "spine3", "left_collar", "right_collar", "left_shoulder",
        "right_shoulder", "pelvis")  # fmt: skip
_SKIRT = ("pelvis", "left_hip", "right_hip")
_LEVELS, _AROUND = 16, 64


@dataclasses.dataclass(frozen=True)
class Scene:
    """A person and what is known of it.

    Attributes:
        truth: the body.
        views: what a reconstruction gets.
        hidden: part of the body's pixels that clothes hide.
        clothes: vertices and faces of the clothes.
    """

    truth: BodyParameters
    views: BodyViews
    hidden: float
    clothes: tuple[np.ndarray, np.ndarray]


def random_truth(model: BodyModel, seed: int) -> BodyParameters:
    """A body of normal shape coefficients, a named pose varied by a fifth of every joint's range,
    a scale of 0.85 to 1.15, any heading and up to 15 degrees of lean."""
    rng = np.random.default_rng(seed)
    low, high = pose_limits()
    low[0], high[0] = 0.0, 0.0
    pose = named_pose(("a", "relaxed", "arms_up")[seed % 3])
    amount = np.where([name[-1].isdigit() for name in JOINTS], 0.1, 0.2)[:, None]
    pose = np.clip(pose + amount * (high - low) * rng.uniform(-1.0, 1.0, pose.shape), low, high)
    pose[[joint_index(name) for name in FACE]] = 0.0
    lean = Rotation.from_euler("xz", rng.uniform(-15.0, 15.0, 2), degrees=True)
    pose[0] = (
        Rotation.from_euler("y", rng.uniform(-180.0, 180.0), degrees=True) * lean
    ).as_rotvec()
    return make_parameters(
        model,
        pose=pose,
        shape=rng.normal(size=model.shapedirs.shape[2]),
        scale=rng.uniform(0.85, 1.15),
        translation=rng.uniform(-0.1, 0.1, 3) + np.array([0.0, 0.95, 0.0]),
    )


def wrong_estimate(model: BodyModel, truth: BodyParameters, seed: int) -> BodyParameters:
    """What a network might say: joints off by 8 degrees, shape by half a deviation (standard
    deviations), the rotation by 60 degrees and the scale by 20 %, the place unknown."""
    rng = np.random.default_rng(seed)
    pose = np.asarray(truth.pose) + np.radians(8.0) * rng.normal(size=truth.pose.shape)
    pose[[joint_index(name) for name in FACE]] = 0.0
    axis = rng.normal(size=3)
    turn = Rotation.from_rotvec(np.radians(60.0) * axis / np.linalg.norm(axis))
    pose[0] = (turn * Rotation.from_rotvec(np.array(truth.pose[0]))).as_rotvec()
    shape = np.asarray(truth.shape) + 0.5 * rng.normal(size=truth.shape.shape)
    return make_parameters(model, pose=pose, shape=shape, scale=1.2 * truth.scale)


def make_scene(
    model: BodyModel,
    truth: BodyParameters,
    *,
    views: int = 20,
    size: int = 512,
    noise: float = 0.0,
    hidden_noise: float = 2.0,
    seed: int = 0,
    dressed: bool = True,
) -> Scene:
    """Dress and photograph a body.

    Args:
        model: the body model.
        truth: the person.
        views: number of cameras on the ring.
        size: of every picture [px].
        noise: standard deviation of landmarks that clothes do not hide [px].
        hidden_noise: of the others [px].
        seed: of noise and skin.
        dressed: whether there are clothes.
    """
    rng = np.random.default_rng(seed)
    vertices = np.asarray(body_in_world(model, truth).vertices)
    faces = np.asarray(model.faces)
    clothes = _clothes(model, vertices, faces)
    everything = np.concatenate([vertices, clothes[0]]) if dressed else vertices
    center, half_extent = frame_body(everything)
    cameras = stack_cameras(
        magicman_cameras(views, center=center, half_extent=half_extent, size=size)
    )
    colors = np.concatenate([_skin(model, rng), np.tile(CLOTH, (len(clothes[0]), 1))])
    kinds = np.repeat(np.eye(2), (len(vertices), len(clothes[0])), axis=0)
    union = np.concatenate([faces, clothes[1] + len(vertices)])

    def photograph(lift: float):
        """The person, the clothes lifted out of sight by some metres."""
        both = np.concatenate([vertices, clothes[0] + np.array([0.0, lift, 0.0])])
        mesh = make_render_mesh(
            jnp.asarray(both),
            union,
            colors=jnp.asarray(colors, jnp.float32),
            attributes=jnp.asarray(kinds, jnp.float32),
        )
        return _draw(cameras, mesh)

    bare = photograph(100.0)
    image = photograph(0.0) if dressed else bare
    body_part, cloth_part = (np.asarray(image.attributes)[..., k] for k in range(2))
    # As a segmentation would be grown by a pixel, since its border is not exact.
    occluded = _grown(cloth_part > 0.0)
    share = float(1.0 - np.sum(body_part) / np.sum(np.asarray(bare.mask)))
    depth = np.where(np.asarray(image.face) >= len(faces), np.asarray(image.depth), np.inf)
    mask = np.clip(np.asarray(image.mask), 0.0, 1.0)
    color = np.clip(np.asarray(image.color) + (1.0 - mask)[..., None], 0.0, 1.0)

    points = np.asarray(landmark_points(landmark_map(model), truth))
    column, row, away = (
        np.array(part) for part in jax.vmap(lambda c: project(c, jnp.asarray(points)))(cameras)
    )
    inside = [np.clip(np.round(part).astype(int), 0, size - 1) for part in (row, column)]
    hidden = depth[np.arange(views)[:, None], inside[0], inside[1]] < away
    spread = np.where(hidden, hidden_noise, noise)[..., None]
    landmarks = np.stack([column, row], axis=2) + spread * rng.normal(size=(*column.shape, 2))
    return Scene(
        truth=truth,
        views=make_body_views(
            cameras,
            landmarks,
            np.where(hidden, 0.5, 0.9),
            landmark_ids=np.array([target.index for target in TABLE]),
            mask=mask,
            color=color,
            occluded=occluded,
        ),
        hidden=share,
        clothes=clothes,
    )


_draw = jax.jit(lambda cameras, mesh: render_views(cameras, mesh))


def _skin(model: BodyModel, rng: np.random.Generator) -> np.ndarray:
    """Smooth patches of colour about a skin tone."""
    rest = np.asarray(model.template)
    waves = rng.normal(size=(6, 3)) * 12.0
    phases = rng.uniform(0.0, 2.0 * np.pi, (6, 3))
    value = np.sin((rest @ waves.T)[:, :, None] + phases[None]).sum(axis=1)
    return np.clip(np.array([0.72, 0.54, 0.44])[None] + 0.06 * value, 0.0, 1.0)


def _clothes(
    model: BodyModel, vertices: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A loose top along the skin and a wide skirt to the knees."""
    owner = np.asarray(model.skin_weights).argmax(axis=1)
    on_top = np.isin(owner, [joint_index(name) for name in _TOP])
    kept = faces[on_top[faces].all(axis=1)]
    corner = vertices[faces]
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], area)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    used = np.unique(kept)
    renumber = np.full(len(vertices), -1)
    renumber[used] = np.arange(len(used))
    top = vertices[used] + _EASE * normals[used]
    skirt, skirt_faces = _skirt(vertices[np.isin(owner, [joint_index(name) for name in _SKIRT])])
    return (
        np.concatenate([top, skirt]),
        np.concatenate([renumber[kept], skirt_faces + len(top)]),
    )


def _skirt(inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An open cone about the vertical axis, wide enough for the points inside at every level."""
    axis = np.median(inside, axis=0)
    away = np.hypot(inside[:, 0] - axis[0], inside[:, 2] - axis[2])
    levels = np.linspace(inside[:, 1].max(), inside[:, 1].min(), _LEVELS)
    radius = np.array([np.max(away[inside[:, 1] >= level - 1e-9]) for level in levels])
    radius = (radius + _EASE) * np.linspace(1.0, _FLARE, _LEVELS)
    angle = np.linspace(0.0, 2.0 * np.pi, _AROUND, endpoint=False)
    rings = np.stack(
        [
            axis[0] + radius[:, None] * np.cos(angle)[None],
            np.repeat(levels[:, None], _AROUND, axis=1),
            axis[2] + radius[:, None] * np.sin(angle)[None],
        ],
        axis=2,
    ).reshape(-1, 3)
    here = np.arange((_LEVELS - 1) * _AROUND)
    aside = here // _AROUND * _AROUND + (here + 1) % _AROUND
    below, diagonal = here + _AROUND, aside + _AROUND
    faces = [np.stack([here, below, aside], axis=1), np.stack([aside, below, diagonal], axis=1)]
    return rings, np.concatenate(faces)


def _grown(region: np.ndarray) -> np.ndarray:
    """A region and the pixels beside it."""
    from scipy.ndimage import binary_dilation

    square = np.ones((1, 3, 3), bool)
    return binary_dilation(region, square).astype(np.float32)
