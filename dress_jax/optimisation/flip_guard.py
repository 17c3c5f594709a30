"""Proposals whose rest triangles would flip, moved to the nearest pattern where none does (S12).

Two curves of a narrow strip may pass each other in one update. The paper minimizes, in place,

    1/|F| sum (epsilon - min(A_f, epsilon)) + lambda |X - X_proposed|_1

and its text calls the first term least squares. Here both are: the smallest change of the mesh with
A_f >= epsilon, by Gauss-Newton with a stiff penalty. Areas count relative to those with which the
panels were meshed, so that one epsilon serves needles and large triangles.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.core.pytree import replace
from dress_jax.optimisation.draping import relative_areas, smallest_relative_area
from dress_jax.optimisation.least_change import least_change_step
from dress_jax.optimisation.problem import FitProblem, rest_shape
from dress_jax.optimisation.state import Unknowns, finite
from dress_jax.pattern import Discretization, rest_positions
from dress_jax.pattern.parameters import PatternParameters
from dress_jax.pattern.symmetry import Symmetry, validated

_MARGIN = 1.05  # the penalty rests a little beyond its bound
_ROUNDS = 30


class Guarded(NamedTuple):
    """Unknowns after the guard.

    Attributes:
        unknowns: as proposed, or with another pattern.
        acted: whether triangles were close to flipping.
        largest_move: of a panel vertex [m].
    """

    unknowns: Unknowns
    acted: bool
    largest_move: float


def guard_flips(problem: FitProblem, unknowns: Unknowns) -> Guarded:
    """Keep every rest triangle above `FitOptions.guarded_area` of the area it was meshed with.

    Where no triangle is close to flipping the pattern is returned as it came, bit by bit (S12.2).
    What cannot be mended is returned as the last round left it, and the step rejects it.

    Args:
        problem: what is fitted.
        unknowns: proposed.
    """
    bound = problem.options.guarded_area
    if bound == 0.0 or not finite(unknowns):
        return Guarded(unknowns, False, 0.0)
    proposed = np.asarray(rest_shape(problem, unknowns.pattern))
    if smallest_relative_area(problem, proposed) >= bound:
        return Guarded(unknowns, False, 0.0)
    pattern = unknowns.pattern
    data = (problem.tables.symmetry, problem.discretization)
    size = problem.discretization.edge_length
    vector = _as_vector(pattern)
    for _ in range(_ROUNDS):
        rest, jacobian = (np.asarray(part) for part in _rest_and_jacobian(vector, pattern, *data))
        areas = relative_areas(problem, rest)
        if float(areas.min()) >= bound:
            break
        low = np.flatnonzero(areas < _MARGIN * bound)
        slopes = _area_slopes(problem, rest, jacobian, low)
        step = least_change_step(
            jacobian.reshape(-1, jacobian.shape[-1]) / size,
            (rest - proposed).ravel() / size,
            slopes,
            _MARGIN * bound - areas[low],
        )
        vector = vector + jnp.asarray(step)
    mended = replace(unknowns, pattern=_from_vector(vector, pattern))
    move = np.linalg.norm(np.asarray(rest_shape(problem, mended.pattern)) - proposed, axis=1)
    return Guarded(mended, True, float(move.max()))


def _as_vector(pattern: PatternParameters) -> Float[Array, " k"]:
    return jnp.concatenate([pattern.vertices.ravel(), pattern.controls.ravel()])


def _from_vector(vector: Array, like: PatternParameters) -> PatternParameters:
    corners = like.vertices.size
    return PatternParameters(
        vertices=vector[:corners].reshape(like.vertices.shape),
        controls=vector[corners:].reshape(like.controls.shape),
    )


@jax.jit
def _rest_and_jacobian(
    vector: Array,
    like: PatternParameters,
    symmetry: Symmetry | None,
    discretization: Discretization,
) -> tuple[Float[Array, "P 2"], Float[Array, "P 2 k"]]:
    def rest(vector: Array) -> Array:
        return rest_positions(validated(_from_vector(vector, like), symmetry), discretization)

    return rest(vector), jax.jacfwd(rest)(vector)


def _area_slopes(
    problem: FitProblem,
    rest: Float[np.ndarray, "P 2"],
    jacobian: Float[np.ndarray, "P 2 k"],
    triangles: Int[np.ndarray, " m"],
) -> Float[np.ndarray, "m k"]:
    """Derivatives of some triangles' relative areas."""
    discretization = problem.discretization
    corners = np.asarray(discretization.rest_faces)[triangles]
    a, b, c = (rest[corners[:, k]] for k in range(3))
    da, db, dc = (jacobian[corners[:, k]] for k in range(3))
    u, v, du, dv = b - a, c - a, db - da, dc - da
    change = (
        du[:, 0] * v[:, 1, None]
        + u[:, 0, None] * dv[:, 1]
        - du[:, 1] * v[:, 0, None]
        - u[:, 1, None] * dv[:, 0]
    )
    meshed = np.asarray(discretization.meshed_positions)
    a, b, c = (meshed[corners[:, k]] for k in range(3))
    u, v = b - a, c - a
    return change / (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])[:, None]
