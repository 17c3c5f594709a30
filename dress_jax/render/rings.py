"""Orthographic camera rings of multi-view generators, and the frame that fits a person (S6.2)."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Num

from dress_jax.core.errors import InputError
from dress_jax.render.cameras import Camera, orthographic_camera

MAGICMAN_FILL = 0.925
"""Part of the frame that the reference person's bounding box takes up."""

PSHUMAN_AZIMUTHS = (0.0, 45.0, 90.0, 180.0, 270.0, 315.0)
"""Azimuths of PSHuman's six views [degrees]; positive moves the camera to +x."""


def frame_body(
    vertices: Num[np.ndarray, "n 3"], *, fill: float = MAGICMAN_FILL
) -> tuple[np.ndarray, float]:
    """The centre and half-extent [m] of a square frame of which a body's box takes up `fill`.

    The half-extent serves every view of a ring: horizontally it counts the largest distance from
    the vertical axis through the centre, not the box of one view.

    Args:
        vertices: body vertices [m], shape (n, 3).
        fill: part of the frame that the larger dimension takes up.

    Raises:
        InputError: there are no vertices, or `fill` is not in (0, 1].
    """
    vertices = np.asarray(vertices, dtype=float)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or len(vertices) == 0:
        raise InputError(f"vertices have shape {vertices.shape}, not (n, 3)", where="frame_body")
    if not 0 < fill <= 1:
        raise InputError(f"fill is {fill}, not in (0, 1]", where="frame_body")
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    center = 0.5 * (low + high)
    around = np.hypot(vertices[:, 0] - center[0], vertices[:, 2] - center[2]).max()
    return center, float(max(0.5 * (high[1] - low[1]), around) / fill)


def ring_cameras(
    azimuths: Sequence[float],
    *,
    size: int,
    center: Num[np.ndarray, "3"],
    half_extent: float,
    distance: float = 4.0,
) -> list[Camera]:
    """Orthographic cameras on a horizontal circle.

    A camera at azimuth a has toward = (sin a, 0, cos a), right = (cos a, 0, -sin a) and up =
    (0, 1, 0): azimuth 0 sees the front (+z), positive azimuths move the camera to +x.

    Args:
        azimuths: [degrees].
        size: image height and width [px].
        center: the point in the middle of every image [m].
        half_extent: half the height and width that an image shows [m].
        distance: of the eye from the centre, in half-extents. It shifts depths and nothing else;
            a small one keeps the digits of float32.
    """
    center = np.asarray(center, dtype=float)
    cameras = []
    for azimuth in np.deg2rad(np.asarray(azimuths, dtype=float)):
        sine, cosine = np.sin(azimuth), np.cos(azimuth)
        toward = np.array([sine, 0.0, cosine])
        cameras.append(
            orthographic_camera(
                rotation=np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], toward]),
                position=center + distance * half_extent * toward,
                half_extent=half_extent,
                height=size,
            )
        )
    return cameras


def magicman_cameras(
    count: int = 20,
    *,
    center: Num[np.ndarray, "3"],
    half_extent: float,
    size: int = 512,
    distance: float = 4.0,
) -> list[Camera]:
    """MagicMan's ring: view i has azimuth -i (360 // count) degrees, so view 1 is at -x (S6.2).

    In MagicMan's own unit frame the extent is +-1 and the eye is 100 away: `half_extent=1`,
    `distance=100`.

    Args:
        count: number of views; the published models have 20 and 24.
        center: where MagicMan's origin lies [m], from `frame_body`.
        half_extent: MagicMan's unit [m], from `frame_body`.
        size: image height and width [px].
        distance: see `ring_cameras`.

    Raises:
        InputError: the count is not in 1 .. 360.
    """
    if not 1 <= count <= 360:
        raise InputError(f"count is {count}, not in 1 .. 360", where="magicman_cameras")
    azimuths = [-float(i * (360 // count)) for i in range(count)]
    return ring_cameras(
        azimuths, size=size, center=center, half_extent=half_extent, distance=distance
    )


def pshuman_cameras(
    *, center: Num[np.ndarray, "3"], half_extent: float, size: int = 1024
) -> list[Camera]:
    """PSHuman's six orthographic views; in its own frame the half-extent is 2."""
    return ring_cameras(PSHUMAN_AZIMUTHS, size=size, center=center, half_extent=half_extent)
