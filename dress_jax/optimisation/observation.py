"""What a fit looks at: images of a dressed body, and their making from a drape."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Num

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import pytree
from dress_jax.render.cameras import Camera
from dress_jax.render.images import check_image, render_views
from dress_jax.render.mesh import RenderMesh, make_render_mesh

_COVERED = 0.5  # a pixel counts as garment from half coverage on


@pytree
class Observation:
    """Images from v cameras, float32.

    Attributes:
        cameras: a stack of v cameras.
        mask: part of each pixel that the visible garment covers, (v, h, w).
        parts: the same by kind of garment, for masks that tell kinds apart (top, bottom, dress;
            S10.3), (v, h, w, c); equal to the mask where c is 1.
        color: RGB in [0, 1], zero off the garment, (v, h, w, 3).
        normal: world-frame unit normals towards the camera, zero off the garment, (v, h, w, 3).
        valid: 1 where the mask counts: off hair and accessories (complement of M^alpha), (v, h, w).
        garment: 1 where colours and normals count (M^beta), (v, h, w).
    """

    cameras: Camera
    mask: Float[Array, "v h w"]
    parts: Float[Array, "v h w c"]
    color: Float[Array, "v h w 3"]
    normal: Float[Array, "v h w 3"]
    valid: Float[Array, "v h w"]
    garment: Float[Array, "v h w"]

    @property
    def view_count(self) -> int:
        """Number of views."""
        return self.mask.shape[0]


def make_observation(
    cameras: Camera,
    mask: Num[np.ndarray, "v h w"],
    *,
    parts: Num[np.ndarray, "v h w c"] | None = None,
    color: Num[np.ndarray, "v h w 3"] | None = None,
    normal: Num[np.ndarray, "v h w 3"] | None = None,
    valid: Num[np.ndarray, "v h w"] | None = None,
    garment: Num[np.ndarray, "v h w"] | None = None,
) -> Observation:
    """An observation from arrays, checked once on the host.

    Args:
        cameras: a stack of v cameras.
        mask, parts, color, normal, valid, garment: see `Observation`. Missing colours or normals
            are zeros, to be used with a weight of zero; `valid` is everywhere and `garment` where
            the mask is above one half unless given; one part unless given.

    Raises:
        InputError: shapes that do not fit, numbers that are not finite, or a mask without garment.
    """
    mask = np.asarray(mask, np.float32)
    if mask.ndim != 3:
        raise InputError(f"masks have shape {mask.shape}, not (views, h, w)", where="observation")
    arrays = {
        "mask": mask,
        "parts": mask[..., None] if parts is None else parts,
        "color": np.zeros((*mask.shape, 3)) if color is None else color,
        "normal": np.zeros((*mask.shape, 3)) if normal is None else normal,
        "valid": np.ones(mask.shape) if valid is None else valid,
        "garment": mask > _COVERED if garment is None else garment,
    }
    for name, array in arrays.items():
        shape = (*mask.shape, 3) if name in ("color", "normal") else mask.shape
        if name == "parts":
            shape = (*mask.shape, max(np.shape(array)[-1], 1))
        if np.shape(array) != shape:
            raise InputError(
                f"{name} has shape {np.shape(array)}, not {shape}", where="observation"
            )
        if not np.all(np.isfinite(array)):
            raise InputError(f"{name} holds a number that is not finite", where="observation")
    expected = (len(mask), cameras.height, cameras.width)
    if cameras.rotation.ndim != 3 or (cameras.rotation.shape[0], *expected[1:]) != mask.shape:
        raise InputError(
            f"cameras of shape {cameras.rotation.shape[:-2]} and {expected[1:]} pixels do not fit "
            f"masks of shape {mask.shape}",
            where="observation",
            mend="stack one camera per view, with the size of the images",
        )
    if not np.any(mask > _COVERED):
        raise InputError("no view shows any garment", where="observation", mend="check the masks")
    return Observation(
        cameras=cameras, **{name: jnp.asarray(array, jnp.float32) for name, array in arrays.items()}
    )


_render_views = jax.jit(render_views, static_argnames=("step_limit",))


def observe(
    cameras: Camera,
    positions: Float[np.ndarray, "n 3"],
    faces: Num[np.ndarray, "f 3"],
    *,
    colors: Float[np.ndarray, "n 3"] | None = None,
    vertex_parts: Int[np.ndarray, " n"] | None = None,
    body_vertices: Float[np.ndarray, "b 3"] | None = None,
    body_faces: Num[np.ndarray, "k 3"] | None = None,
) -> Observation:
    """Draw a draped garment from every camera, hidden by the body where it is behind it.

    Args:
        cameras: a stack of cameras.
        positions, faces: the garment's welded mesh [m].
        colors: RGB per vertex; white when None.
        vertex_parts: kind of garment of every vertex, from 0; one kind when None.
        body_vertices, body_faces: the body [m]; none when None.

    Raises:
        InputError: meshes that do not fit, no garment in sight, or a contour that could not be
            followed.
    """
    if (body_vertices is None) != (body_faces is None):
        raise InputError("body_vertices and body_faces must come together", where="observe")
    paint = None if colors is None else jnp.asarray(colors)
    attributes = None if vertex_parts is None else part_channels(vertex_parts)
    garment = make_render_mesh(jnp.asarray(positions), faces, colors=paint, attributes=attributes)
    occluder = None
    if body_vertices is not None and body_faces is not None:
        occluder = make_render_mesh(jnp.asarray(body_vertices), body_faces)
    return observe_meshes(cameras, garment, occluder)


def part_channels(vertex_parts: Int[np.ndarray, " n"]) -> Float[Array, "n c"]:
    """One channel per part, 1 at its vertices; none where there is one part only."""
    count = int(np.max(vertex_parts, initial=0)) + 1
    if count == 1:
        return jnp.zeros((len(vertex_parts), 0), jnp.float32)
    return jnp.asarray(np.eye(count, dtype=np.float32)[vertex_parts])


def observe_meshes(
    cameras: Camera, garment: RenderMesh, occluder: RenderMesh | None
) -> Observation:
    """`observe` for meshes that are ready to draw; their attributes are channels of parts."""
    image = check_image(_render_views(cameras, garment, occluder))
    return make_observation(
        cameras,
        np.asarray(image.mask),
        parts=np.asarray(image.attributes) if image.attributes.shape[-1] > 1 else None,
        color=np.asarray(image.color),
        normal=np.asarray(image.normal),
    )
