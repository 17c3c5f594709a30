"""Settings of a fit; the loss weights default to the paper's (S16.2), the rest is ours (S9.13)."""

import dataclasses
import enum
import math
from collections.abc import Mapping
from types import MappingProxyType

from dress_jax.core.errors import InputError
from dress_jax.loss.image import COLOR_WEIGHT, MASK_WEIGHT, NORMAL_WEIGHT
from dress_jax.optimisation.fabric_freedom import FabricFreedom
from dress_jax.optimisation.gauss_newton.options import GaussNewtonOptions

PAPER_WEIGHTS: Mapping[str, float] = MappingProxyType(
    {
        "mask": MASK_WEIGHT,
        "color": COLOR_WEIGHT,
        "normal": NORMAL_WEIGHT,
        "comfort": 0.1,
        "laplacian": 0.001,
        "area_ratio": 0.01,
        "small_angle": 0.01,
        "discretization": 0.001,
        "boundary_corner": 0.001,
        "seam_length": 0.1,
        "seam_curvature": 0.1,
    }
)
"""Weights of the terms that a fit knows: image losses (S10) and regularizers (S11, S16.2).

The paper gives lambda_SL twice, 0.1 both times; the second is read as that of the seam curvature.
"""


class FitMethod(enum.Enum):
    """How steps are found.

    Gauss-Newton compares outlines, normals, scans and landmarks, and linearizes the drape in all
    unknowns; Adam follows the gradient of all loss terms, colours among them.
    """

    GAUSS_NEWTON = "gauss-newton"
    ADAM = "adam"


@dataclasses.dataclass(frozen=True)
class LearningRates:
    """Step lengths in the first iteration: of the four groups of unknowns, and of whole panels.

    Attributes:
        panels: of the width and the length of every panel, relative; see `optimizer`.
        vertices: of the pattern's corners [m].
        controls: of its control points [chord lengths].
        log_stiffness: of the fabric's unknowns, mostly logarithms of factors.
        pin_shift: of the pins [m].
        colors: of the vertex colours, in [0, 1].
    """

    panels: float = 0.015
    vertices: float = 4e-3
    controls: float = 5e-3
    log_stiffness: float = 0.02
    pin_shift: float = 1e-3
    colors: float = 0.05


