"""What a contestant hands back."""

import dataclasses
from typing import Protocol

import numpy as np
from jaxtyping import Float

from benchmarks.peers.scenes import Scene


@dataclasses.dataclass
class Run:
    """One scene, solved as far as the time went.

    Attributes:
        positions: at the end [m], (n, 3).
        seconds: of all steps, compilation apart.
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
