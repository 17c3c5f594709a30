"""What a contestant hands back."""

import dataclasses
import time
from typing import Protocol

import numpy as np
from jaxtyping import Float

from benchmarks.peers.scenes import Scene


class Clock:
    """Seconds since it was made, on the wall and of all threads."""

    def __init__(self) -> None:
        self._begun = time.perf_counter(), time.process_time()

    @property
    def seconds(self) -> float:
        """On the wall."""
        return time.perf_counter() - self._begun[0]

    @property
    def cpu_seconds(self) -> float:
        """Of all threads."""
        return time.process_time() - self._begun[1]


@dataclasses.dataclass
class Run:
    """One scene, solved as far as the time went.

    Attributes:
        positions: at the end [m], (n, 3).
        seconds: of all steps, compilation apart.
        cpu_seconds: of all threads in that time; what other programs take does not count.
        iterations: Newton steps, or sweeps of a solver that has none.
        steps: time steps that were finished; 1 for a static solve.
        converged: whether every step met the stopping rule.
        compile_seconds: what a first run takes longer.
        gradient_seconds: of the backward pass, where there is one.
        note: what a reader has to know.
    """

    positions: Float[np.ndarray, "n 3"]
    seconds: float
    iterations: int
    steps: int
    converged: bool
    cpu_seconds: float = 0.0
    compile_seconds: float = 0.0
    gradient_seconds: float | None = None
    note: str = ""


class Contestant(Protocol):
    """A simulator in the contest; made anew in a process of its own."""

    packages: tuple[str, ...]
    solver: str

    def run(self, scene: Scene, seconds: float) -> Run | None:
        """Solve a scene, beginning no iteration after so many seconds; None: not its kind."""
        ...
