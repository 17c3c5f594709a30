"""Where on which panel a pixel looks: panel coordinates rendered as vertex attributes (S14.2)."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Num

from dress_jax.core.buckets import bucket_size
from dress_jax.core.pytree import replace
from dress_jax.render.attributes import attributes_at
from dress_jax.render.cameras import Camera, CameraKind
from dress_jax.render.visibility import rasterize, to_screen
from dress_jax.texture.surface import PanelSurface

WINDOW = 512
"""Pixels along each side of what one call draws; larger pictures are drawn in windows of this size,
so that pictures and atlases of all sizes share one program."""

CHANNELS = 8
"""Attributes at least, for the same reason."""

Occluder = tuple[Num[np.ndarray, "b 3"], Int[np.ndarray, "g 3"]]
"""Vertices [m] and faces of what may hide the garment, such as the body."""


@dataclasses.dataclass(frozen=True)
class Sight:
    """What the pixel centres of one view see, not antialiased.

    Attributes:
        face: shape (h, w); -1 on the background. An occluder's faces follow the mesh's own.
        values: attributes of the mesh, without meaning where `face` is none of its own, shape
            (h, w, c).
        side: +1 where the face runs counter-clockwise in the picture, else -1, shape (h, w).
    """

    face: Int[np.ndarray, "h w"]
    values: Float[np.ndarray, "h w c"]
    side: Float[np.ndarray, "h w"]


@dataclasses.dataclass(frozen=True)
class PanelMap:
    """The panels in one view.

    Attributes:
        panel: shape (h, w); -1 where no panel is seen.
        coordinates: on the panel [m], shape (h, w, 2).
        cosine: between the cloth's normal, turned to the viewer, and the direction to the eye,
            shape (h, w).
        side: +1 where the side is seen from which faces run counter-clockwise, else -1.
        spacing: distance of neighbouring rays at the surface [m], shape (h, w).
    """

    panel: Int[np.ndarray, "h w"]
    coordinates: Float[np.ndarray, "h w 2"]
    cosine: Float[np.ndarray, "h w"]
    side: Float[np.ndarray, "h w"]
    spacing: Float[np.ndarray, "h w"]


def see(
    camera: Camera,
    positions: Num[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    attributes: Num[np.ndarray, "n c"],
    occluder: Occluder | None = None,
) -> Sight:
    """Faces and interpolated attributes at the pixel centres.

    Arrays are padded to shape buckets, so that meshes of similar size share a program.

    Args:
        camera: one camera.
        positions: vertices [m], shape (n, 3).
        faces: shape (f, 3).
        attributes: of the vertices, shape (n, c).
        occluder: hides the mesh.
    """
    count = len(positions)
    positions, faces = np.asarray(positions, np.float32), np.asarray(faces, np.int32)
    if occluder is not None:
        positions = np.concatenate([positions, np.asarray(occluder[0], np.float32)])
        faces = np.concatenate([faces, np.asarray(occluder[1], np.int32) + count])
    rows, channels = bucket_size(len(positions)), attributes.shape[1]
    table = np.zeros((rows, max(channels, CHANNELS)), np.float32)
    table[:count, :channels] = attributes
    # Padded faces join vertex 0 with itself and are never drawn.
    positions = np.pad(positions, [(0, rows - len(positions)), (0, 0)])
    faces = np.pad(faces, [(0, bucket_size(len(faces)) - len(faces)), (0, 0)])
    shape = (camera.height, camera.width)
    face = np.full(shape, -1, np.int32)
    values, side = np.zeros((*shape, channels), np.float32), np.ones(shape, np.float32)
    for top in range(0, camera.height, WINDOW):
        for left in range(0, camera.width, WINDOW):
            seen = _see(_window(camera, top, left), positions, faces, table)
            inside = (slice(top, top + WINDOW), slice(left, left + WINDOW))
            size = face[inside].shape
            whole = [np.asarray(a).reshape(WINDOW, WINDOW, -1)[: size[0], : size[1]] for a in seen]
            face[inside] = whole[0][..., 0]
            values[inside] = whole[1][..., :channels]
            side[inside] = whole[2][..., 0]
    return Sight(face, values, side)


def panel_map(camera: Camera, surface: PanelSurface, occluder: Occluder | None = None) -> PanelMap:
    """The panels as one camera sees them.

    Args:
        camera: one camera.
        surface: the garment.
        occluder: the body, which hides parts of it.
    """
    attributes = np.concatenate([surface.coordinates, surface.normals, surface.positions], axis=1)
    sight = see(camera, surface.positions, surface.faces, attributes, occluder)
    own = owned(sight, surface)
    points = sight.values[..., 5:].reshape(-1, 3)
    cosine, spacing = view_of_points(camera, points, sight.values[..., 2:5].reshape(-1, 3))
    # A smooth normal may point away from the eye on the very face that is seen.
    cosine = np.maximum(cosine.reshape(own.shape) * sight.side, 0.0)
    panel = surface.face_panels[np.where(own, sight.face, 0)]
    return PanelMap(
        panel=np.where(own, panel, -1),
        coordinates=np.where(own[..., None], sight.values[..., :2], 0.0),
        cosine=np.where(own, cosine, 0.0),
        side=sight.side,
        spacing=spacing.reshape(own.shape),
    )


def owned(sight: Sight, surface: PanelSurface) -> Bool[np.ndarray, "h w"]:
    """Pixels that see the surface itself: neither background nor occluder."""
    return (sight.face >= 0) & (sight.face < len(surface.faces))


def view_of_points(
    camera: Camera, points: Float[np.ndarray, "q 3"], normals: Float[np.ndarray, "q 3"]
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, " q"]]:
    """How points of a surface lie in a view.

    Returns:
        Signed cosine between normal and direction to the eye, and the distance of neighbouring rays
        there [m], each of shape (q,).
    """
    rotation = np.asarray(camera.rotation, np.float64)
    scale = float(np.asarray(camera.scale).mean())
    if camera.kind is CameraKind.ORTHOGRAPHIC:
        return normals @ rotation[2], np.full(len(points), 1.0 / scale)
    away = np.asarray(camera.position, np.float64) - points
    length = np.maximum(np.linalg.norm(away, axis=1), 1e-12)
    return (normals * away).sum(axis=1) / length, np.maximum(away @ rotation[2], 1e-12) / scale


def project_points(
    camera: Camera, points: Float[np.ndarray, "q 3"]
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, " q"]]:
    """Columns and rows of points [px], on the host; NaN behind the eye."""
    rotation = np.asarray(camera.rotation, np.float64)
    right, up, toward = rotation @ (points - np.asarray(camera.position, np.float64)).T
    if camera.kind is CameraKind.PERSPECTIVE:
        depth = np.where(toward < -float(camera.near), -toward, np.nan)
        right, up = right / depth, up / depth
    scale, principal = (np.asarray(a, np.float64) for a in (camera.scale, camera.principal))
    return principal[0] + scale[0] * right, principal[1] - scale[1] * up


@jax.jit
def _see(camera, positions, faces, attributes):
    face, _ = rasterize(camera, to_screen(camera, positions), faces)
    pixel = jnp.arange(face.shape[0], dtype=jnp.int32)
    seen = (jnp.maximum(face, 0), pixel % camera.width, pixel // camera.width)
    values = attributes_at(camera, positions, faces, attributes, seen, fragment=_with_side)
    return face, values[:, :-1], values[:, -1]


def _with_side(values, facing):
    return jnp.concatenate([values, facing[:, None].astype(values.dtype)], axis=1)


def _window(camera: Camera, top: int, left: int) -> Camera:
    """A part of the picture, in single precision, so that one program serves whatever made it."""
    part = replace(
        camera,
        principal=np.asarray(camera.principal) - np.array([left, top]),
        height=WINDOW,
        width=WINDOW,
    )
    return jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), part)
