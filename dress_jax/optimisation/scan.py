"""A scanned garment as what a fit looks at: points on its surface (host)."""

import dataclasses

import numpy as np
from jaxtyping import Float, Num

from dress_jax.core.errors import InputError
from dress_jax.loss.metrics import sample_surface


@dataclasses.dataclass(frozen=True, eq=False)
class Scan:
    """Points of a scanned garment.

    Attributes:
        points: [m], (m, 3).
        complete: whether the scan shows the whole garment. Then the garment is drawn to the scan as
            well as the scan to the garment, and what hangs out beyond the scan is drawn in; with
            holes in the scan that would pull the cloth to their rims.
    """

    points: Float[np.ndarray, "m 3"]
    complete: bool = False


def make_scan(
    vertices: Num[np.ndarray, "n 3"],
    faces: Num[np.ndarray, "f 3"] | None = None,
    *,
    samples: int = 5000,
    complete: bool = False,
    seed: int = 0,
) -> Scan:
    """A scan from a mesh or a point cloud.

    Args:
        vertices: [m], in the frame of the body.
        faces: triangles, from which points are drawn uniformly by area; None for a cloud, which is
            thinned out at random if it is larger.
        samples: points to keep.
        complete: see `Scan`.
        seed: of the samples.

    Raises:
        InputError: nothing scanned, wrong shapes, or numbers that are not finite.
    """
    vertices = np.asarray(vertices, np.float64)
    where, random = "scan", np.random.default_rng(seed)
    if vertices.ndim != 2 or vertices.shape[1:] != (3,) or len(vertices) == 0:
        raise InputError(f"points have shape {vertices.shape}, not (n, 3)", where=where)
    if not np.isfinite(vertices).all():
        row = int(np.argmin(np.isfinite(vertices).all(axis=1)))
        raise InputError("a number is not finite", where=f"{where}, point {row}")
    if samples < 1:
        raise InputError(f"samples is {samples}", where=where, mend="give at least 1")
    if faces is None:
        kept = random.permutation(len(vertices))[:samples]
        return Scan(vertices[np.sort(kept)], complete)
    faces = np.asarray(faces)
    if faces.ndim != 2 or faces.shape[1:] != (3,) or not len(faces):
        raise InputError(f"faces have shape {faces.shape}, not (f, 3)", where=where)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"a face names point {faces.max()} of {len(vertices)}", where=where)
    return Scan(sample_surface(vertices[faces], samples, random), complete)
