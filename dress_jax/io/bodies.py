"""Rigged bodies: the embedded default, SMPL-X npz files, and what a command line names."""

import dataclasses
import importlib.resources
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.body.model import BodyModel, forward, named_shape
from dress_jax.body.poses import POSES, named_pose
from dress_jax.body.shaping import shape_with
from dress_jax.core.errors import InputError
from dress_jax.io.arrays import read_npz
from dress_jax.io.body_meshes import load_body_mesh

# What an SMPL-X file must hold; hand means and pose correctives are optional.
SMPLX_KEYS = ("v_template", "f", "shapedirs", "weights", "J_regressor", "kintree_table")
SMPLX_EXPRESSIONS = 100


@dataclasses.dataclass(frozen=True)
class LoadedBody:
    """A body ready for draping.

    Args:
        vertices: posed positions [m], shape (n, 3).
        faces: triangles, shape (f, 3).
        model: the rig, or None for a static mesh.
        pose: the pose of `vertices` [rad], shape (55, 3), or None for a static mesh.
        shape: its shape coefficients, shape (b,), or None for a static mesh.
    """

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "f 3"]
    model: BodyModel | None = None
    pose: Float[np.ndarray, "55 3"] | None = None
    shape: Float[np.ndarray, " b"] | None = None


def load_default_body() -> BodyModel:
    """The embedded body: 12,272 vertices, 55 joints, 16 shape components, T pose, feet at y = 0."""
    resource = importlib.resources.files("dress_jax.body") / "data" / "default_body.npz"
    with importlib.resources.as_file(resource) as path, np.load(path) as data:
        directions = data["shapedirs_quantized"] * data["shapedirs_quantum"][:, None, None]
        indices, influences = data["skin_indices"], data["skin_weights"].astype(np.float64)
        weights = np.zeros((len(indices), len(data["parents"])))
        np.put_along_axis(weights, indices.astype(np.int64), influences, axis=1)
        weights /= weights.sum(axis=1, keepdims=True)
        return BodyModel(
            template=_real(data["v_template"]),
            shapedirs=_real(np.moveaxis(directions, 0, 2)),
            posedirs=None,
            joint_template=_real(data["J_template"]),
            joint_shapedirs=_real(np.moveaxis(data["J_shapedirs"], 0, 2)),
            skin_weights=_real(weights),
            pose_mean=_real(np.zeros_like(data["J_template"])),
            named_shapes=_real(data["shape_values"]),
            faces=jnp.asarray(data["f"].astype(np.int32)),
            parents=tuple(int(parent) for parent in data["parents"]),
            shape_names=tuple(str(name) for name in data["shape_names"]),
        )


def load_body_model(
    path: str | Path, *, shape_components: int = 16, flat_hands: bool = True
) -> BodyModel:
    """A rigged body from an SMPL-X `.npz` file (S7.1).

    Args:
        path: the file, keys as distributed by its authors.
        shape_components: how many shape components to keep.
        flat_hands: keep hands flat at zero pose; otherwise the file's mean hand pose is added.

    Returns:
        The body model; its rest pose has the pelvis near the origin, as in the file.

    Raises:
        InputError: the file is missing, is no npz, lacks keys or holds arrays of wrong shapes.
    """
    path = Path(path)
    arrays = read_npz(path)
    missing = [key for key in SMPLX_KEYS if key not in arrays]
    if missing:
        raise InputError(
            f"lacks {', '.join(missing)}",
            where=str(path),
            mend="give an SMPL-X model in npz form (SMPLX_NEUTRAL.npz, for example)",
        )
    template = arrays["v_template"].astype(np.float64)
    parents = arrays["kintree_table"].astype(np.int64)[0].copy()
    parents[0] = -1  # the file holds an unsigned placeholder
    joints = len(parents)
    available = _shape_count(arrays["shapedirs"])
    if not 0 < shape_components <= available:
        raise InputError(
            f"has {available} shape components, {shape_components} were asked for",
            where=str(path),
            mend=f"ask for 1 to {available}",
        )
    directions = arrays["shapedirs"][:, :, :shape_components].astype(np.float64)
    regressor = arrays["J_regressor"].astype(np.float64)
    weights = arrays["weights"].astype(np.float64)
    _check_shape(path, "v_template", template, (len(template), 3))
    _check_shape(path, "shapedirs", directions, (len(template), 3, shape_components))
    _check_shape(path, "weights", weights, (len(template), joints))
    _check_shape(path, "J_regressor", regressor, (joints, len(template)))
    posedirs = arrays.get("posedirs")
    if posedirs is not None:
        _check_shape(path, "posedirs", posedirs, (len(template), 3, 9 * (joints - 1)))
    pose_mean = np.zeros((joints, 3))
    if not flat_hands:
        for key, first in (("hands_meanl", 25), ("hands_meanr", 40)):
            if key not in arrays or arrays[key].size != 45 or joints != 55:
                raise InputError(
                    f"has no mean hand pose '{key}'", where=str(path), mend="use flat_hands=True"
                )
            pose_mean[first : first + 15] = arrays[key].reshape(15, 3)
    return BodyModel(
        template=_real(template),
        shapedirs=_real(directions),
        posedirs=None if posedirs is None else _real(posedirs),
        joint_template=_real(regressor @ template),
        # Regressing joints from vertices is linear, so it is applied to each component once.
        joint_shapedirs=_real(np.einsum("jn,ndb->jdb", regressor, directions)),
        skin_weights=_real(weights),
        pose_mean=_real(pose_mean),
        named_shapes=_real(np.zeros((0, shape_components))),
        faces=jnp.asarray(arrays["f"].astype(np.int32)),
        parents=tuple(int(parent) for parent in parents),
        shape_names=(),
    )


