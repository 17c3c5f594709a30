"""A garment with its texture, and pictures of it by the project's own renderer (S14.4, S14.5)."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import map_coordinates

from dress_jax.core.pytree import replace
from dress_jax.render.cameras import Camera
from dress_jax.render.shading import BODY_COLOR
from dress_jax.texture.atlas import Atlas, atlas_coordinates
from dress_jax.texture.panel_maps import Occluder, owned, see
from dress_jax.texture.surface import PanelSurface
from dress_jax.texture.tiling import Tile


@dataclasses.dataclass(frozen=True)
class Texture:
    """Pictures on panels.

    Attributes:
        images: colours in [0, 1], row 0 at the top, each of shape (h, w, 3).
        names: of the images.
        coordinates: of every panel vertex, (0, 0) at an image's lower left corner and (1, 1) at its
            upper right one, shape (p, 2).
        panel_images: image of each panel, shape (panels,).
        repeat: whether images go on beyond their borders.
    """

    images: tuple[Float[np.ndarray, "h w 3"], ...]
    names: tuple[str, ...]
    coordinates: Float[np.ndarray, "p 2"]
    panel_images: Int[np.ndarray, " panels"]
    repeat: bool


def atlas_texture(
    image: Float[np.ndarray, "h w 3"], atlas: Atlas, surface: PanelSurface
) -> Texture:
    """One picture of all panels."""
    return Texture(
        images=(image,),
        names=("atlas",),
        coordinates=atlas_coordinates(atlas, surface),
        panel_images=np.zeros(len(surface.panels), np.int64),
        repeat=False,
    )


def tile_texture(tiles: Sequence[Tile], surface: PanelSurface) -> Texture:
    """A tile for every garment of an outfit, repeated over its panels at its physical size
    (S14.2): coordinates are panel coordinates over the tile's width and height."""
    corner = np.array([tile.corner for tile in tiles])
    size = np.array([tile.size for tile in tiles])
    which = surface.panel_components[surface.vertex_panels]
    return Texture(
        images=tuple(tile.image for tile in tiles),
        names=tuple(f"tile-{name}" for name in surface.components),
        coordinates=(surface.coordinates - corner[which]) / size[which],
        panel_images=surface.panel_components,
        repeat=True,
    )


def draw_textured(
    camera: Camera,
    surface: PanelSurface,
    texture: Texture,
    occluder: Occluder | None = None,
    *,
    supersampling: int = 2,
    lit: bool = True,
) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]:
    """A picture of a textured garment on white, box-filtered.

    Args:
        camera: one camera.
        surface: the garment.
        texture: its texture.
        occluder: the body.
        supersampling: samples per pixel along each axis.
        lit: a soft light from the upper left; otherwise plain colours.

    Returns:
        Colours in [0, 1], and coverage by the garment.
    """
    fine = _supersampled(camera, supersampling)
    attributes = np.concatenate([texture.coordinates, surface.normals], axis=1)
    sight = see(fine, surface.positions, surface.faces, attributes, occluder)
    own = owned(sight, surface)
    image = np.ones((*sight.face.shape, 3))
    panel = surface.face_panels[np.where(own, sight.face, 0)]
    which = np.where(own, texture.panel_images[panel], -1)
    for number, picture in enumerate(texture.images):
        at = which == number
        image[at] = _sampled(picture, sight.values[at][:, :2], repeat=texture.repeat)
    body = (sight.face >= 0) & ~own
    image[body] = BODY_COLOR
    if lit:
        normal = sight.values[..., 2:] * sight.side[..., None]
        if occluder is not None:
            normal[body] = _face_normals(fine, occluder)[sight.face[body] - len(surface.faces)]
        image = image * _brightness(fine, normal, own | body)[..., None]
    return _box(image, supersampling), _box(own.astype(np.float64)[..., None], supersampling)[
        ..., 0
    ]


def _sampled(image: np.ndarray, place: np.ndarray, *, repeat: bool) -> np.ndarray:
    height, width = image.shape[:2]
    at = [height * (1.0 - place[:, 1]) - 0.5, width * place[:, 0] - 0.5]
    mode = "grid-wrap" if repeat else "nearest"
    return np.stack([map_coordinates(image[..., k], at, order=1, mode=mode) for k in range(3)], -1)


def _brightness(camera: Camera, normal: np.ndarray, surface: np.ndarray) -> np.ndarray:
    """Diffuse light from above the camera's left shoulder; 1 on the background."""
    light = np.array([-0.35, 0.55, 0.76]) @ np.asarray(camera.rotation, np.float64)
    light /= np.linalg.norm(light)
    length = np.linalg.norm(normal, axis=-1)
    cosine = (normal @ light) / np.where(length > 0.0, length, 1.0)
    return np.where(surface, np.clip(0.62 + 0.40 * cosine, 0.0, 1.0), 1.0)


def _face_normals(camera: Camera, mesh: Occluder) -> np.ndarray:
    """Turned towards the camera."""
    corner = np.asarray(mesh[0], np.float64)[np.asarray(mesh[1])]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(length > 0.0, length, 1.0)
    return normal * np.where(normal @ np.asarray(camera.rotation)[2] < 0.0, -1.0, 1.0)[:, None]


def _supersampled(camera: Camera, factor: int) -> Camera:
    return replace(
        camera,
        scale=camera.scale * factor,
        # Pixel centres at whole numbers: the corner of the image is at -1/2.
        principal=(camera.principal + 0.5) * factor - 0.5,
        height=camera.height * factor,
        width=camera.width * factor,
    )


def _box(image: np.ndarray, factor: int) -> np.ndarray:
    height, width = image.shape[0] // factor, image.shape[1] // factor
    return image.reshape(height, factor, width, factor, -1).mean(axis=(1, 3))
