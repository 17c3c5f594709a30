"""What one step of a fit reports."""

import dataclasses
import enum
from collections.abc import Mapping

import numpy as np

from dress_jax.core.results import Result


class StepOutcome(enum.Enum):
    """Whether a proposal was kept, and if not, why."""

    ACCEPTED = "accepted"
    REST_DEGENERATE = "a rest triangle would flip or lose its area"
    SOLVE_FAILED = "the drape did not come close enough to an equilibrium"
    RULE_BROKEN = "a design rule does not hold"
    INTERSECTS = "the drape has intersections"
    NON_FINITE = "a number is not finite"
    WORSE = "the cost did not fall"
    ADJOINT_FAILED = "the drape is no stable equilibrium, so it has no gradient"


@dataclasses.dataclass(frozen=True)
class FitInfo:
    """What one step did; numbers only, ready for a report.

    Attributes:
        iteration: number of the step, from 0.
        outcome: see `StepOutcome`.
        loss: of the proposal; NaN where it was not computed.
        terms: its terms before weighting, by name.
        iou: of the masks in the views of this iteration; NaN where it was not computed.
        newton_iterations: of the drape.
        solve_result: how the drape ended; None where there was none.
        remaining_step: length of its last Newton step [m].
        intersections: of the drape, by the exact test.
        guided_rounds: in which a Gauss-Newton drape was pulled toward the pictures before it began.
        rate_scale: factor on the learning rates with which the proposal was made (Adam).
        cost: what a Gauss-Newton step lowers; NaN where it was not computed.
        outline: root mean square distance of the outlines [m], likewise.
        damping: with which a Gauss-Newton proposal was made.
        unfinished: contours without a gradient; anything above zero calls for a coarser mesh or
            smaller images.
        seconds: by stage ("forward", "loss", "adjoint", "total") where a clock was given.
    """

    iteration: int
    outcome: StepOutcome
    loss: float = np.nan
    terms: Mapping[str, float] = dataclasses.field(default_factory=dict)
    iou: float = np.nan
    newton_iterations: int = 0
    solve_result: Result | None = None
    remaining_step: float = np.nan
    intersections: int = 0
    guided_rounds: int = 0
    rate_scale: float = 1.0
    cost: float = np.nan
    outline: float = np.nan
    damping: float = np.nan
    unfinished: int = 0
    seconds: Mapping[str, float] = dataclasses.field(default_factory=dict)

    @property
    def accepted(self) -> bool:
        """Whether the proposal was kept."""
        return self.outcome is StepOutcome.ACCEPTED
