"""Membrane, bending, inertia, weight and pins in numpy: energies, gradients, Hessians of elements.

ARAP: psi = |F - R|^2 = |F|^2 - 2 tr S + 2 with F = R S. With R = [r1 r2] and the normal n,
d2psi = 2 I - (4 / tr S) t t^T - 2 (n n^T) x S^-1, t = (-r2, r1) / sqrt 2; clamping the last two
terms at 2 leaves a positive-semidefinite matrix.
"""

import numpy as np
from jaxtyping import Float, Int

from benchmarks.peers.mesh import Rest

Positions = Float[np.ndarray, "n 3"]


def _dot(a, b):
    return np.einsum("...i,...i->...", a, b)


def _deformation(x: Positions, faces: Int[np.ndarray, "f 3"], inverse):
    """F's columns, (f, 2, 3); tr S and det S, (f,)."""
    corners = x[faces]
    edges = corners[:, 1:] - corners[:, :1]
    columns = np.einsum("fki,fkj->fji", edges, inverse)
    normal = np.cross(columns[:, 0], columns[:, 1])
    determinant = np.sqrt(_dot(normal, normal))
    trace = np.sqrt(_dot(columns, columns).sum(axis=1) + 2.0 * determinant)
    return columns, normal, trace, determinant


def membrane_energy(x, faces, rest: Rest, stiffness: float) -> float:
    """Sum of A k psi(F) [J]."""
    columns, _, trace, _ = _deformation(x, faces, rest.inverse)
    density = _dot(columns, columns).sum(axis=1) - 2.0 * trace + 2.0
    return float(stiffness * (rest.areas @ density))


def _stretch(columns, trace, determinant):
    """S, (f, 2, 2), from C = F^T F: S = (C + det S I) / tr S."""
    c = np.einsum("fki,fli->fkl", columns, columns)
    return (c + determinant[:, None, None] * np.eye(2)) / trace[:, None, None]


def _inverse_2x2(s):
    determinant = s[:, 0, 0] * s[:, 1, 1] - s[:, 0, 1] * s[:, 1, 0]
    adjugate = np.stack([s[:, 1, 1], -s[:, 0, 1], -s[:, 1, 0], s[:, 0, 0]], axis=1)
    return adjugate.reshape(-1, 2, 2) / determinant[:, None, None]


def membrane_gradient(x, faces, rest: Rest, stiffness: float) -> Float[np.ndarray, "f 3 3"]:
    """Of every triangle at its corners [N]: A k 2 (F - R)."""
    columns, _, trace, determinant = _deformation(x, faces, rest.inverse)
    inverse = _inverse_2x2(_stretch(columns, trace, determinant))
    rotation = np.einsum("fki,fkl->fli", columns, inverse)
    stress = 2.0 * (stiffness * rest.areas)[:, None, None] * (columns - rotation)
    outer = np.einsum("fji,fkj->fki", stress, rest.inverse)
    return np.concatenate([-outer.sum(axis=1, keepdims=True), outer], axis=1)


def membrane_hessian(
    x, faces, rest: Rest, stiffness: float, *, exact: bool
) -> Float[np.ndarray, "f 9 9"]:
    """Of every triangle [N/m], positive semidefinite unless exact."""
    columns, normal, trace, determinant = _deformation(x, faces, rest.inverse)
    inverse = _inverse_2x2(_stretch(columns, trace, determinant))
    rotation = np.einsum("fki,fkl->fli", columns, inverse)
    normal = normal / determinant[:, None]
    twist = 4.0 / trace
    across = 2.0 * inverse
    if not exact:
        twist = np.minimum(twist, 2.0)
        values, vectors = np.linalg.eigh(across)
        across = np.einsum("fka,fa,fla->fkl", vectors, np.minimum(values, 2.0), vectors)
    shape = np.concatenate([-rest.inverse.sum(axis=1, keepdims=True), rest.inverse], axis=1)
    turn = shape[:, :, 1, None] * rotation[:, None, 0] - shape[:, :, 0, None] * rotation[:, None, 1]
    same = 2.0 * np.einsum("fpk,fqk->fpq", shape, shape)
    bent = np.einsum("fpk,fkl,fql->fpq", shape, across, shape)
    blocks = np.einsum("fpq,ij->fpiqj", same, np.eye(3))
    blocks -= np.einsum("f,fpi,fqj->fpiqj", 0.5 * twist, turn, turn, optimize=True)
    blocks -= np.einsum("fpq,fi,fj->fpiqj", bent, normal, normal, optimize=True)
    blocks *= (stiffness * rest.areas)[:, None, None, None, None]
    return blocks.reshape(-1, 9, 9)


def _hinge(x: Positions, hinge: Int[np.ndarray, "h 4"]):
    x0, x1, x2, x3 = (x[hinge[:, k]] for k in range(4))
    edge = x1 - x0
    left, right = np.cross(edge, x2 - x0), np.cross(x3 - x0, edge)
    length = np.sqrt(_dot(edge, edge))
    angle = np.arctan2(_dot(np.cross(left, right), edge) / length, _dot(left, right))
    return edge, length, left, right, x2 - x0, x3 - x0, angle


