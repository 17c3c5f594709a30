"""Projected Newton with a step bound and backtracking, as the IPC papers have it, for the peers.

As in dress_jax a solve ends when no vertex would move further than the tolerance, and the exact
Hessian is tried once steps are shorter than 1 mm. Where it has no Cholesky factorization, more and
more of the projected one is mixed into it: the projected one alone creeps past saddles in steps
that look converged. What dress_jax does beyond that (twice the step, conjugate gradients with the
exact Hessian, following negative curvature) is not here.
"""

import dataclasses
import time
from typing import Any, Protocol

import numpy as np
import scipy.sparse
from jaxtyping import Float

from benchmarks.peers.scenes import Scene
from dress_jax.solver.linear import LinearSolveError, make_solver

_EXACT_BELOW = 1e-3  # [m]
_SHARES = (0.0, 0.02, 0.2)  # of the projected Hessian in a mixture, tried in turn
_ARMIJO = 1e-4
_ROUNDING = 1e-12  # of the energy, relative
_SHORTEST_FRACTION = 1e-10

Positions = Float[np.ndarray, "n 3"]


class Objective(Protocol):
    """The incremental potential of a step."""

    def energy(self, x: Positions) -> float:
        """[J]; infinite at or below the thickness."""
        ...

    def gradient(self, x: Positions) -> Positions:
        """[N]."""
        ...

    def hessian(self, x: Positions, *, exact: bool) -> scipy.sparse.csr_matrix:
        """Upper triangle [N/m]."""
        ...

    def step_bound(self, x: Positions, displacement: Positions) -> float:
        """The part of the displacement without contact; later energies are asked within it."""
        ...


@dataclasses.dataclass(frozen=True)
class Solution:
    """Where a solve ended.

    Attributes:
        positions: [m], (n, 3).
        converged: whether the stopping rule was met.
        iterations: Newton steps.
        out_of_time: whether the deadline stopped it.
    """

    positions: Positions
    converged: bool
    iterations: int
    out_of_time: bool = False


class Solver(Protocol):
    """Solves symmetric positive-definite systems."""

    name: str

    def factorize(self, upper: scipy.sparse.csr_matrix) -> Any:
        """A factorization with `solve`; either may raise `LinearSolveError`."""
        ...


class Cholesky:
    """The direct solver of the peers: the one that dress_jax uses on this machine."""

    def __init__(self) -> None:
        self._solver = make_solver("auto")
        self.name = self._solver.name

    def factorize(self, upper: scipy.sparse.csr_matrix) -> Any:
        """A factorization with `solve`.

        Raises:
            LinearSolveError: the matrix is not positive definite.
        """
        upper.sort_indices()
        return self._solver.factorize(upper)


def minimize(
    objective: Objective,
    start: Positions,
    scene: Scene,
    solver: Solver,
    *,
    deadline: float = np.inf,
) -> Solution:
    """Minimize from an intersection-free start.

    Args:
        deadline: of `time.perf_counter`; no iteration begins after it.
    """
    x, last = np.array(start), np.inf
    objective.step_bound(x, np.zeros_like(x))
    energy, gradient = objective.energy(x), objective.gradient(x)
    for iteration in range(scene.iteration_limit):
        if time.perf_counter() > deadline:
            return Solution(x, False, iteration, out_of_time=True)
        direction = _direction(objective, x, gradient, solver, exact=last < _EXACT_BELOW)
        last = _longest(direction)
        if last < scene.tolerance:
            return Solution(x, True, iteration)
        if last > scene.longest_step:
            direction *= scene.longest_step / last
        bound = objective.step_bound(x, direction)
        slope = float(np.vdot(gradient, direction))
        fraction = bound
        while True:
            value = objective.energy(x + fraction * direction)
            if value <= energy + _ARMIJO * fraction * slope + _ROUNDING * abs(energy):
                break
            fraction *= 0.5
            if fraction < _SHORTEST_FRACTION * bound:
                return Solution(x, False, iteration)
        x = x + fraction * direction
        energy, gradient = value, objective.gradient(x)
    return Solution(x, False, scene.iteration_limit)


def _direction(objective, x, gradient, solver, *, exact: bool) -> Positions:
    projected = None
    if exact:
        true = objective.hessian(x, exact=True)
        for share in _SHARES:
            if share and projected is None:
                projected = objective.hessian(x, exact=False)
            mixed = (1.0 - share) * true + share * projected if share else true
            try:
                return -solver.factorize(mixed).solve(gradient.ravel()).reshape(x.shape)
            except LinearSolveError:
                continue
    if projected is None:
        projected = objective.hessian(x, exact=False)
    return -solver.factorize(projected).solve(gradient.ravel()).reshape(x.shape)


def _longest(displacement: Positions) -> float:
    return float(np.sqrt(np.max(np.sum(displacement**2, axis=1))))
