"""A surface beside the pictures: a scan with or without labels, or a body as a mesh."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int, UInt8

from dress_jax.capture.checks import numbers
from dress_jax.capture.labels import CLOTHES, ClothesLabel
from dress_jax.core.errors import InputError


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh or a cloud of points in our world.

    Args:
        vertices: [m], shape (n, 3).
        faces: triangles, shape (f, 3); none for a cloud.
        labels: `ClothesLabel` of each vertex, shape (n,), or None.
        colors: RGB of each vertex, shape (n, 3), or None.

    Raises:
        InputError: wrong shapes or types, numbers that are not finite, no vertex, or indices and
            labels out of range.
    """

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "f 3"]
    labels: UInt8[np.ndarray, " n"] | None = None
    colors: UInt8[np.ndarray, "n 3"] | None = None

    def __post_init__(self) -> None:
        vertices = numbers("surface, vertices", self.vertices, (None, 3))
        faces = numbers("surface, faces", self.faces, (None, 3))
        indices = faces.astype(np.int64)
        if len(vertices) == 0:
            raise InputError("there is no vertex", where="surface")
        if (indices != faces).any() or (
            faces.size and (indices.min() < 0 or indices.max() >= len(vertices))
        ):
            raise InputError(f"an index is not in 0 to {len(vertices) - 1}", where="surface, faces")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", indices)
        for name, shape in (("labels", (len(vertices),)), ("colors", (len(vertices), 3))):
            array = getattr(self, name)
            if array is None:
                continue
            array = np.asarray(array)
            if array.dtype != np.uint8 or array.shape != shape:
                raise InputError(
                    f"is {array.dtype} of shape {array.shape}, not uint8 of {shape}",
                    where=f"surface, {name}",
                )
            object.__setattr__(self, name, array)
        if self.labels is not None and self.labels.max() >= len(ClothesLabel):
            raise InputError(f"{self.labels.max()} is no label", where="surface, labels")


def split_clothes(surface: Surface) -> tuple[Surface | None, Surface | None]:
    """The clothes of a labelled surface, and all the rest; None for a side without vertices.

    A triangle belongs to the clothes where two of its corners at least do; of a cloud, the points.

    Raises:
        InputError: the surface has no labels.
    """
    if surface.labels is None:
        raise InputError(
            "has no labels", where="scan", mend="give a scan on which clothes are labelled"
        )
    worn = np.isin(surface.labels, CLOTHES)
    if len(surface.faces) == 0:
        return _points(surface, worn), _points(surface, ~worn)
    own = worn[surface.faces].sum(axis=1) >= 2
    return _triangles(surface, own), _triangles(surface, ~own)


def _points(surface: Surface, chosen: np.ndarray) -> Surface | None:
    if not chosen.any():
        return None
    return Surface(
        vertices=surface.vertices[chosen],
        faces=np.zeros((0, 3), np.int64),
        labels=None if surface.labels is None else surface.labels[chosen],
        colors=None if surface.colors is None else surface.colors[chosen],
    )


def _triangles(surface: Surface, chosen: np.ndarray) -> Surface | None:
    if not chosen.any():
        return None
    used, faces = np.unique(surface.faces[chosen], return_inverse=True)
    return Surface(
        vertices=surface.vertices[used],
        faces=faces.reshape(-1, 3),
        labels=None if surface.labels is None else surface.labels[used],
        colors=None if surface.colors is None else surface.colors[used],
    )
