"""The images that the losses compare: mask, colour, normal, further channels, depth (S10).

The garment is drawn with its own attributes and the occluder, usually the body, with zeros in every
channel, so that only what is seen of the garment counts (S10.2).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import pytree
from dress_jax.render.attributes import (
    Seen,
    attributes_at,
    find_visibility,
    render_attributes,
)
from dress_jax.render.cameras import Camera, CameraKind
from dress_jax.render.mesh import RenderMesh, join_meshes, unit_rows, vertex_normals
from dress_jax.render.silhouettes import STEP_LIMIT


@pytree
class Image:
    """One view, or a stack of views with one more leading axis. float32.

    Args:
        mask: part of each pixel that the visible garment covers, in [0, 1], shape (h, w).
        color: antialiased RGB, shape (h, w, 3).
        normal: antialiased world-frame normal of the garment, turned towards the camera, unit
            length inside, zero on occluder and background, shape (h, w, 3) (S22.18).
        attributes: antialiased further channels, shape (h, w, c).
        depth: along the viewing direction at pixel centres [m], infinite on background; holds no
            derivative and is not antialiased, shape (h, w).
        face: visible face, garment first, then occluder; -1 on background, shape (h, w).
        unfinished: silhouette walks that met their step limit, shape (). See `check_image`.
    """

    mask: Float[Array, "h w"]
    color: Float[Array, "h w 3"]
    normal: Float[Array, "h w 3"]
    attributes: Float[Array, "h w c"]
    depth: Float[Array, "h w"]
    face: Int[Array, "h w"]
    unfinished: Int[Array, ""]


def render(
    camera: Camera,
    garment: RenderMesh,
    occluder: RenderMesh | None = None,
    *,
    background: Float[Array, "3"] | None = None,
    step_limit: int | Int[Array, ""] = STEP_LIMIT,
) -> Image:
    """Draw a garment in front of, behind and around an occluder.

    Differentiable in positions, colours, attributes, background and camera; visibility is held
    fixed. To draw a body in its own colours, pass it as the garment.

    Args:
        camera: one camera.
        garment: the mesh that is seen.
        occluder: a mesh that hides it and is black in every channel; its colours are not used.
        background: RGB behind everything, shape (3,); black when None.
        step_limit: see `find_visibility`.
    """
    positions, faces, adjacency = join_meshes(garment, occluder)
    count = garment.positions.shape[0]
    channels = jnp.concatenate(
        [
            jnp.ones((count, 1), jnp.float32),
            garment.colors.astype(jnp.float32),
            vertex_normals(garment.positions, garment.faces).astype(jnp.float32),
            garment.attributes.astype(jnp.float32),
        ],
        axis=1,
    )
    channels = jnp.pad(channels, [(0, positions.shape[0] - count), (0, 0)])
    color = jnp.zeros(3) if background is None else jnp.asarray(background)
    behind = jnp.zeros(channels.shape[1], jnp.float32).at[1:4].set(color.astype(jnp.float32))
    visibility = find_visibility(camera, positions, faces, adjacency, step_limit=step_limit)
    image = render_attributes(
        camera,
        positions,
        faces,
        channels,
        adjacency,
        background=behind,
        fragment=_turn_normals,
        visibility=visibility,
    )
    shape = (camera.height, camera.width)
    perspective = camera.kind is CameraKind.PERSPECTIVE
    depth = jnp.where(
        visibility.ids < 0,
        jnp.inf,
        -1.0 / visibility.keys if perspective else visibility.keys,
    )
    return Image(
        mask=image[..., 0],
        color=image[..., 1:4],
        normal=image[..., 4:7],
        attributes=image[..., 7:],
        depth=depth.reshape(shape),
        face=visibility.ids.reshape(shape),
        unfinished=visibility.silhouettes.unfinished,
    )


def render_views(
    cameras: Camera,
    garment: RenderMesh,
    occluder: RenderMesh | None = None,
    *,
    background: Float[Array, "3"] | None = None,
    step_limit: int | Int[Array, ""] = STEP_LIMIT,
) -> Image:
    """`render` for every camera of a stack, one after the other, so that buffers are reused.

    For the gradient of a loss over many views, `mean_over_views` needs less memory.

    Returns:
        A stack of images; leading axis: views.
    """
    return jax.lax.map(
        lambda camera: render(
            camera, garment, occluder, background=background, step_limit=step_limit
        ),
        cameras,
    )


def check_image(image: Image) -> Image:
    """The image, if every silhouette walk came to an end. Host side.

    Raises:
        InputError: a walk met the step limit, so that part of a contour has no gradient.
    """
    unfinished = int(jnp.sum(image.unfinished))
    if unfinished:
        raise InputError(
            f"{unfinished} silhouette walks met their step limit",
            where="render",
            mend="raise step_limit, coarsen the mesh or enlarge the image",
        )
    return image


def normals_at(
    camera: Camera,
    garment: RenderMesh,
    seen: Seen,
) -> Float[Array, "q 3"]:
    """The garment's normals where pixels see given faces of it; `attributes_at` for normals.

    Args:
        camera: one camera.
        garment: the mesh.
        seen: face, column and row of every pixel, each of shape (q,).

    Returns:
        World-frame unit normals, turned towards the camera, shape (q, 3).
    """
    normals = vertex_normals(garment.positions, garment.faces)
    return attributes_at(
        camera, garment.positions, garment.faces, normals, seen, fragment=towards_camera
    )


def towards_camera(values: Float[Array, "q 3"], facing: Float[Array, "q"]) -> Array:
    """Unit normals on the camera's side: cloth has two, and its faces may show either."""
    return unit_rows(values * facing[:, None])


def _turn_normals(values: Float[Array, "q c"], facing: Float[Array, "q"]) -> Array:
    """The channels of `render`, their normals towards the camera."""
    normal = towards_camera(values[:, 4:7], facing)
    return jnp.concatenate([values[:, :4], normal, values[:, 7:]], axis=1)