def body_from_argument(
    body: str | Path = "default", *, pose: str | Path = "t", shape: str | Path = "average"
) -> LoadedBody:
    """The body that a command's options name.

    Args:
        body: "default", an SMPL-X `.npz` file, or a static mesh file in metres.
        pose: a named pose ("t", "a", "relaxed", "arms_up"), or an `.npz` file with `pose` or
            `poses` [rad] and optionally `betas`; static meshes keep their own pose.
        shape: a named shape of the default body ("average", "female", "male", ...), or measures of
            a rigged one [m], as "height=1.72,bust=0.95,waist=0.78,hips=1.0", any of them.

    Raises:
        InputError: a name is unknown, no shape has the measures, a file cannot be used, or a pose
            is asked of a static mesh.
    """
    if str(body) == "default":
        model = load_default_body()
    elif Path(body).suffix.lower() == ".npz":
        model = load_body_model(body)
    else:
        if str(pose) != "t" or str(shape) != "average":
            raise InputError(
                "a static mesh can be neither posed nor shaped",
                where=str(body),
                mend="leave pose and shape out, or use the default body",
            )
        vertices, faces = load_body_mesh(body)
        return LoadedBody(vertices=vertices, faces=faces)

    coefficients = _shape_argument(model, str(shape))
    rotations, from_file = _pose_argument(pose, joints=len(model.parents))
    if from_file is not None:
        if str(body) == "default":
            raise InputError(
                "holds SMPL-X shape coefficients, which mean nothing on the default body",
                where=str(pose),
                mend="remove 'betas' from the file, or give an SMPL-X body",
            )
        coefficients = jnp.asarray(from_file[: coefficients.shape[0]], coefficients.dtype)
    state = forward(
        model,
        jnp.asarray(rotations, model.template.dtype),
        coefficients,
        jnp.zeros(3, model.template.dtype),
    )
    return LoadedBody(
        vertices=np.asarray(state.vertices, dtype=np.float64),
        faces=np.asarray(model.faces),
        model=model,
        pose=rotations,
        shape=np.asarray(coefficients),
    )


def _shape_argument(model: BodyModel, shape: str) -> Float[Array, " b"]:
    if "=" not in shape:
        try:
            return named_shape(model, shape)
        except ValueError as error:
            raise InputError(str(error), where="shape") from error
    wanted = {}
    for part in shape.split(","):
        name, _, number = part.partition("=")
        try:
            wanted[name.strip()] = float(number)
        except ValueError as error:
            raise InputError(
                f"'{part}' is no measure", where="shape", mend="write height=1.72,waist=0.78"
            ) from error
    return jnp.asarray(shape_with(model, wanted), model.template.dtype)


def _pose_argument(pose: str | Path, *, joints: int) -> tuple[np.ndarray, np.ndarray | None]:
    if str(pose) in POSES:
        return named_pose(str(pose)), None
    path = Path(pose)
    if path.suffix.lower() != ".npz":
        raise InputError(
            f"'{pose}' is neither a named pose nor an npz file",
            where="pose",
            mend=f"give one of {', '.join(POSES)}, or a file ending in .npz",
        )
    arrays = read_npz(path)
    key = "pose" if "pose" in arrays else "poses"
    if key not in arrays:
        raise InputError("holds no 'pose'", where=str(path), mend="save the pose under that key")
    values = arrays[key].astype(np.float64)
    if values.ndim == 2 and values.shape[0] == 1 and values.shape[1] == 3 * joints:
        values = values[0]  # a sequence of one
    if values.size != 3 * joints or not np.isfinite(values).all():
        raise InputError(
            f"'{key}' has shape {values.shape}, or holds numbers that are not finite",
            where=str(path),
            mend=f"give one pose of {joints} rotation vectors [rad], shape ({joints}, 3)",
        )
    betas = arrays.get("betas")
    return values.reshape(joints, 3), None if betas is None else np.ravel(betas)


def _shape_count(directions: np.ndarray) -> int:
    """Shape components of a file whose last components are expressions of the face."""
    if directions.ndim != 3:
        return 0
    total = directions.shape[2]
    if total == 400:
        return total - SMPLX_EXPRESSIONS
    return total // 2 if total == 20 else total  # version 1.0: ten and ten


def _check_shape(path: Path, key: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise InputError(
            f"'{key}' has shape {array.shape}, expected {shape}",
            where=str(path),
            mend="give an unmodified SMPL-X file",
        )
    if not np.isfinite(array).all():
        raise InputError(f"'{key}' holds numbers that are not finite", where=str(path))


def _real(array: np.ndarray) -> jnp.ndarray:
    """Double precision where it is turned on, single otherwise."""
    return jnp.asarray(np.asarray(array, dtype=jnp.zeros(0).dtype))
