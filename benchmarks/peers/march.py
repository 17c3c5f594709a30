"""Time steps of a peer, one after the other."""

import time
from typing import Protocol

import numpy as np

from benchmarks.peers.descent import Objective, Positions, Solver, minimize
from benchmarks.peers.record import Clock, Run
from benchmarks.peers.scenes import Scene


class StepObjective(Objective, Protocol):
    """An objective that can be moved to the next step."""

    def begin(self, start: Positions, velocity: Positions) -> None:
        """Begin a step at positions [m] with velocities [m/s]."""
        ...


def march(objective: StepObjective, scene: Scene, solver: Solver, seconds: float) -> Run:
    """All steps of a scene from rest, or as many as the time allows."""
    clock, deadline = Clock(), time.perf_counter() + seconds
    x, velocity = scene.start, np.zeros_like(scene.start)
    iterations, steps, converged, note = 0, 0, True, ""
    for _ in range(max(scene.steps, 1)):
        objective.begin(x, velocity)
        solution = minimize(objective, x, scene, solver, deadline=deadline)
        iterations += solution.iterations
        converged = solution.converged
        velocity = (solution.positions - x) / scene.time_step
        x = solution.positions
        if not converged:
            note = "out of time" if solution.out_of_time else "not converged"
            break
        steps += 1
    return Run(x, clock.seconds, iterations, steps, converged, clock.cpu_seconds, note=note)
