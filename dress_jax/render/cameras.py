"""Cameras: projection, the rings of the multi-view generators, plain dictionaries (S6.2, S6.4).

Pixel centres lie at whole numbers: column 0, row 0 is the centre of the upper left pixel, columns
grow to the right and rows downward. `toward` points from the scene to the camera.
"""

import enum
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Num

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import pytree, static


class CameraKind(enum.Enum):
    """How depth enters the projection."""

    ORTHOGRAPHIC = "orthographic"
    PERSPECTIVE = "perspective"


@pytree
class Camera:
    """One camera, or a stack of cameras with one more leading axis on every array.

    Args:
        rotation: rows right, up, toward, in world coordinates, shape (3, 3).
        position: eye [m], shape (3,). For an orthographic camera only depths depend on how far
            along `toward` it lies.
        scale: pixels per metre (orthographic) or focal length [px] (perspective), along columns and
            rows, shape (2,).
        principal: column and row of the point that the eye looks at [px], shape (2,).
        near: depth [m] below which nothing is seen, shape ().
        kind: the projection.
        height: image height [px].
        width: image width [px].
    """

    rotation: Float[Array, "3 3"]
    position: Float[Array, "3"]
    scale: Float[Array, "2"]
    principal: Float[Array, "2"]
    near: Float[Array, ""]
    kind: CameraKind = static()
    height: int = static()
    width: int = static()


def view_coordinates(camera: Camera, points: Num[Array, "n 3"]) -> tuple[Array, Array, Array]:
    """Coordinates along right and up, and depth away from the eye [m], each of shape (n,)."""
    offset = points - camera.position[None, :]
    # Written out: a matrix product may run in reduced precision on accelerators.
    right, up, toward = (jnp.sum(offset * camera.rotation[None, k], axis=1) for k in range(3))
    return right, up, -toward


def project(
    camera: Camera, points: Float[Array, "n 3"]
) -> tuple[Float[Array, "n"], Float[Array, "n"], Float[Array, "n"]]:
    """Pixel coordinates and depth of points; differentiable in points and camera.

    Args:
        camera: one camera (not a stack).
        points: world positions [m], shape (n, 3).

    Returns:
        Pixel x (column), pixel y (row), and depth along the viewing direction [m]. For a
        perspective camera, points at or behind the eye give pixel coordinates without meaning.
    """
    right, up, depth = view_coordinates(camera, points)
    if camera.kind is CameraKind.PERSPECTIVE:
        safe = jnp.where(depth == 0, 1.0, depth)
        right, up = right / safe, up / safe
    return (
        camera.principal[0] + camera.scale[0] * right,
        camera.principal[1] - camera.scale[1] * up,
        depth,
    )


def orthographic_camera(
    *,
    rotation: Num[np.ndarray, "3 3"],
    position: Num[np.ndarray, "3"],
    half_extent: float,
    height: int,
    width: int | None = None,
    near: float = 0.0,
) -> Camera:
    """An orthographic camera whose image shows +-`half_extent` metres vertically.

    Raises:
        InputError: a size or extent is not positive, or the rotation is not orthonormal.
    """
    width = height if width is None else width
    _positive("orthographic_camera", half_extent=half_extent, height=height, width=width)
    scale = 0.5 * height / half_extent
    return _camera(
        rotation, position, [scale, scale], None, near, CameraKind.ORTHOGRAPHIC, height, width
    )


def perspective_camera(
    *,
    rotation: Num[np.ndarray, "3 3"],
    position: Num[np.ndarray, "3"],
    focal: float | Sequence[float],
    height: int,
    width: int | None = None,
    principal: Sequence[float] | None = None,
    near: float = 0.01,
) -> Camera:
    """A pinhole camera.

    Args:
        rotation: rows right, up, toward.
        position: eye [m].
        focal: focal length [px], one number or (columns, rows).
        principal: principal point [px] with pixel centres at whole numbers; the image centre
            `((width - 1) / 2, (height - 1) / 2)` when None.
        near: near plane [m], positive.

    Raises:
        InputError: a size, focal length or near plane is not positive, or the rotation is not
            orthonormal.
    """
    width = height if width is None else width
    scale = np.broadcast_to(np.asarray(focal, dtype=float), (2,))
    _positive("perspective_camera", focal=scale.min(), height=height, width=width, near=near)
    return _camera(
        rotation, position, scale, principal, near, CameraKind.PERSPECTIVE, height, width
    )


