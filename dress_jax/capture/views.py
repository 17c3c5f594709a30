"""One view of a dressed person, and the masks that can be derived from its pictures (S6.3)."""

import dataclasses
import re
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, UInt8
from scipy import ndimage

from dress_jax.capture.checks import numbers, picture, same_size
from dress_jax.capture.labels import ClothesLabel, clothes_masks, hidden_by
from dress_jax.capture.landmarks import Landmarks
from dress_jax.core.errors import InputError
from dress_jax.render.cameras import Camera

_NAME = re.compile(r"[A-Za-z0-9_-]+")
_LENGTH_SLACK = 0.35  # generated normals are this far from unit length at most
_WHITE_SLACK = 8  # of 255: what compression makes of a white background
_UNIT_SLACK = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """What one camera sees; everything but the camera may be absent.

    Coverage is 8-bit: 0 none of the pixel, 255 all of it.

    Args:
        name: letters, digits, hyphens and underscores; a folder's name in the saved form.
        camera: in our world [m]; its size is that of all pictures.
        rgb: colours, shape (h, w, 3).
        matte: coverage by the person, clothes and all, shape (h, w).
        mask: coverage by clothes, where nothing hides them, shape (h, w).
        parts: the same by kind (top, bottom, dress), from the top down (S10.3).
        hidden: coverage by hair and accessories, where the mask says nothing (M^alpha, S10.4).
        normal: unit normals in the world frame, towards the camera, zero where there is no
            surface, float32, shape (h, w, 3).
        landmarks: of the person in this view.

    Raises:
        InputError: wrong types, shapes or sizes, a bad name, a stack of cameras, or normals that
            are neither of unit length nor zero.
    """

    name: str
    camera: Camera
    rgb: UInt8[np.ndarray, "h w 3"] | None = None
    matte: UInt8[np.ndarray, "h w"] | None = None
    mask: UInt8[np.ndarray, "h w"] | None = None
    parts: Mapping[str, UInt8[np.ndarray, "h w"]] = dataclasses.field(default_factory=dict)
    hidden: UInt8[np.ndarray, "h w"] | None = None
    normal: Float[np.ndarray, "h w 3"] | None = None
    landmarks: Landmarks | None = None

    def __post_init__(self) -> None:
        where = f"view '{self.name}'"
        for name in (self.name, *self.parts):
            if not _NAME.fullmatch(name):
                raise InputError(
                    f"the name '{name}' has other characters than letters, digits, - and _",
                    where=where,
                )
        if self.camera.rotation.ndim != 2:
            raise InputError("has a stack of cameras instead of one", where=where)
        size = (self.camera.height, self.camera.width)
        pictures = {"rgb": self.rgb, "matte": self.matte, "mask": self.mask, "hidden": self.hidden}
        pictures |= {f"part '{name}'": mask for name, mask in self.parts.items()}
        for name, array in pictures.items():
            if array is not None:
                part = f"{where}, {name}"
                pixels = picture(part, array, channels=3 if name == "rgb" else 0)
                same_size(part, pixels, size, "its camera")
        if self.normal is not None:
            part = f"{where}, normal"
            normal = numbers(part, self.normal, (*size, 3), dtype=np.float32)
            length = np.linalg.norm(normal, axis=-1)
            if ((np.abs(length - 1.0) > _UNIT_SLACK) & (length > 0.0)).any():
                raise InputError("has normals that are neither unit nor zero", where=part)
            object.__setattr__(self, "normal", normal)
        if self.landmarks is not None and not isinstance(self.landmarks, Landmarks):
            raise InputError(
                f"landmarks are a {type(self.landmarks).__name__}, not Landmarks", where=where
            )


def with_labels(view: View, labels: UInt8[np.ndarray, "h w"]) -> View:
    """A view with the masks that a label map gives: clothes, their kinds, what hides them.

    Raises:
        InputError: the map has another size, or shows no clothes.
    """
    where = f"view '{view.name}', labels"
    same_size(where, picture(where, labels), (view.camera.height, view.camera.width), "the view")
    parts = clothes_masks(labels)
    matte = 255 * (labels != ClothesLabel.BACKGROUND).astype(np.uint8)
    mask = np.zeros(labels.shape, np.uint8)
    for part in parts.values():
        mask |= part
    return dataclasses.replace(
        view,
        matte=matte if view.matte is None else view.matte,
        mask=mask,
        parts=parts,
        hidden=hidden_by(labels),
    )


def unit_normals(
    encoded: Float[np.ndarray, "h w 3"], matte: UInt8[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w 3"]:
    """Unit normals out of decoded ones (2 c - 1), which 8 bits and networks shorten or stretch.

    Args:
        encoded: components in [-1, 1], shape (h, w, 3).
        matte: where there is a surface; zero outside, and where a normal has no length.
    """
    length = np.linalg.norm(encoded, axis=-1, keepdims=True)
    keep = (matte[..., None] > 0) & (length > 1e-3)
    return np.where(keep, encoded / np.where(keep, length, 1.0), 0.0).astype(np.float32)


def matte_from_normals(encoded: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
    """The person where decoded normals have about unit length: the largest such region (S6.3).

    A white, black or grey background decodes to a length of 1.73 or near 0.
    """
    length = np.linalg.norm(encoded, axis=-1)
    return largest_region(np.abs(length - 1.0) < _LENGTH_SLACK)


def matte_from_white(rgb: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
    """The person in front of white: the largest region of other colours.

    White clothes leave holes; a matte or normals do not.
    """
    return largest_region(np.min(rgb, axis=-1) < 255 - _WHITE_SLACK)


def largest_region(chosen: np.ndarray) -> UInt8[np.ndarray, "h w"]:
    """The largest region of pixels that touch along sides or corners, 0 or 255."""
    regions = np.zeros(chosen.shape, np.int32)
    ndimage.label(chosen, structure=np.ones((3, 3)), output=regions)
    sizes = np.bincount(regions.ravel())
    if len(sizes) == 1:
        return np.zeros(chosen.shape, np.uint8)
    sizes[0] = 0
    return 255 * (regions == int(np.argmax(sizes))).astype(np.uint8)
