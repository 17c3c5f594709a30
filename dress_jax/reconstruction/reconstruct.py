"""From views of a person to a body: coarse, landmarks, fine (S7)."""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from dress_jax.body.model import BodyModel
from dress_jax.body.poses import relaxed_pose
from dress_jax.body.skeleton import joint_index
from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.reconstruction import fine
from dress_jax.reconstruction.landmark_fit import fit_coarse, fit_landmarks, middle_of_view
from dress_jax.reconstruction.landmarks import LandmarkMap, landmark_map
from dress_jax.reconstruction.levenberg_marquardt import Minimum
from dress_jax.reconstruction.losses import Strengths, landmark_loss
from dress_jax.reconstruction.options import ReconstructionOptions
from dress_jax.reconstruction.parameters import BodyParameters, make_parameters
from dress_jax.reconstruction.views import BodyViews

_THIGHS_FORWARD, _SHINS_BACK = 0.35, 1.0  # [rad]

Listener = Callable[[str, int, int, float | None], None]
"""Called with a stage, pieces done, pieces at most, and the loss."""


@dataclasses.dataclass(frozen=True)
class Reconstruction:
    """A body and how it was found.

    Attributes:
        parameters: of the body.
        colors: RGB of its vertices, or None without pictures, (n, 3).
        coarse: the parameters after the coarse stage.
        by_landmarks: those after the stage of landmarks.
        coarse_fit, landmark_fit: how these two went.
        fine_terms: losses of every step of the fine stage, of the views it looked at.
        fine_start, fine_end: losses over all views before and after it, or None without pictures.
        fine_kept: whether it lowered the loss; otherwise the body is that of the landmarks.
        landmark_error: root of the mean squared distance, weighted by confidence [px].
    """

    parameters: BodyParameters
    colors: Float[np.ndarray, "n 3"] | None
    coarse: BodyParameters
    by_landmarks: BodyParameters
    coarse_fit: Minimum
    landmark_fit: Minimum
    fine_terms: tuple[fine.FineTerms, ...]
    fine_start: fine.FineTerms | None
    fine_end: fine.FineTerms | None
    fine_kept: bool
    landmark_error: float


def reconstruct(
    model: BodyModel,
    views: BodyViews,
    *,
    estimate: BodyParameters | None = None,
    options: ReconstructionOptions | None = None,
    listen: Listener | None = None,
) -> Reconstruction:
    """Find the body that several views show.

    Coarse: scale, rotation and place by landmarks (S7.3, S7.13). Then pose and shape as well, by
    landmarks. Fine: everything by pictures and landmarks (S7.6-S7.10), where there are masks.

    Args:
        model: the embedded body, or an SMPL-X one.
        views: from `make_body_views`.
        estimate: pose and shape to begin with and to stay near, such as OSX's (S7.2); its scale,
            rotation and place are beginnings only. None begins with a standing body and keeps the
            joints in human range.
        options: weights, freedom and steps.
        listen: for progress.

    Raises:
        InputError: a body of other joints, an estimate that does not fit it, or a result that is
            not finite.
    """
    options = ReconstructionOptions() if options is None else options
    tell = listen or _silent
    mapping = landmark_map(model)
    if estimate is None:
        start = make_parameters(
            model, pose=relaxed_pose(), translation=middle_of_view(views.cameras)
        )
    else:
        start = _checked(model, estimate)
    strengths = strengths_of(model, options)
    tell("coarse", 0, 1, None)
    coarse, coarse_fit = fit_coarse(
        mapping, views, start, estimate, strengths, options.coarse,
        iterations=options.landmark_iterations,
    )  # fmt: skip
    tell("coarse", 1, 1, coarse_fit.loss)
    tell("landmarks", 0, 1, coarse_fit.loss)
    # One view does not tell a leg bent forward from one bent back, and knees bend one way only.
    several = estimate is None and views.count == 1 and options.free.pose
    begins = (coarse, _knees_bent(coarse)) if several else (coarse,)
    fits = [
        fit_landmarks(
            mapping, views, begin, estimate, strengths, options.free,
            iterations=options.landmark_iterations,
        )
        for begin in begins
    ]  # fmt: skip
    placed, landmark_fit = min(fits, key=lambda fit: fit[1].loss)
    tell("landmarks", 1, 1, landmark_fit.loss)
    _require_finite(placed, "the landmark stage")
    found, colors, history, ends, kept = placed, None, [], (None, None), False
    if views.mask is not None and options.fine_iterations:
        problem = fine.make_problem(model, mapping, views, estimate, strengths, options)
        state = fine.init(problem, placed)
        colors, first = np.asarray(state.colors), fine.evaluate(problem, state)
        while not fine.finished(problem, state):
            state, terms = fine.step(problem, state)
            history.append(terms)
            tell("fine", len(history), options.fine_iterations, terms.total)
        _require_finite(state.parameters, "the fine stage")
        ends = (first, fine.evaluate(problem, state))
        kept = ends[1].total <= first.total
        if kept:
            found, colors = state.parameters, np.asarray(state.colors)
    return Reconstruction(
        parameters=found,
        colors=colors,
        coarse=coarse,
        by_landmarks=placed,
        coarse_fit=coarse_fit,
        landmark_fit=landmark_fit,
        fine_terms=tuple(history),
        fine_start=ends[0],
        fine_end=ends[1],
        fine_kept=kept,
        landmark_error=_landmark_error(mapping, views, found),
    )


def _knees_bent(start: BodyParameters) -> BodyParameters:
    """The same body with its thighs a little forward and its shins back."""
    pose = start.pose
    for side in ("left", "right"):
        pose = pose.at[joint_index(f"{side}_hip"), 0].add(-_THIGHS_FORWARD)
        pose = pose.at[joint_index(f"{side}_knee"), 0].add(_SHINS_BACK)
    return replace(start, pose=pose)


def _checked(model: BodyModel, estimate: BodyParameters) -> BodyParameters:
    return make_parameters(
        model,
        pose=np.asarray(estimate.pose),
        shape=np.asarray(estimate.shape),
        scale=estimate.scale,
        translation=np.asarray(estimate.translation),
    )


def strengths_of(model: BodyModel, options: ReconstructionOptions) -> Strengths:
    """The weights of some options, in the precision of the model."""
    real = model.template.dtype
    weights = dataclasses.asdict(options.weights)
    return Strengths(**{name: jnp.asarray(value, real) for name, value in weights.items()})


def _landmark_error(mapping: LandmarkMap, views: BodyViews, parameters: BodyParameters) -> float:
    weight = np.asarray(views.confidence) * np.asarray(mapping.trust)[None, :]
    mean = float(landmark_loss(mapping, views, parameters)) * weight.size / np.sum(weight**2)
    return views.cameras.height * float(np.sqrt(mean))


def _require_finite(parameters: BodyParameters, where: str) -> None:
    leaves = (parameters.log_scale, parameters.translation, parameters.pose, parameters.shape)
    if not all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in leaves):
        raise InputError(
            "the body is not finite any more", where=where, mend="check cameras and landmarks"
        )


def _silent(stage: str, done: int, total: int, loss: float | None) -> None:
    del stage, done, total, loss
