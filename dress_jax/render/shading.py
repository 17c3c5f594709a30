"""Pictures for people: garment and body under a soft light on white, as 8-bit images.

Not a loss image: colours are lit, and nothing is meant to be differentiated. Arrays are padded to
shape buckets, so that meshes of similar size share one compiled program.
"""

import colorsys
from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Num, UInt8

from dress_jax.core.buckets import bucket_size
from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.render.attributes import render_attributes
from dress_jax.render.cameras import Camera
from dress_jax.render.mesh import build_adjacency, unit_rows
from dress_jax.render.rings import frame_body, ring_cameras

BODY_COLOR = (0.80, 0.76, 0.73)
"""Skin-grey."""

GARMENT_COLOR = (0.36, 0.53, 0.75)

SUPERSAMPLING = 2
"""Pixels per image pixel along each axis; they are averaged."""

PREVIEW_AZIMUTHS = (0.0, 90.0, 180.0)
"""Front, the wearer's left side, back [degrees]."""

_LIGHT = np.array([-0.35, 0.55, 0.76])
"""Towards the light: above the camera's left shoulder, in right, up, toward coordinates."""


def palette(count: int) -> Float[np.ndarray, "k 3"]:
    """Distinct muted colours, RGB in [0, 1]; the first ones do not depend on the count."""
    golden = 0.618033988749895
    colors = [
        colorsys.hsv_to_rgb((0.58 + golden * i) % 1.0, (0.52, 0.38, 0.62)[i % 3], 0.82)
        for i in range(count)
    ]
    return np.asarray(colors, dtype=float).reshape(-1, 3)


def label_colors(labels: Num[np.ndarray, "k"]) -> Float[np.ndarray, "k 3"]:
    """A palette colour for every face or vertex from its panel or component number."""
    labels = np.asarray(labels, dtype=np.int64)
    if labels.size and labels.min() < 0:
        raise InputError("a label is negative", where="label_colors")
    return palette(int(labels.max(initial=-1)) + 1)[labels]


def shade(
    camera: Camera,
    meshes: Sequence[tuple[Array | np.ndarray, Array | np.ndarray, Array | np.ndarray]],
    *,
    supersampling: int = SUPERSAMPLING,
) -> UInt8[np.ndarray, "h w 3"]:
    """One lit picture of some meshes.

    Args:
        camera: one camera.
        meshes: (vertices [m] (n, 3), faces (f, 3), colours) each; colours are RGB in [0, 1], one
            for the mesh (3,), one per vertex (n, 3), or one per face (f, 3). Where n equals f,
            they are taken per vertex.
        supersampling: pixels per image pixel along each axis.

    Raises:
        InputError: there is no mesh, or colours have none of these shapes.
    """
    if not meshes:
        raise InputError("there is no mesh to draw", where="shade")
    parts = [_prepare(*mesh) for mesh in meshes]
    offsets = np.cumsum([0] + [len(part[0]) for part in parts])
    positions, normals, colors = (np.concatenate([p[k] for p in parts]) for k in range(3))
    faces = np.concatenate([p[3] + o for p, o in zip(parts, offsets[:-1], strict=True)])
    weld = np.concatenate([p[4] + o for p, o in zip(parts, offsets[:-1], strict=True)])
    adjacency = build_adjacency(faces, weld)
    rows, corners = bucket_size(len(positions)), bucket_size(len(faces))
    fine = _supersampled(camera, supersampling)
    picture = _draw(
        supersampling,
        fine,
        _padded(positions.astype(np.float32), rows, 0),
        _padded(normals.astype(np.float32), rows, 0),
        _padded(colors.astype(np.float32), rows, 0),
        _padded(faces.astype(np.int32), corners, 0),
        _padded(adjacency, corners, -1),
    )
    return np.asarray(picture)