def look_at_camera(
    eye: Num[np.ndarray, "3"],
    target: Num[np.ndarray, "3"],
    *,
    vertical_angle: float,
    height: int,
    width: int | None = None,
    up: Sequence[float] = (0.0, 1.0, 0.0),
    near: float = 0.01,
) -> Camera:
    """A pinhole camera at `eye` that looks at `target`.

    Args:
        eye: camera position [m].
        target: the point in the middle of the image [m].
        vertical_angle: full field of view along the rows [rad].
        up: the direction that is drawn upward.

    Raises:
        InputError: eye and target coincide, or `up` is parallel to the viewing direction.
    """
    _positive("look_at_camera", vertical_angle=vertical_angle, height=height)
    toward = np.asarray(eye, dtype=float) - np.asarray(target, dtype=float)
    right = np.cross(np.asarray(up, dtype=float), toward)
    if np.linalg.norm(toward) == 0 or np.linalg.norm(right) <= 1e-9 * np.linalg.norm(toward):
        raise InputError(
            "eye and target coincide, or up is parallel to the viewing direction",
            where="look_at_camera",
            mend="move the eye or choose another up direction",
        )
    toward, right = toward / np.linalg.norm(toward), right / np.linalg.norm(right)
    return perspective_camera(
        rotation=np.stack([right, np.cross(toward, right), toward]),
        position=np.asarray(eye, dtype=float),
        focal=0.5 * height / np.tan(0.5 * vertical_angle),
        height=height,
        width=width,
        near=near,
    )


def stack_cameras(cameras: Sequence[Camera]) -> Camera:
    """One stack of cameras of equal kind and size, for `render_views`.

    Raises:
        InputError: the list is empty, or kinds or image sizes differ.
    """
    if len({(c.kind, c.height, c.width) for c in cameras}) != 1:
        raise InputError(
            "a stack needs at least one camera, all of one kind and size", where="stack_cameras"
        )
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *cameras)


def unstack_cameras(cameras: Camera) -> list[Camera]:
    """The cameras of a stack, in order."""
    return [
        jax.tree.map(lambda leaf: leaf[i], cameras)  # noqa: B023
        for i in range(cameras.rotation.shape[0])
    ]


def cameras_to_dict(cameras: Sequence[Camera]) -> dict[str, Any]:
    """Cameras as plain lists and numbers, ready for JSON."""
    return {
        "convention": "pixel centres at whole numbers; rotation rows right, up, toward; metres",
        "cameras": [
            {
                "kind": camera.kind.value,
                "height": camera.height,
                "width": camera.width,
                "rotation": np.asarray(camera.rotation, dtype=float).tolist(),
                "position": np.asarray(camera.position, dtype=float).tolist(),
                "scale": np.asarray(camera.scale, dtype=float).tolist(),
                "principal": np.asarray(camera.principal, dtype=float).tolist(),
                "near": float(camera.near),
            }
            for camera in cameras
        ],
    }


def cameras_from_dict(data: Mapping[str, Any]) -> list[Camera]:
    """Cameras from `cameras_to_dict`.

    Raises:
        InputError: an entry is missing or malformed; the message names the camera.
    """
    if not isinstance(data.get("cameras"), list):
        raise InputError("no list 'cameras'", where="camera file")
    result = []
    for index, entry in enumerate(data["cameras"]):
        where = f"camera file, camera {index}"
        try:
            kind = CameraKind(entry["kind"])
            height, width = int(entry["height"]), int(entry["width"])
            scale = np.asarray(entry["scale"], dtype=float).reshape(2)
            _positive(where, scale=scale.min(), height=height, width=width)
            result.append(
                _camera(
                    np.asarray(entry["rotation"], dtype=float).reshape(3, 3),
                    np.asarray(entry["position"], dtype=float).reshape(3),
                    scale,
                    entry["principal"],
                    float(entry["near"]),
                    kind,
                    height,
                    width,
                )
            )
        except (KeyError, TypeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"bad or missing entry ({error!r})", where=where) from error
    return result


def _positive(where: str, **values: float) -> None:
    for name, value in values.items():
        if not value > 0:
            raise InputError(f"{name} is {value}; it has to be positive", where=where)


def _camera(rotation, position, scale, principal, near, kind, height, width) -> Camera:
    rotation = np.asarray(rotation, dtype=float)
    if rotation.shape != (3, 3) or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-5:
        raise InputError("the rotation is not a 3x3 orthonormal matrix", where="camera")
    if principal is None:
        principal = [0.5 * (width - 1), 0.5 * (height - 1)]
    return Camera(
        rotation=jnp.asarray(rotation),
        position=jnp.asarray(np.asarray(position, dtype=float).reshape(3)),
        scale=jnp.asarray(np.asarray(scale, dtype=float).reshape(2)),
        principal=jnp.asarray(np.asarray(principal, dtype=float).reshape(2)),
        near=jnp.asarray(float(near)),
        kind=kind,
        height=int(height),
        width=int(width),
    )
