"""numpy, ipctk and a direct solver."""

import time

from benchmarks.peers.contestants.dress import cotangent
from benchmarks.peers.descent import Cholesky
from benchmarks.peers.ipctk_simulator import IpctkObjective
from benchmarks.peers.march import march
from benchmarks.peers.parameters import pulled_back
from benchmarks.peers.record import Run
from benchmarks.peers.scenes import Scene
from dress_jax.solver.linear import LinearSolveError


class IpctkBaseline:
    """Projected Newton and an adjoint, as a user can assemble them."""

    packages = ("ipctk", "numpy", "scipy", "pypardiso")

    def __init__(self) -> None:
        self._cholesky = Cholesky()
        self.solver = self._cholesky.name

    def run(self, scene: Scene, seconds: float) -> Run:
        """All steps; the adjoint after a static solve that converged."""
        objective = IpctkObjective(scene)
        run = march(objective, scene, self._cholesky, seconds)
        if scene.steps or not run.converged:
            return run
        begun = time.perf_counter()
        try:
            factor = self._cholesky.factorize(objective.hessian(run.positions, exact=True))
        except LinearSolveError:
            run.note = "no stable minimum: no gradient"
            return run
        adjoint = factor.solve(cotangent(scene).ravel()).reshape(run.positions.shape)
        pulled_back(scene, run.positions, adjoint)
        run.gradient_seconds = time.perf_counter() - begun
        return run


def make() -> IpctkBaseline:
    """The contestant."""
    import ipctk  # noqa: F401 (a missing package is found before anything is built)

    return IpctkBaseline()