def bending_energy(x, hinge, rest: Rest, stiffness: float) -> float:
    """Sum of k/2 theta^2 e^2 / (A1 + A2) [J]."""
    angle = _hinge(x, hinge[:, :4])[-1]
    return float(0.5 * stiffness * (rest.hinge_weights @ angle**2))


def angle_gradient(x, hinge) -> tuple[Float[np.ndarray, " h"], Float[np.ndarray, "h 4 3"]]:
    """Angles [rad] and their derivatives in the four vertices [1/m].

    The derivative in an opposite vertex is e n / |n|^2 along the normal n of its triangle, twice
    the area long; the ends of the edge balance it.
    """
    edge, length, left, right, to2, to3, angle = _hinge(x, hinge[:, :4])
    g2 = -(length / _dot(left, left))[:, None] * left
    g3 = -(length / _dot(right, right))[:, None] * right
    a2, a3 = _dot(to2, edge) / length**2, _dot(to3, edge) / length**2
    g0 = -(1.0 - a2)[:, None] * g2 - (1.0 - a3)[:, None] * g3
    g1 = -a2[:, None] * g2 - a3[:, None] * g3
    return angle, np.stack([g0, g1, g2, g3], axis=1)


def bending_gradient(x, hinge, rest: Rest, stiffness: float) -> Float[np.ndarray, "h 4 3"]:
    """Of every hinge at its vertices [N]."""
    angle, gradient = angle_gradient(x, hinge)
    return (stiffness * rest.hinge_weights * angle)[:, None, None] * gradient


def _cross_matrix(v):
    zero = np.zeros(len(v))
    rows = [zero, -v[:, 2], v[:, 1], v[:, 2], zero, -v[:, 0], -v[:, 1], v[:, 0], zero]
    return np.stack(rows, axis=1).reshape(-1, 3, 3)


def _angle_hessian(x, hinge) -> Float[np.ndarray, "h 12 12"]:
    """Second derivative of the angles [1/m^2], by the product rule on `angle_gradient`."""
    edge, length, left, right, to2, to3, _ = _hinge(x, hinge[:, :4])
    h = len(edge)
    eye = np.eye(3)
    unit = edge / length[:, None]
    d_length = np.zeros((h, 4, 3))
    d_length[:, 0], d_length[:, 1] = -unit, unit
    e, t2, t3 = _cross_matrix(edge), _cross_matrix(to2), _cross_matrix(to3)

    def opposite(normal, d_normal):
        """Value and derivative of -e n / |n|^2."""
        squared = _dot(normal, normal)[:, None, None]
        n = normal[:, :, None]
        inside = (eye - 2.0 * n * normal[:, None] / squared) / squared
        value = -(length[:, None] * normal) / squared[:, 0]
        slope = -length[:, None, None, None] * np.einsum("hij,hjpk->hipk", inside, d_normal)
        slope -= np.einsum("hi,hpk->hipk", normal / squared[:, 0], d_length)
        return value, slope

    def ratio(to, corner):
        """Value and derivative of (to . e) / |e|^2."""
        squared = length**2
        a = _dot(to, edge) / squared
        slope = np.zeros((h, 4, 3))
        along = (to - 2.0 * a[:, None] * edge) / squared[:, None]
        slope[:, 1] += along
        slope[:, 0] -= along + edge / squared[:, None]
        slope[:, corner] += edge / squared[:, None]
        return a, slope

    # d(e x t) = de x t + e x dt, with e = x1 - x0 and t = x2 - x0.
    d_left = np.zeros((h, 3, 4, 3))
    d_left[:, :, 1], d_left[:, :, 2] = -t2, e
    d_left[:, :, 0] = t2 - e
    d_right = np.zeros((h, 3, 4, 3))
    d_right[:, :, 1], d_right[:, :, 3] = t3, -e
    d_right[:, :, 0] = e - t3
    g2, j2 = opposite(left, d_left)
    g3, j3 = opposite(right, d_right)
    (a2, d2), (a3, d3) = ratio(to2, 2), ratio(to3, 3)
    moved2 = np.einsum("hi,hpk->hipk", g2, d2) + a2[:, None, None, None] * j2
    moved3 = np.einsum("hi,hpk->hipk", g3, d3) + a3[:, None, None, None] * j3
    j1 = -moved2 - moved3
    j0 = -j2 - j3 - j1
    return np.stack([j0, j1, j2, j3], axis=1).reshape(h, 12, 12)


def bending_hessian(
    x, hinge, rest: Rest, stiffness: float, *, exact: bool
) -> Float[np.ndarray, "h 12 12"]:
    """Of every hinge [N/m]: Gauss-Newton, or exact with the curvature of the angle."""
    angle, gradient = angle_gradient(x, hinge)
    g = gradient.reshape(-1, 12)
    scale = stiffness * rest.hinge_weights
    blocks = (scale[:, None] * g)[:, :, None] * g[:, None]
    if exact:
        blocks += (scale * angle)[:, None, None] * _angle_hessian(x, hinge)
    return blocks
