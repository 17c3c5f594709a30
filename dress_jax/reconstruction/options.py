"""Options of a reconstruction: what is free, the weights of the losses, the steps."""

import dataclasses

from dress_jax.core.errors import InputError


@dataclasses.dataclass(frozen=True, kw_only=True)
class Free:
    """What a stage may change.

    Args:
        scale: the global scale S (S7.3).
        rotation: the global rotation R (S7.3).
        translation: the place of the pelvis (S7.13).
        pose: rotations of the joints of trunk, head, arms and legs.
        hands: those of the fingers too, where the pose is free.
        shape: shape coefficients.
    """

    scale: bool = True
    rotation: bool = True
    translation: bool = True
    pose: bool = True
    hands: bool = True
    shape: bool = True


@dataclasses.dataclass(frozen=True, kw_only=True)
class Weights:
    """Weights of the losses (S7.10); the paper gives no numbers.

    Lengths in pictures count in image heights, so that no weight depends on the resolution.

    Args:
        rgb: of the mean absolute error of colours in [0, 1].
        mask: of that of the coverage.
        landmark: lambda_1, of the mean squared distance [image heights squared].
        pose: lambda_2, of the mean absolute difference to the estimated pose [rad].
        shape: lambda_3, of that to the estimated shape [standard deviations].
        prior: of the human prior, where there is no estimate.
    """

    rgb: float = 1.0
    mask: float = 1.0
    landmark: float = 100.0
    pose: float = 5e-4
    shape: float = 5e-5
    prior: float = 1e-5


@dataclasses.dataclass(frozen=True, kw_only=True)
class Rates:
    """Step lengths of Adam at the beginning of the fine stage.

    Args:
        log_scale: of the logarithm of the scale.
        translation: [m].
        rotation: of the global rotation [rad].
        pose: of all other joints [rad].
        shape: [standard deviations].
        colors: of the vertex colours in [0, 1].
    """

    log_scale: float = 0.001
    translation: float = 0.001
    rotation: float = 0.002
    pose: float = 0.004
    shape: float = 0.02
    colors: float = 0.01


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReconstructionOptions:
    """Options of `reconstruct`.

    Args:
        coarse: free in the coarse stage; pose and shape never are.
        free: free in the stages after it.
        weights: of the losses.
        rates: of Adam.
        landmark_iterations: steps at most of Levenberg-Marquardt, coarse and after it.
        fine_iterations: steps of Adam; none where zero.
        views_per_iteration: views whose pictures one step of Adam looks at; all when None.
        final_rate: part of the rates that is left at the end, falling by half a cosine.
        seed: of the order in which views are looked at.

    Raises:
        InputError: a number out of its range.
    """

    coarse: Free = Free(pose=False, hands=False, shape=False)
    free: Free = Free()
    weights: Weights = Weights()
    rates: Rates = Rates()
    landmark_iterations: int = 60
    fine_iterations: int = 100
    views_per_iteration: int | None = 5
    final_rate: float = 0.05
    seed: int = 0

    def __post_init__(self) -> None:
        counts = (self.landmark_iterations, self.fine_iterations)
        if min(counts) < 0 or (self.views_per_iteration or 1) < 1:
            raise InputError("a number of iterations or views is negative", where="options")
        for group in (self.weights, self.rates):
            if not all(0.0 <= value < float("inf") for value in vars(group).values()):
                raise InputError(f"a number of {group} is negative or not finite", where="options")
        if not 0.0 < self.final_rate <= 1.0:
            raise InputError(f"final_rate is {self.final_rate}, not in (0, 1]", where="options")
