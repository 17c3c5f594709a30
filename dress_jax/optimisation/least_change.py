"""The smallest change of a mesh that lifts some areas to a bound, one Gauss-Newton step (host)."""

import numpy as np
from jaxtyping import Float

_STIFFNESS = 1e3  # of an area below its bound, against moving a vertex by an edge length
_RIDGE = 1e-8


def least_change_step(
    jacobian: Float[np.ndarray, "p k"],
    moved: Float[np.ndarray, " p"],
    slopes: Float[np.ndarray, "m k"],
    lack: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " k"]:
    """The step d that minimizes |moved + jacobian d|^2 + stiffness |slopes d - lack|^2.

    Args:
        jacobian: of the vertices in the unknowns [edge lengths].
        moved: how far the vertices are from where they should be [edge lengths].
        slopes: of relative areas in the unknowns.
        lack: how far those areas are below their bound.
    """
    matrix = jacobian.T @ jacobian + _STIFFNESS * slopes.T @ slopes
    matrix += _RIDGE * np.trace(matrix) / len(matrix) * np.eye(len(matrix))
    return np.linalg.solve(matrix, _STIFFNESS * slopes.T @ lack - jacobian.T @ moved)
