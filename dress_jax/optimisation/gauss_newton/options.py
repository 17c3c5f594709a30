"""Settings of the Gauss-Newton method (ours; the paper uses Adam throughout)."""

import dataclasses
import math

from dress_jax.core.errors import InputError


@dataclasses.dataclass(frozen=True)
class GaussNewtonOptions:
    """What counts how much, and how far one step may go.

    The cost is half a sum of mean squares, each measured in its own scale: an outline that is off
    by `outline_scale` all over costs as much as edges strained by `shape_scale` all over. Scales
    are exchange rates and not bounds; a larger one means that the quantity matters less.

    Attributes:
        outline_scale: distance of outlines [m].
        robust: distance beyond which an outline pulls with constant strength [m].
        normal_scale: length of the difference of drawn and target normals.
        normal_robust: length beyond which a difference pulls with constant strength.
        normal_stride: distance of the pixels at which normals are compared [px].
        scan_scale: distance of a scan [m].
        scan_robust: distance beyond which a point of a scan pulls with constant strength [m].
        landmark_scale: distance of landmarks [m].
        landmark_robust: distance beyond which a landmark pulls with constant strength [m].
        guidance: rounds in which a drape is pulled toward the pictures before it is let go
            (`guidance`); 0 begins where the sensitivities predict it.
        shape_scale: strain of pattern edges beyond what one linear map per panel explains.
        size_scale: strain of pattern edges.
        control_scale: way of control points [chord lengths].
        seam_scale: change of a seam's length difference between its two sides [m].
        stiffness_scale: change of the fabric's unknowns, mostly logarithms of factors.
        fabric_scale: likewise, of how a panel's fabric differs from the garment's mean.
        pin_scale: displacement of the pins [m].
        longest_step: of a pattern corner in one step [m].
        longest_control_step: of a control point [chord lengths].
        longest_pin_step: of the pins [m].
        longest_stiffness_step: of the logarithm of a stiffness factor.
        damping: in the first step, relative to the diagonal of the normal matrix.
        least_damping, most_damping: bounds; a fit that would need more damping has ended.
        raise_damping, lower_damping: factors after a rejected, and after a well-predicted step.
        longest_excursion: so many steps in a row may stay above the best cost.
        excursion_height: and up to this multiple of it.
        idle_decrease: steps that together lower the best cost by a smaller part of it are idle.
        idle_steps: a fit rests after this many idle steps in a row.
        recenterings: how often a fit at rest goes on with its prior moved to where it is. What the
            images leave open stays; what they say a little about is not drawn back any more.
    """

    outline_scale: float = 0.01
    robust: float = 0.03
    normal_scale: float = 0.5
    normal_robust: float = 0.3
    normal_stride: int = 6
    scan_scale: float = 0.005
    scan_robust: float = 0.05
    landmark_scale: float = 0.01
    landmark_robust: float = 0.05
    guidance: int = 3
    shape_scale: float = 0.25
    size_scale: float = 0.6
    control_scale: float = 0.13
    seam_scale: float = 0.02
    stiffness_scale: float = 7.0
    fabric_scale: float = 1.5
    pin_scale: float = 0.1
    longest_step: float = 0.03
    longest_control_step: float = 0.1
    longest_pin_step: float = 0.01
    longest_stiffness_step: float = 0.5
    damping: float = 1e-2
    least_damping: float = 1e-3
    most_damping: float = 30.0
    raise_damping: float = 5.0
    lower_damping: float = 0.3
    longest_excursion: int = 4
    excursion_height: float = 2.0
    idle_decrease: float = 0.02
    idle_steps: int = 6
    recenterings: int = 2

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name in ("guidance", "recenterings") and value == 0:
                continue
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(
                    f"{field.name} is {value}",
                    where="Gauss-Newton options",
                    mend="it must be positive",
                )
        if not self.lower_damping < 1.0 < self.raise_damping:
            raise InputError(
                f"lower_damping is {self.lower_damping}, raise_damping {self.raise_damping}",
                where="Gauss-Newton options",
                mend="they must lie below and above 1",
            )
