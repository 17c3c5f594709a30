"""The same energies and the same Newton as Warp kernels."""

import time

import numpy as np

from benchmarks.peers.contestants.dress import cotangent
from benchmarks.peers.descent import Cholesky
from benchmarks.peers.march import march
from benchmarks.peers.record import Run
from benchmarks.peers.scenes import Scene
from dress_jax.solver.linear import LinearSolveError


class WarpBaseline:
    """Projected Newton and an adjoint in Warp.

    On a CPU the matrix is factorized by the solver that dress_jax has; on CUDA, where that would
    leave the device, it is solved by Warp's conjugate gradients.
    """

    packages = ("warp-lang", "numpy", "scipy", "pypardiso")

    def __init__(self) -> None:
        import warp as wp

        wp.config.quiet = True
        wp.init()
        self.device = "cuda" if wp.is_cuda_available() else "cpu"
        if self.device == "cpu":
            self._solver = Cholesky()
        else:
            from benchmarks.peers.warp_simulator.iterative import WarpConjugateGradient

            self._solver = WarpConjugateGradient(self.device)
        self.solver = f"{self._solver.name}, kernels on {self.device}"

    def run(self, scene: Scene, seconds: float) -> Run:
        """All steps; the adjoint after a static solve that converged."""
        from benchmarks.peers.warp_simulator.objective import WarpObjective

        begun = time.perf_counter()
        objective = WarpObjective(scene, self.device)
        _warm_up(objective)
        compiled = time.perf_counter() - begun
        run = march(objective, scene, self._solver, seconds)
        run.compile_seconds = compiled
        if scene.steps or not run.converged:
            return run
        begun = time.perf_counter()
        try:
            factor = self._solver.factorize(objective.hessian(run.positions, exact=True))
            adjoint = factor.solve(cotangent(scene).ravel()).reshape(run.positions.shape)
        except LinearSolveError:
            run.note = "no stable minimum: no gradient"
            return run
        objective.pulled_back(run.positions, adjoint)
        run.gradient_seconds = time.perf_counter() - begun
        return run


def _warm_up(objective) -> None:
    """Every kernel once: Warp compiles a module when it is first launched."""
    x = objective.scene.start
    objective.step_bound(x, np.full_like(x, 1e-12))
    objective.energy(x)
    objective.gradient(x)
    objective.hessian(x, exact=False)


def make() -> WarpBaseline:
    """The contestant."""
    return WarpBaseline()