@dataclasses.dataclass(frozen=True)
class FitOptions:
    """How a pattern is fitted.

    Attributes:
        method: how steps are found; learning rates, stages, views per iteration, moments and
            shrinking belong to Adam.
        gauss_newton: settings of that method.
        iterations: steps, accepted or not.
        stage_one: steps with frozen control points (S9.12); they are free afterwards.
        rates: learning rates.
        final_rate: share of the rates left at the last iteration; they follow half a cosine.
        weights: weight of every term by name; a term that is absent or zero is not computed.
        symmetrize: whether panels that mirror each other, or themselves, in the initial pattern do
            so in every pattern that is draped and compared (S4); see `pattern.symmetry`.
        fabric: which numbers of the fabric are unknown.
        initial_stiffness: factors on the stretching and the bending stiffness to begin with.
        views_per_iteration: how many views one iteration looks at; None for all. A subset moves
            on through a fixed permutation of the views, so that every view has its turn.
        seed: of that permutation.
        momentum, memory: decay of the first and second moments of the gradient (Adam's betas).
        sharing: how far the corners (and the control points) share one step length, in [0, 1]: at 0
            each moves by the rate, at 1 in proportion to its gradient; see `optimizer`.
        clip: a group's gradient is shortened to this multiple of its recent root mean square.
        largest_remaining_step: a drape that missed its tolerance is still used if its last Newton
            step moved no vertex further than this [m].
        polish: how often a drape without a gradient goes on to a tighter tolerance.
        smallest_area: least area of a rest triangle, relative to the area it was meshed with;
            negative areas are flipped triangles (S12.4).
        guarded_area: proposals with a relative area below this one are first moved to the nearest
            pattern without any (`flip_guard`, S12); 0 leaves them as they are.
        remesh_distortion: a fit that can remesh does so when a length in some triangle has changed
            by more than this factor since it was meshed (`remeshing`, S13.1).
        refreshes: how often a fit that has come to rest before its last iteration puts the garment
            on anew, and goes on from there if that fits better.
        shrink, grow: factors on the learning rates after a rejected and an accepted step.
        smallest_scale: the fit ends when rejections have shrunk the rates below this share.
    """

    method: FitMethod = FitMethod.GAUSS_NEWTON
    gauss_newton: GaussNewtonOptions = dataclasses.field(default_factory=GaussNewtonOptions)
    iterations: int = 60
    stage_one: int = 20
    rates: LearningRates = dataclasses.field(default_factory=LearningRates)
    final_rate: float = 0.1
    weights: Mapping[str, float] = dataclasses.field(default_factory=lambda: PAPER_WEIGHTS)
    symmetrize: bool = True
    fabric: FabricFreedom = dataclasses.field(default_factory=FabricFreedom)
    initial_stiffness: tuple[float, float] = (1.0, 1.0)
    views_per_iteration: int | None = None
    seed: int = 0
    momentum: float = 0.8
    memory: float = 0.95
    sharing: float = 0.75
    clip: float = 3.0
    largest_remaining_step: float = 1e-3
    polish: int = 2
    smallest_area: float = 0.1
    guarded_area: float = 0.2
    remesh_distortion: float = 2.0
    refreshes: int = 2
    shrink: float = 0.5
    grow: float = 1.5
    smallest_scale: float = 1e-3

    def __post_init__(self) -> None:
        unknown = sorted(set(self.weights) - set(PAPER_WEIGHTS))
        if unknown:
            raise InputError(
                f"unknown loss terms {unknown}",
                where="fit options",
                mend=f"terms are {sorted(PAPER_WEIGHTS)}",
            )
        amounts = dict(self.weights) | dataclasses.asdict(self.rates)
        for name, value in amounts.items():
            _require(math.isfinite(value) and value >= 0.0, name, value, "at least 0")
        _require(self.iterations >= 0, "iterations", self.iterations, "at least 0")
        _require(self.stage_one >= 0, "stage_one", self.stage_one, "at least 0")
        _require(self.refreshes >= 0, "refreshes", self.refreshes, "at least 0")
        _require(self.polish >= 0, "polish", self.polish, "at least 0")
        views = self.views_per_iteration
        _require(views is None or views >= 1, "views_per_iteration", views, "at least 1, or None")
        subset = views is not None and self.method is FitMethod.GAUSS_NEWTON
        _require(not subset, "views_per_iteration", views, "None, or the method Adam")
        for name in ("final_rate", "shrink", "smallest_scale"):
            _require(0.0 < getattr(self, name) <= 1.0, name, getattr(self, name), "in (0, 1]")
        for name in ("momentum", "memory", "smallest_area", "guarded_area"):
            _require(0.0 <= getattr(self, name) < 1.0, name, getattr(self, name), "in [0, 1)")
        for factor in self.initial_stiffness:
            valid = math.isfinite(factor) and factor > 0.0
            _require(valid, "initial_stiffness", self.initial_stiffness, "positive")
        _require(0.0 <= self.sharing <= 1.0, "sharing", self.sharing, "in [0, 1]")
        _require(self.shrink < 1.0, "shrink", self.shrink, "below 1")
        _require(
            self.remesh_distortion > 1.0, "remesh_distortion", self.remesh_distortion, "above 1"
        )
        _require(self.grow >= 1.0, "grow", self.grow, "at least 1")
        _require(self.clip > 0.0, "clip", self.clip, "positive")
        remaining = self.largest_remaining_step
        _require(remaining >= 0.0, "largest_remaining_step", remaining, "at least 0")

    @property
    def active_weights(self) -> dict[str, float]:
        """The terms that are computed, with their weights."""
        return {name: float(w) for name, w in sorted(self.weights.items()) if w > 0.0}


def _require(holds: bool, name: str, value: object, wanted: str) -> None:
    if not holds:
        raise InputError(f"{name} is {value}", where="fit options", mend=f"it must be {wanted}")
