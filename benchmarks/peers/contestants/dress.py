"""dress_jax itself."""

import time

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.peers.record import Clock, Run
from benchmarks.peers.scenes import Scene
from dress_jax.contact.barrier import contact_settings
from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Parameters, make_cloth
from dress_jax.energy.fabric import Fabric, make_parameters
from dress_jax.sim import Simulator, State, make_simulator, static_solve, step
from dress_jax.solver import NewtonOptions, NewtonProgress


def build(scene: Scene) -> tuple[Simulator, Parameters]:
    """Simulator and parameters of a scene, without friction."""
    cloth = make_cloth(scene.faces, pins=scene.pins)
    simulator = make_simulator(
        cloth,
        scene.start,
        body_vertices=scene.body_vertices,
        body_faces=scene.body_faces,
        settings=contact_settings(dhat=scene.dhat, thickness=scene.thickness),
        newton=NewtonOptions(
            tolerance=scene.tolerance,
            iteration_limit=scene.iteration_limit,
            longest_step=scene.longest_step,
        ),
    )
    parameters = make_parameters(
        cloth,
        Fabric(scene.density, scene.stretching, scene.bending),
        jnp.asarray(scene.rest),
        body_vertices=jnp.asarray(scene.body_vertices),
        pin_targets=jnp.asarray(scene.pin_targets),
    )
    return simulator, replace(
        parameters,
        barrier_stiffness=jnp.asarray(scene.barrier),
        pin_stiffness=jnp.asarray(scene.pin_stiffness),
        gravity=jnp.asarray([0.0, scene.gravity, 0.0]),
    )


_COMPILING = 4.0  # times the time of a scene, for the run that compiles


class _OutOfTimeError(Exception):
    def __init__(self, progress: NewtonProgress):
        super().__init__("out of time")
        self.progress = progress


class Dress:
    """`step` and `static_solve`, each scene once to compile and once to measure."""

    packages = ("jax", "jaxlib", "numpy", "scipy", "pypardiso", "numba")

    def __init__(self) -> None:
        jax.config.update("jax_enable_x64", True)
        self.solver = ""

    def run(self, scene: Scene, seconds: float) -> Run:
        """The second of two runs of a scene; the long `settle` runs once."""
        if scene.name == "settle":
            run = self._once(scene, seconds)
            run.note = f"{run.note + ', ' if run.note else ''}with compilation"
            return run
        # A program that the first run does not reach would be compiled in the second.
        first = self._once(scene, _COMPILING * seconds)
        second = self._once(scene, seconds)
        second.compile_seconds = max(first.seconds - second.seconds, 0.0)
        return second

    def _once(self, scene: Scene, seconds: float) -> Run:
        simulator, parameters = build(scene)
        self.solver = simulator.linear_solver.name
        clock = Clock()

        def watch(progress: NewtonProgress) -> None:
            if clock.seconds > seconds:
                raise _OutOfTimeError(progress)

        simulator.progress = watch
        if scene.steps:
            return _dynamic(simulator, parameters, scene, clock)
        return _static(simulator, parameters, scene, clock)


def _dynamic(simulator: Simulator, parameters: Parameters, scene: Scene, clock: Clock) -> Run:
    state = State(jnp.asarray(scene.start), jnp.zeros(scene.start.shape))
    iterations, steps = 0, 0
    try:
        for _ in range(scene.steps):
            state, report = step(simulator, state, parameters, time_step=scene.time_step)
            iterations += int(report.iterations)
            steps += 1
            if not report.converged:
                return _run(state.positions, clock, iterations, steps - 1, "not converged")
    except _OutOfTimeError as stop:
        iterations += stop.progress.iteration
        return _run(stop.progress.positions, clock, iterations, steps, "out of time")
    return _run(state.positions, clock, iterations, steps, "")


def _static(simulator: Simulator, parameters: Parameters, scene: Scene, clock: Clock) -> Run:
    def solve(parameters):
        drape = static_solve(simulator, parameters, scene.start)
        return drape.positions, drape.report

    try:
        positions, pull, report = jax.vjp(solve, parameters, has_aux=True)
    except _OutOfTimeError as stop:
        progress = stop.progress
        return _run(progress.positions, clock, progress.iteration, 0, "out of time")
    note = "" if report.converged else "not converged"
    run = _run(positions, clock, int(report.iterations), int(report.converged), note)
    jax.block_until_ready(pull(jnp.asarray(cotangent(scene))))  # compiled, if it was not yet
    pulled = time.perf_counter()
    gradient = jax.block_until_ready(pull(jnp.asarray(cotangent(scene))))
    seconds = time.perf_counter() - pulled
    if all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient)):
        run.gradient_seconds = seconds
    return run


def cotangent(scene: Scene) -> np.ndarray:
    """Of a random linear function of the drape, the same for all contestants."""
    return np.random.default_rng(0).normal(size=scene.start.shape)


def _run(positions, clock: Clock, iterations: int, steps: int, note: str) -> Run:
    positions = np.asarray(positions)
    return Run(positions, clock.seconds, iterations, steps, not note, clock.cpu_seconds, note=note)


def make() -> Dress:
    """The contestant."""
    return Dress()
