"""Remembers the end of the last step, ready for its derivatives.

The backward pass that follows a solve finds there what the solve had at hand. Only the last end is
kept, so a chain of steps holds its states and nothing else; whatever is missing is made anew.
"""

from typing import TYPE_CHECKING

import jax
import numpy as np
from jaxtyping import Float

from dress_jax.sim.inputs import StepInputs

if TYPE_CHECKING:
    from dress_jax.sim.adjoint import Linearization


class LastEnd:
    """One linearization; copies of a simulator share the place for it."""

    def __init__(self) -> None:
        self._kept: Linearization | None = None

    def keep(self, linearization: "Linearization") -> None:
        """In place of the one before."""
        self._kept = linearization

    def find(
        self, simulator: object, inputs: StepInputs, positions: Float[np.ndarray, "n 3"]
    ) -> "Linearization | None":
        """The one of these very arrays and this simulator, or none."""
        kept = self._kept
        if kept is None or kept.objective.simulator is not simulator:
            return None
        known = (kept.positions, kept.objective.inputs)
        pairs = zip(jax.tree.leaves(known), jax.tree.leaves((positions, inputs)), strict=True)
        return kept if all(np.array_equal(a, b) for a, b in pairs) else None
