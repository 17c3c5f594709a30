"""The coarse stage by Levenberg-Marquardt and by Adam, from the same starts (S7.3)."""

import time

import jax
import jax.numpy as jnp
import numpy as np
import optax

from dress_jax.body.model import BodyModel
from dress_jax.core.pytree import replace
from dress_jax.reconstruction import (
    BodyParameters,
    BodyViews,
    ReconstructionOptions,
    landmark_map,
)
from dress_jax.reconstruction.landmark_fit import fit_landmarks
from dress_jax.reconstruction.losses import Strengths, landmark_loss
from dress_jax.reconstruction.parameters import free_parameters

RATE = 0.02  # of Adam: the best of 0.005, 0.01, 0.02 and 0.05 on the first body
STEPS = 1000
CLOSE = 1.01  # times the loss of Levenberg-Marquardt


@jax.jit
def _value_and_gradient(parameters, mapping, views):
    return jax.value_and_grad(lambda p: landmark_loss(mapping, views, p))(parameters)


def compare(model: BodyModel, views: BodyViews, start: BodyParameters) -> dict[str, float]:
    """Steps and seconds of both, compiling left out; Adam stops within 1 % of the other's loss."""
    mapping, options = landmark_map(model), ReconstructionOptions()
    seen = replace(views, mask=None, color=None, visible=None)
    weight = jnp.asarray(1.0)
    strengths = Strengths(weight, weight, weight, weight, weight, 0.0 * weight)

    def marquardt():
        return fit_landmarks(mapping, seen, start, None, strengths, options.coarse, iterations=60)

    marquardt()
    began = time.perf_counter()
    found, minimum = marquardt()
    seconds = time.perf_counter() - began
    goal = float(landmark_loss(mapping, seen, found))

    free = free_parameters(options.coarse, model.shapedirs.shape[2])
    adam = optax.adam(RATE)

    @jax.jit
    def move(parameters, gradient, state):
        gradient = jax.tree.map(lambda g, f: g * f, gradient, free)
        update, state = adam.update(gradient, state)
        return optax.apply_updates(parameters, update), state

    parameters, state = start, adam.init(start)
    move(parameters, _value_and_gradient(parameters, mapping, seen)[1], state)
    began, steps, value = time.perf_counter(), 0, np.inf
    while steps < STEPS:
        value, gradient = _value_and_gradient(parameters, mapping, seen)
        if float(value) <= CLOSE * goal:
            break
        parameters, state = move(parameters, gradient, state)
        steps += 1
    return {
        "marquardt_steps": minimum.iterations,
        "marquardt_seconds": seconds,
        "adam_steps": steps,
        "adam_seconds": time.perf_counter() - began,
        "loss": goal,
        "adam_loss": float(value),
    }
