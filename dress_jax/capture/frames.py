"""Camera conventions of others, converted into ours: metres, +y up, +z front (S6.2, S6.4)."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Num, UInt8

from dress_jax.capture.checks import numbers
from dress_jax.core.errors import InputError
from dress_jax.render.cameras import Camera, perspective_camera

_COVERED = 128  # of 255
_HALF_PIXEL = 0.5
"""Between a corner's and a centre's coordinates; see `opencv_camera`."""


def generator_frame(
    matte: UInt8[np.ndarray, "n n"], *, half_extent: float, height: float | None, unit: float | None
) -> tuple[float, float]:
    """Scale and floor of a generator's frame, in which an orthographic view spans +-half_extent.

    Generators scale every person to their frame, so that the metre has to come from outside: from
    the person's height, or from a body that was fitted in the frame.

    Args:
        matte: the person in the front view, shape (n, n).
        half_extent: half of what the view spans [units].
        height: of the person, from the lowest to the highest covered pixel [m]; wins over `unit`.
        unit: metres in one unit, where it is known.

    Returns:
        Metres in a unit, and how high the frame's origin lies above the soles [m].

    Raises:
        InputError: the matte is empty, or neither height nor unit is known.
    """
    rows = np.flatnonzero((matte >= _COVERED).any(axis=1))
    if len(rows) == 0:
        raise InputError("covers no pixel", where="front view, matte")
    count = len(matte)
    # Row r covers the pixel from its upper to its lower edge.
    top = half_extent * (1.0 - 2.0 * rows[0] / count)
    bottom = half_extent * (1.0 - 2.0 * (rows[-1] + 1) / count)
    if height is not None:
        if not 0.3 < height < 3.0:
            raise InputError(
                f"is {height:g} m, which is no person's", where="height", mend="give metres"
            )
        unit = height / (top - bottom)
    if unit is None:
        raise InputError(
            "nothing says how tall the person is",
            where="height",
            mend="give the height in metres, or the body that was fitted in this frame",
        )
    return unit, -bottom * unit


def sewfactory_camera(
    intrinsics: Num[np.ndarray, "3 3"],
    rotation: Num[np.ndarray, "3 3"],
    position: Num[np.ndarray, "3"],
    *,
    height: int,
    width: int,
    turn: float = 0.0,
) -> Camera:
    """The camera of a SewFactory view.

    With p = (v - T) R the pixel is  u = cx + f x / (-z),  v = cy - f y / (-z): the columns of R are
    right, up and toward, T is the eye in centimetres.

    Args:
        intrinsics: `cam_K`, with the picture's corner at (0, 0) [px].
        rotation: `cam_R`, shape (3, 3).
        position: `cam_T` [cm], shape (3,).
        height, width: of the picture [px].
        turn: of the scene about +y before it becomes our world [rad].

    Raises:
        InputError: a matrix that is no rotation, or a focal length that is not positive.
    """
    world = about_y(turn)
    k = numbers("cam_K", intrinsics, (3, 3))
    return perspective_camera(
        rotation=numbers("cam_R", rotation, (3, 3)).T @ world.T,
        position=world @ numbers("cam_T", position, (3,)) * 0.01,
        focal=(k[0, 0], k[1, 1]),
        principal=(k[0, 2] - _HALF_PIXEL, k[1, 2] - _HALF_PIXEL),
        height=height,
        width=width,
    )


def opencv_camera(
    intrinsics: Num[np.ndarray, "3 3"],
    extrinsics: Num[np.ndarray, "3 4"],
    *,
    height: int,
    width: int,
    turn: Float[np.ndarray, "3 3"] | None = None,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
) -> Camera:
    """A camera in OpenCV's convention: x right, y down, z away, x_camera = R x + t.

    Args:
        intrinsics: focal lengths and principal point [px], pixel centres at whole numbers, as
            OpenCV counts; shape (3, 3).
        extrinsics: R and t [m], shape (3, 4) or (4, 4).
        height, width: of the picture [px].
        turn, origin: from the extrinsics' world into ours, x -> turn x + origin.

    Raises:
        InputError: a matrix that is no rotation, a skewed camera, or a focal length that is not
            positive.
    """
    k = numbers("intrinsics", intrinsics, (3, 3))
    pose = numbers("extrinsics", np.asarray(extrinsics)[:3], (3, 4))
    if abs(k[0, 1]) > 1e-6 * k[0, 0]:
        raise InputError(f"the camera is skewed ({k[0, 1]:g})", where="intrinsics")
    turn = np.eye(3) if turn is None else turn
    inward, offset = pose[:, :3], pose[:, 3]
    return perspective_camera(
        rotation=np.diag([1.0, -1.0, -1.0]) @ inward @ turn.T,
        position=turn @ (-inward.T @ offset) + np.asarray(origin, float),
        focal=(k[0, 0], k[1, 1]),
        principal=(k[0, 2], k[1, 2]),
        height=height,
        width=width,
    )


def about_y(angle: float) -> Float[np.ndarray, "3 3"]:
    """Rotation about +y [rad]: a positive quarter turn takes +z to +x."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])


def view_azimuth(camera: Camera) -> int:
    """Where a camera stands, as MagicMan's and our target folders name it.

    Returns:
        Whole degrees in 0 .. 359: 0 sees the front (+z), 90 stands at -x, the wearer's right.
    """
    toward = np.asarray(camera.rotation, float)[2]
    return round(-float(np.degrees(np.arctan2(toward[0], toward[2])))) % 360
