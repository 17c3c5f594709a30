"""Rotations from and to three angles about fixed axes (host)."""

import math

import numpy as np
from jaxtyping import Float

_GIMBAL_LOCK = 1e-12


def _axis_rotation(axis: int, angle: float) -> Float[np.ndarray, "3 3"]:
    turn = round(angle / 90.0)
    if angle == 90.0 * turn:  # quarter turns are exact
        cosine, sine = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[turn % 4]
    else:
        cosine, sine = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = cosine
    matrix[i, j], matrix[j, i] = -sine, sine
    return matrix


def rotation_matrix(angles: np.ndarray, *, order: str = "zyx") -> Float[np.ndarray, "3 3"]:
    """The matrix of three angles about x, y and z.

    Args:
        angles: about x, y, z [degrees], shape (3,).
        order: "zyx" multiplies Rz Ry Rx, "xyz" multiplies Rx Ry Rz.

    Returns:
        Rotation matrix, shape (3, 3).
    """
    x, y, z = (_axis_rotation(axis, float(angle)) for axis, angle in enumerate(angles))
    return z @ y @ x if order == "zyx" else x @ y @ z


def rotation_angles(matrix: np.ndarray, *, order: str = "zyx") -> Float[np.ndarray, "3"]:
    """Angles [degrees] about x, y, z that `rotation_matrix` turns into `matrix`, shape (3,).

    Of the two equivalent triples the one with the smaller sum of magnitudes is returned. In gimbal
    lock (y = +-90) the angle about z is zero.
    """
    if order == "xyz":  # (Rx Ry Rz)^T = Rz(-z) Ry(-y) Rx(-x)
        return 0.0 - rotation_angles(matrix.T, order="zyx")
    cosine = math.hypot(matrix[0, 0], matrix[1, 0])
    if cosine < _GIMBAL_LOCK:
        y = math.copysign(90.0, -matrix[2, 0])
        x = math.degrees(math.atan2(-matrix[1, 2], matrix[1, 1]))
        return np.array([x, y, 0.0])
    candidates = []
    for sign in (1.0, -1.0):
        x = math.atan2(sign * matrix[2, 1], sign * matrix[2, 2])
        y = math.atan2(-matrix[2, 0], sign * cosine)
        z = math.atan2(sign * matrix[1, 0], sign * matrix[0, 0])
        angles = np.degrees([x, y, z]) + 0.0
        candidates.append(np.where(angles == -180.0, 180.0, angles))
    return min(candidates, key=lambda angles: float(np.sum(np.abs(angles))))
