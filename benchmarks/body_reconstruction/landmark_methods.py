"""The stages of landmarks by Levenberg-Marquardt and by Adam, from the same starts (S7.3)."""

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
    Free,
    ReconstructionOptions,
    landmark_map,
)
from dress_jax.reconstruction.landmark_fit import fit_landmarks
from dress_jax.reconstruction.losses import landmark_loss, regularizer_residuals
from dress_jax.reconstruction.parameters import free_parameters
from dress_jax.reconstruction.reconstruct import strengths_of

RATES = {"coarse": (0.02, 0.05, 0.1), "landmarks": (0.005, 0.01, 0.02)}
"""Step lengths of Adam that are tried; the fastest counts."""

STEPS = 2000
CLOSE = 1.01  # times the loss of Levenberg-Marquardt


@jax.jit
def _value_and_gradient(parameters, mapping, views, estimate, strengths):
    def loss(parameters):
        rest = jnp.sum(regularizer_residuals(parameters, estimate, strengths) ** 2)
        return strengths.landmark * landmark_loss(mapping, views, parameters) + rest

    return jax.value_and_grad(loss)(parameters)


def compare(
    model: BodyModel, views: BodyViews, estimate: BodyParameters
) -> dict[str, dict[str, float]]:
    """Steps and seconds of both in each stage, compiling left out.

    Adam ends within 1 % of the loss of Levenberg-Marquardt, or after `STEPS`.
    """
    mapping, options = landmark_map(model), ReconstructionOptions()
    seen = replace(views, mask=None, color=None, visible=None)
    strengths = strengths_of(model, options)
    result, start = {}, estimate
    for stage, free in (("coarse", options.coarse), ("landmarks", options.free)):

        def marquardt(start=start, free=free):
            return fit_landmarks(
                mapping, seen, start, estimate, strengths, free,
                iterations=options.landmark_iterations,
            )  # fmt: skip

        marquardt()
        began = time.perf_counter()
        found, minimum = marquardt()
        seconds = time.perf_counter() - began
        data = (mapping, seen, estimate, strengths)
        adam = min(
            (_adam(model, start, free, data, rate, CLOSE * minimum.loss) for rate in RATES[stage]),
            key=lambda run: (run["adam_loss"] > CLOSE * minimum.loss, run["adam_steps"]),
        )
        result[stage] = {
            "marquardt_steps": minimum.iterations,
            "marquardt_seconds": seconds,
            "loss": minimum.loss,
            **adam,
        }
        start = found
    return result


def _adam(
    model: BodyModel, start: BodyParameters, free: Free, data: tuple, rate: float, goal: float
) -> dict[str, float]:
    mask = free_parameters(free, model.shapedirs.shape[2])
    transform = optax.adam(rate)

    @jax.jit
    def move(parameters, gradient, state):
        gradient = jax.tree.map(lambda g, f: g * f, gradient, mask)
        update, state = transform.update(gradient, state)
        return optax.apply_updates(parameters, update), state

    parameters, state = start, transform.init(start)  # type: ignore[arg-type]
    move(parameters, _value_and_gradient(parameters, *data)[1], state)
    began, steps, value, least = time.perf_counter(), 0, np.inf, np.inf
    while steps < STEPS:
        value, gradient = _value_and_gradient(parameters, *data)
        least = min(least, float(value))
        if least <= goal:
            break
        parameters, state = move(parameters, gradient, state)
        steps += 1
    return {
        "adam_rate": rate,
        "adam_steps": steps,
        "adam_seconds": time.perf_counter() - began,
        "adam_loss": least,
    }
