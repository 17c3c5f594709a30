"""Pull a drape toward the pictures before it is let go, so that its folds become theirs.

A garment has many equilibria, one for every way in which its folds may lie, and a drape finds the
one that is closest to where it begins. Which one the pictures show, no derivative in the pattern
says. So the drape is first deformed as the pictures ask, by a small smooth displacement that the
linearized outlines and normals call for, and then projected back onto what cloth can do: one short
implicit step whose inertia holds it to the displaced positions,

    min over x of  E(x) + |x - (x_0 + d)|^2_M / (2 h^2)

which keeps it free of intersections. A few rounds of the two, then the drape begins from there,
with nothing that pulls. The equilibrium that it reaches is one of its own.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Array, Float, Int

from dress_jax.energy.cloth import Parameters, vertex_masses
from dress_jax.sim import Simulator
from dress_jax.sim.solve import State, step
from dress_jax.solver.conjugate_gradient import conjugate_gradient

_TIME_STEP = 0.005  # [s]; short, so that the pull is strong: cloth sags by 0.2 mm in it
_TOLERANCE, _ITERATIONS = 2e-4, 20  # of a step [m]; it is a start, and no result
_HOLD, _SMOOTH = 30.0, 30.0  # of the displacement, per square metre; outlines pull with up to 1e4
_CG_TOLERANCE, _CG_ITERATIONS = 1e-2, 40


class Pull(NamedTuple):
    """What pictures ask of positions: sum w (r + J d)^2 / 2 is to become small.

    Attributes:
        residual: r, (r,).
        jacobian: J, in the flattened positions, (r, 3 n).
        weight: w, (r,).
    """

    residual: Float[np.ndarray, " r"]
    jacobian: scipy.sparse.csr_array
    weight: Float[np.ndarray, " r"]


class Guided(NamedTuple):
    """Where a drape begins.

    Attributes:
        positions: intersection-free [m], (n, 3).
        rounds: taken; fewer than asked for where a projection did not end free of intersections.
    """

    positions: Float[Array, "n 3"]
    rounds: int


def guided_start(
    simulator: Simulator,
    parameters: Parameters,
    positions: Float[Array, "n 3"],
    pull: Callable[[Array], list[Pull]],
    rounds: int,
) -> Guided:
    """Intersection-free positions near some, closer to the pictures.

    Args:
        simulator: host object.
        parameters: of the drape that is to begin.
        positions: an intersection-free state [m].
        pull: what the pictures ask at some positions.
        rounds: of displacement and projection; 0 returns the positions.
    """
    newton = dataclasses.replace(
        simulator.newton, tolerance=_TOLERANCE, iteration_limit=_ITERATIONS
    )
    smoothness = _smoothness(np.asarray(simulator.cloth.faces).T, len(positions))
    masses = np.asarray(vertex_masses(parameters, simulator.cloth))
    for number in range(rounds):
        way = displacement(pull(positions), masses, smoothness)
        own = dataclasses.replace(simulator, newton=newton)
        state = State(positions, jnp.asarray(way / _TIME_STEP))
        reached, report = step(own, state, parameters, time_step=_TIME_STEP)
        if not report.intersection_free:
            return Guided(positions, number)
        positions = reached.positions
    return Guided(positions, rounds)


def displacement(
    pulls: list[Pull],
    masses: Float[np.ndarray, " n"],
    smoothness: scipy.sparse.csr_array,
) -> Float[np.ndarray, "n 3"]:
    """The small, smooth displacement that the pictures ask for [m]: one linear least-squares step.

    Args:
        pulls: from the outlines and the normals.
        masses: of the vertices.
        smoothness: from `_smoothness`.
    """
    share = scipy.sparse.diags_array(masses / masses.sum())
    hold = (_HOLD * share + _SMOOTH * smoothness).tocsc()
    right = np.zeros(3 * len(masses))
    for p in pulls:
        right -= p.jacobian.T.dot(p.weight * p.residual)

    def product(vector: np.ndarray) -> np.ndarray:
        total = hold.dot(vector.reshape(-1, 3)).ravel()
        for p in pulls:
            total = total + p.jacobian.T.dot(p.weight * p.jacobian.dot(vector))
        return total

    # An early end is as good: the iterates grow from nothing along what is asked most.
    found = conjugate_gradient(
        product,
        right,
        _Hold(scipy.sparse.linalg.splu(hold)),
        tolerance=_CG_TOLERANCE,
        iteration_limit=_CG_ITERATIONS,
    )
    return found.solution.reshape(-1, 3)


class _Hold(NamedTuple):
    """A preconditioner, so that every iterate is smooth."""

    factors: Any

    def solve(self, right_hand_side: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Of every coordinate on its own."""
        return self.factors.solve(right_hand_side.reshape(-1, 3)).ravel()


def _smoothness(faces: Int[np.ndarray, "f 3"], count: int) -> scipy.sparse.csr_array:
    """The mean squared difference along mesh edges, as a matrix."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    entries = (np.ones(len(start)), (start, end))
    links = scipy.sparse.coo_array(entries, shape=(count, count)).tocsr()
    links = links + links.T
    degree = scipy.sparse.diags_array(np.asarray(links.sum(axis=1)).ravel())
    return ((degree - links) / count).tocsr()
