"""The fine stage: Adam on pictures and landmarks (S7.6-S7.10), `init` and `step` over a state.

Every step looks at the pictures of some views and the landmarks of all. Bodies are posed in the
precision of the model, pictures are drawn in float32.
"""

import dataclasses
import math
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int

from dress_jax.body.model import BodyModel
from dress_jax.core.pytree import pytree
from dress_jax.reconstruction.colors import per_view, seen_colors
from dress_jax.reconstruction.landmarks import LandmarkMap
from dress_jax.reconstruction.losses import (
    PaintedBody,
    Strengths,
    image_terms,
    landmark_loss,
    regularizer_residuals,
)
from dress_jax.reconstruction.options import ReconstructionOptions
from dress_jax.reconstruction.parameters import (
    BodyParameters,
    body_in_world,
    free_parameters,
)
from dress_jax.reconstruction.views import BodyViews
from dress_jax.render.mesh import build_adjacency
from dress_jax.render.views import mean_over_views

# Gradients of the groups differ by orders of magnitude; only an exact zero may fall below this.
_EPSILON = 1e-12


@dataclasses.dataclass(frozen=True)
class FineProblem:
    """What a fine stage works on.

    Attributes:
        model: the body.
        mapping: its landmarks.
        adjacency: twin half-edges of its faces, (f, 3).
        views: with masks.
        estimate: to stay near, or None for the human prior.
        strengths: weights.
        free: one where a parameter may change, zero elsewhere.
        options: rates and numbers of steps.
    """

    model: BodyModel
    mapping: LandmarkMap
    adjacency: Int[Array, "f 3"]
    views: BodyViews
    estimate: BodyParameters | None
    strengths: Strengths
    free: BodyParameters
    options: ReconstructionOptions

    @property
    def batch(self) -> int:
        """Views that one step looks at."""
        asked = self.options.views_per_iteration
        return self.views.count if asked is None else min(asked, self.views.count)


@pytree
class FineState:
    """Between two steps.

    Attributes:
        parameters: of the body.
        colors: RGB of its vertices (C_H), (n, 3).
        optimizer: Adam's moments of both.
        iteration: steps so far, ().
    """

    parameters: BodyParameters
    colors: Float[Array, "n 3"]
    optimizer: optax.OptState
    iteration: Int[Array, ""]


class FineTerms(NamedTuple):
    """A loss and its parts before weighting, of the views looked at."""

    total: float
    rgb: float
    mask: float
    landmark: float
    regularizer: float
    unfinished: int


def make_problem(
    model: BodyModel,
    mapping: LandmarkMap,
    views: BodyViews,
    estimate: BodyParameters | None,
    strengths: Strengths,
    options: ReconstructionOptions,
) -> FineProblem:
    """Gather what a fine stage needs (host)."""
    return FineProblem(
        model=model,
        mapping=mapping,
        adjacency=jnp.asarray(build_adjacency(np.asarray(model.faces))),
        views=views,
        estimate=estimate,
        strengths=strengths,
        free=jax.tree.map(
            lambda leaf: jnp.asarray(leaf, model.template.dtype),
            free_parameters(options.free, model.shapedirs.shape[2]),
        ),
        options=options,
    )


def init(problem: FineProblem, parameters: BodyParameters) -> FineState:
    """The first state; colours are taken from the pictures where the body is."""
    if problem.views.color is None:
        colors = jnp.ones((problem.model.template.shape[0], 3), jnp.float32)
    else:
        colors = seen_colors(_painted(problem, parameters), problem.views)
    return FineState(
        parameters=parameters,
        colors=colors,
        optimizer=_adam().init(cast(Any, (parameters, colors))),
        iteration=jnp.asarray(0),
    )


def step(problem: FineProblem, state: FineState) -> tuple[FineState, FineTerms]:
    """One step of Adam, and the loss before it."""
    iteration = int(state.iteration)
    views = _batch(problem, iteration)
    share = np.ones(len(views))
    terms, gradient = _value_and_gradient(*_arguments(problem, state, views, share))
    parameters, colors, optimizer = _move(
        state.parameters,
        state.colors,
        gradient,
        state.optimizer,
        _rates(problem.options, iteration, state.parameters),
        problem.free,
    )
    following = FineState(parameters, colors, optimizer, jnp.asarray(iteration + 1))
    return following, _plain(terms)


def finished(problem: FineProblem, state: FineState) -> bool:
    """Whether all steps are done."""
    return int(state.iteration) >= problem.options.fine_iterations


def evaluate(problem: FineProblem, state: FineState) -> FineTerms:
    """The loss over all views; runs the program of `step`, a batch at a time."""
    count, batch = problem.views.count, problem.batch
    rgb, mask, unfinished, last = 0.0, 0.0, 0, None
    for start in range(0, count, batch):
        # The last batch is filled up with views of no share.
        views = np.arange(start, start + batch)
        share = np.where(views < count, batch / count, 0.0)
        last = _plain(_value_and_gradient(*_arguments(problem, state, views % count, share))[0])
        rgb, mask, unfinished = rgb + last.rgb, mask + last.mask, unfinished + last.unfinished
    assert last is not None
    weights = problem.options.weights
    total = weights.rgb * rgb + weights.mask * mask + weights.landmark * last.landmark
    return FineTerms(
        total + last.regularizer, rgb, mask, last.landmark, last.regularizer, unfinished
    )


