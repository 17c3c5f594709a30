"""What is known about a drape apart from how its solve went: is it an equilibrium, is it stable?"""

import dataclasses

import numpy as np
import scipy.sparse.linalg
from jaxtyping import Float

from dress_jax.core.precision import require_float64
from dress_jax.energy.cloth import Parameters
from dress_jax.sim.objective import StepObjective, resting_objective
from dress_jax.sim.simulator import Simulator
from dress_jax.solver.linear import Factorization, LinearSolveError

_TOLERANCE = 1e-6  # of the eigenvalue, relative to its distance from the shift
_FIRST_SHIFT, _LAST_SHIFT = 10.0, 1e12  # [1/s^2]
_INERTIA = 1.0  # what a step of 1 s adds to every eigenvalue [1/s^2]


@dataclasses.dataclass(frozen=True)
class Certificate:
    """Of a state as a static equilibrium.

    Attributes:
        residual: largest force on a vertex [N], inertia left out.
        smallest_eigenvalue: of the exact Hessian of all energies in x, relative to the masses
            [1/s^2]: the squared angular frequency of the slowest vibration. Below zero the state
            is a saddle from which the cloth would buckle; near zero its derivatives are large.
    """

    residual: float
    smallest_eigenvalue: float

    @property
    def stable(self) -> bool:
        """Whether the state is a minimum of the energy."""
        return self.smallest_eigenvalue > 0.0


def certify(
    simulator: Simulator, parameters: Parameters, positions: Float[np.ndarray, "n 3"]
) -> Certificate:
    """Examine a drape: the forces that are left, and its slowest mode.

    The eigenvalue comes from Lanczos iterations with a Cholesky factorization of the exact Hessian,
    moved up by a multiple of the masses where it is indefinite.

    Args:
        simulator: host object; its sparsity may be extended.
        parameters: of the drape.
        positions: the drape [m].

    Raises:
        RuntimeError: double precision is off.
        LinearSolveError: the Hessian is not finite, or the Lanczos iterations do not converge.
    """
    require_float64("certify")
    x = np.asarray(positions, np.float64)
    objective = resting_objective(simulator, parameters, x)
    # A step of 1 s from rest here: its inertia has no force.
    _, gradient = objective.value_and_gradient(x)
    residual = float(np.max(np.linalg.norm(gradient, axis=1), initial=0.0))
    start = np.cos(np.arange(x.size, dtype=np.float64))  # the same answer every time
    factorization, shift = _shifted(objective, x, start)
    inverse = _Inverse(factorization, np.repeat(np.sqrt(objective.masses), 3))
    try:
        largest = scipy.sparse.linalg.eigsh(
            inverse,
            k=1,
            which="LA",
            v0=start,
            tol=_TOLERANCE,  # pyright: ignore[reportArgumentType] (the stub of SciPy says int)
            return_eigenvectors=False,
        )
    except scipy.sparse.linalg.ArpackNoConvergence as error:
        raise LinearSolveError("the smallest eigenvalue of the drape was not found") from error
    return Certificate(residual, float(1.0 / largest[0]) - shift - _INERTIA)


class _Inverse(scipy.sparse.linalg.LinearOperator):
    """M^1/2 H^-1 M^1/2, whose largest eigenvalue belongs to the slowest mode."""

    def __init__(self, factorization: Factorization, roots: Float[np.ndarray, " m"]):
        super().__init__(np.dtype(np.float64), (len(roots), len(roots)))
        self._factorization, self._roots = factorization, roots

    def _matvec(self, x: np.ndarray) -> np.ndarray:
        return self._roots * self._factorization.solve(self._roots * x.ravel())


def _shifted(
    objective: StepObjective, x: np.ndarray, trial: np.ndarray
) -> tuple[Factorization, float]:
    """The exact Hessian, factorized with the smallest of a few shifts [1/s^2] that lets it.

    Args:
        trial: a right-hand side, since an iterative solver may fail no earlier than in a solve.
    """
    shift = 0.0
    while True:
        try:
            factorization = objective.factorize(x, exact=True, shift=shift)
            factorization.solve(trial)
            return factorization, shift
        except LinearSolveError:
            shift = max(10.0 * shift, _FIRST_SHIFT)
            if shift > _LAST_SHIFT:
                raise