def preview(
    garment: tuple[Array | np.ndarray, Array | np.ndarray, Array | np.ndarray | None],
    body: tuple[Array | np.ndarray, Array | np.ndarray] | None = None,
    *,
    azimuths: Sequence[float] = PREVIEW_AZIMUTHS,
    size: int = 512,
    supersampling: int = SUPERSAMPLING,
) -> UInt8[np.ndarray, "h w 3"]:
    """Front, side and back of a dressed body next to one another.

    Args:
        garment: vertices [m], faces, and colours as in `shade`, or None for a plain one.
        body: vertices [m] and faces.
        azimuths: of the views [degrees]; positive moves the camera to +x.
        size: height and width of each view [px].
        supersampling: see `shade`.
    """
    vertices, faces, colors = garment
    meshes = [(vertices, faces, np.asarray(GARMENT_COLOR) if colors is None else colors)]
    everything = np.asarray(vertices, dtype=float)
    if body is not None:
        meshes.append((*body, np.asarray(BODY_COLOR)))
        everything = np.concatenate([everything, np.asarray(body[0], dtype=float)])
    center, half_extent = frame_body(everything)
    cameras = ring_cameras(azimuths, size=size, center=center, half_extent=half_extent)
    return np.concatenate(
        [shade(camera, meshes, supersampling=supersampling) for camera in cameras], axis=1
    )


def _prepare(vertices, faces, colors):
    """Positions, normals, colours, faces, weld map; faces are taken apart for colours per face."""
    vertices, faces = np.asarray(vertices, dtype=float), np.asarray(faces, dtype=np.int64)
    colors = np.asarray(colors, dtype=float)
    normals = _host_normals(vertices, faces)
    if colors.shape == (3,):
        colors = np.broadcast_to(colors, vertices.shape)
    if colors.shape == vertices.shape:
        return vertices, normals, colors, faces, np.arange(len(vertices))
    if colors.shape != faces.shape:
        raise InputError(
            f"colours have shape {colors.shape}",
            where="shade",
            mend=f"give (3,), {vertices.shape} or {faces.shape}",
        )
    corner = faces.reshape(-1)
    apart = np.arange(len(corner)).reshape(-1, 3)
    return vertices[corner], normals[corner], np.repeat(colors, 3, axis=0), apart, corner


def _host_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corner = vertices[faces]
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.stack(
        [
            np.bincount(faces.reshape(-1), np.repeat(area[:, k], 3), minlength=len(vertices))
            for k in range(3)
        ],
        axis=1,
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 0)


def _padded(array: np.ndarray, size: int, value: int) -> np.ndarray:
    """Rows up to `size`; padded faces join vertex 0 with itself and are never drawn."""
    missing = size - len(array)
    return np.pad(array, [(0, missing), (0, 0)], constant_values=value)


def _supersampled(camera: Camera, factor: int) -> Camera:
    """The same picture with `factor` times the pixels along each axis."""
    return replace(
        camera,
        scale=camera.scale * factor,
        # Pixel centres at whole numbers: the corner of the image is at -1/2.
        principal=(camera.principal + 0.5) * factor - 0.5,
        height=camera.height * factor,
        width=camera.width * factor,
    )


@partial(jax.jit, static_argnums=(0,))
def _draw(supersampling, camera, positions, normals, colors, faces, adjacency):
    in_view = jnp.stack([jnp.sum(normals * r[None, :], axis=1) for r in camera.rotation], axis=1)
    image = render_attributes(
        camera,
        positions,
        faces,
        jnp.concatenate([colors, in_view.astype(colors.dtype)], axis=1),
        adjacency,
        background=jnp.ones(3),
        fragment=_lit,
    )
    height, width = camera.height // supersampling, camera.width // supersampling
    mean = image.reshape(height, supersampling, width, supersampling, 3).mean(axis=(1, 3))
    return jnp.round(255 * jnp.clip(mean, 0.0, 1.0)).astype(jnp.uint8)


def _lit(values: Float[Array, "q 6"], facing: Float[Array, "q"]) -> Array:
    normal = unit_rows(values[:, 3:] * facing[:, None])
    light = jnp.asarray(_LIGHT / np.linalg.norm(_LIGHT), normal.dtype)
    # Wrapped diffuse light has no hard terminator; grazing surfaces darken a little, which
    # separates folds from what lies behind them.
    diffuse = 0.5 + 0.5 * jnp.sum(normal * light[None, :], axis=1)
    brightness = 0.30 + 0.72 * diffuse * jnp.sqrt(diffuse)
    brightness = brightness * (0.72 + 0.28 * jnp.clip(normal[:, 2], 0.0, 1.0))
    # The inside of cloth is drawn a little darker than its outside.
    brightness = brightness * jnp.where(facing > 0, 1.0, 0.8)
    return values[:, :3] * brightness[:, None]