def _batch(problem: FineProblem, iteration: int) -> np.ndarray:
    """Views of a step: each epoch goes through all of them in an order of its own."""
    count, batch = problem.views.count, problem.batch
    first = iteration * batch
    order = [
        np.random.default_rng((problem.options.seed, epoch)).permutation(count)
        for epoch in range(first // count, (first + batch - 1) // count + 1)
    ]
    offset = first - first // count * count
    return np.concatenate(order)[offset : offset + batch]


def _arguments(
    problem: FineProblem, state: FineState, views: np.ndarray, share: np.ndarray
) -> tuple:
    chosen = jnp.asarray(views)
    seen = jax.tree.map(lambda leaf: leaf[chosen], per_view(problem.views))
    return (
        state.parameters,
        state.colors,
        problem.model,
        problem.mapping,
        problem.adjacency,
        dataclasses.replace(problem.views, mask=None, color=None, visible=None),
        (seen, jnp.asarray(share, jnp.float32)),
        problem.estimate,
        problem.strengths,
    )


def _painted(problem: FineProblem, parameters: BodyParameters) -> PaintedBody:
    vertices = body_in_world(problem.model, parameters).vertices
    return PaintedBody(
        positions=vertices,
        colors=jnp.zeros(vertices.shape, jnp.float32),
        faces=problem.model.faces,
        adjacency=problem.adjacency,
    )


def _image_loss(operands, seen):
    """Weighted image losses of one view, times its share of the mean."""
    body, strengths, channels = operands
    view, share = seen
    color, silhouette, unfinished = image_terms(body, view)
    report = jax.lax.stop_gradient(jnp.stack([color, silhouette]))
    # What is reported leaves as the derivative in `channels`, which are zero: derivatives of a mean
    # over views are summed up view by view, and there is no other way out of it.
    reported = jnp.sum(channels[:2] * report) * share + channels[2] * unfinished
    return share * (strengths.rgb * color + strengths.mask * silhouette) + reported


def _loss(unknowns, model, mapping, adjacency, all_views, seen, estimate, strengths):
    parameters, colors, channels = unknowns
    body = PaintedBody(
        positions=body_in_world(model, parameters).vertices.astype(jnp.float32),
        colors=colors,
        faces=model.faces,
        adjacency=adjacency,
    )
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), strengths)
    images = mean_over_views(_image_loss, (body, single, channels), seen)
    landmarks = landmark_loss(mapping, all_views, parameters)
    rest = jnp.sum(regularizer_residuals(parameters, estimate, strengths) ** 2)
    total = images.astype(landmarks.dtype) + strengths.landmark * landmarks + rest
    return total, (landmarks, rest)


@jax.jit
def _value_and_gradient(
    parameters, colors, model, mapping, adjacency, all_views, seen, estimate, strengths
):
    unknowns = (parameters, colors, jnp.zeros(3, jnp.float32))
    (total, (landmarks, rest)), gradient = jax.value_and_grad(_loss, has_aux=True)(
        unknowns, model, mapping, adjacency, all_views, seen, estimate, strengths
    )
    report, count = gradient[2], seen[1].shape[0]
    return (total, report[0], report[1], landmarks, rest, count * report[2]), gradient[:2]


def _plain(terms) -> FineTerms:
    total, rgb, mask, landmark, rest, unfinished = (float(term) for term in terms)
    return FineTerms(total, rgb, mask, landmark, rest, round(unfinished))


def _adam() -> optax.GradientTransformation:
    return optax.scale_by_adam(b1=0.9, b2=0.99, eps=_EPSILON)


def _rates(
    options: ReconstructionOptions, iteration: int, parameters: BodyParameters
) -> tuple[BodyParameters, Float[np.ndarray, ""]]:
    """Step lengths of all numbers; half a cosine from the initial ones to `final_rate` of them."""
    part = min(iteration / max(options.fine_iterations, 1), 1.0)
    fall = options.final_rate + (1.0 - options.final_rate) * 0.5 * (1.0 + math.cos(math.pi * part))
    rates, dtype = options.rates, parameters.pose.dtype
    pose = np.full(parameters.pose.shape, rates.pose * fall)
    pose[0] = rates.rotation * fall
    steps = BodyParameters(
        log_scale=jnp.asarray(rates.log_scale * fall, dtype),
        translation=jnp.full(3, rates.translation * fall, dtype),
        pose=jnp.asarray(pose, dtype),
        shape=jnp.full(parameters.shape.shape, rates.shape * fall, dtype),
    )
    return steps, np.asarray(rates.colors * fall, np.float32)


@jax.jit
def _move(parameters, colors, gradient, optimizer, rates, free):
    slopes = (jax.tree.map(lambda g, f: g * f, gradient[0], free), gradient[1])
    update, following = _adam().update(slopes, optimizer)
    direction = cast(tuple[BodyParameters, Array], update)
    steps, color_rate = rates
    moved = jax.tree.map(lambda p, r, d: p - r * d, parameters, steps, direction[0])
    return moved, jnp.clip(colors - color_rate * direction[1], 0.0, 1.0), following
