"""The last product of a user's adjoint: how parameters change the forces of numpy's elements.

Central differences on every element at once; the forces of an element depend on the rest positions
of its own corners alone. ipctk refuses shape derivatives where area weights are set, so what the
rest shape changes in the weights of contact is missing.
"""

import numpy as np
from jaxtyping import Float

from benchmarks.peers import mesh, numpy_cloth
from benchmarks.peers.descent import Positions
from benchmarks.peers.scenes import Scene

_STEP = 1e-7  # [m]; forces are exact to 1e-16, edges are 1e-2


def pulled_back(
    scene: Scene, x: Positions, adjoint: Positions
) -> dict[str, Float[np.ndarray, "..."]]:
    """Minus the derivative of adjoint . force in rest positions and scalar parameters."""
    hinge = mesh.hinges(scene.faces)
    rest = mesh.rest_shape(scene.rest, scene.faces, hinge)
    stretched = numpy_cloth.membrane_gradient(x, scene.faces, rest, 1.0)
    stretched = np.einsum("fpk,fpk->f", stretched, adjoint[scene.faces])
    angle, slope = numpy_cloth.angle_gradient(x, hinge)
    bent = angle * np.einsum("hpk,hpk->h", slope, adjoint[hinge[:, :4]])
    # Inertia at rest and weight, per unit of mass.
    moved = (x - scene.start) / scene.time_step**2
    moved[:, 1] -= scene.gravity
    carried = np.einsum("nk,nk->n", moved, adjoint)

    per_rest = np.zeros_like(scene.rest)
    for corner in range(3):
        for axis in range(2):
            work = []
            for sign in (1.0, -1.0):
                varied = _varied(scene, corner, axis, sign * _STEP)
                forces = numpy_cloth.membrane_gradient(x, scene.faces, varied, scene.stretching)
                own = np.einsum("fpk,fpk->f", forces, adjoint[scene.faces])
                own += scene.density * varied.areas / 3.0 * carried[scene.faces].sum(axis=1)
                work.append(own)
            change = (work[0] - work[1]) / (2.0 * _STEP)
            per_rest[:, axis] += np.bincount(scene.faces[:, corner], change, len(per_rest))
    for corner in range(4):
        for axis in range(2):
            weights = [_hinge_weight(scene, hinge, corner, axis, s * _STEP) for s in (1.0, -1.0)]
            change = scene.bending * bent * (weights[0] - weights[1]) / (2.0 * _STEP)
            per_rest[:, axis] += np.bincount(hinge[:, corner], change, len(per_rest))
    return {
        "rest_positions": -per_rest,
        "stretching_stiffness": -stretched.sum(),
        "bending_stiffness": -(rest.hinge_weights @ bent),
        "density": -(rest.vertex_areas @ carried),
    }


def _varied(scene: Scene, corner: int, axis: int, change: float) -> mesh.Rest:
    """Rest triangles, one corner of each moved along one axis."""
    corners = scene.rest[scene.faces]
    corners[:, corner, axis] += change
    matrix = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    areas = 0.5 * np.abs(np.linalg.det(matrix))
    return mesh.Rest(np.linalg.inv(matrix), areas, np.zeros(0), np.zeros(0))


def _hinge_weight(scene: Scene, hinge, corner: int, axis: int, change: float):
    """e^2 / (A1 + A2), one vertex of each hinge moved along one axis."""
    points = scene.rest[hinge[:, :4]]
    points[:, corner, axis] += change
    edge = points[:, 1] - points[:, 0]
    sides = [points[:, k] - points[:, 0] for k in (2, 3)]
    areas = [0.5 * np.abs(edge[:, 0] * side[:, 1] - edge[:, 1] * side[:, 0]) for side in sides]
    return np.einsum("hk,hk->h", edge, edge) / (areas[0] + areas[1])
