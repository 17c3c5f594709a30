"""One Adam per group of unknowns, with learning rates that follow the stages of a fit (S9.12).

Corners move in two ways at once: each on its own, and together with their panel, whose width and
length are stretched about its middle. Images tell much about the sizes of a panel and little about
single corners, most of which lie in folds, on seams or behind an arm. Corners alone would have to
cover the whole way one by one, and those that hardly show would wander meanwhile. The two ends of a
short edge move together (`corner_links`): otherwise a few steps would fold the edge over.
"""

import math
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Int

from dress_jax.optimisation.options import FitOptions
from dress_jax.optimisation.state import GROUPS, Unknowns, from_groups, groups

# Gradients of far apart groups differ by orders of magnitude, and rates are absolute step lengths:
# only an exact zero may fall below this.
_EPSILON = 1e-12

_LINK_LENGTH = 0.015  # edges shorter than this keep their ends together [m]

PANELS = "panels"
"""Name of the panel stretches among the rates and states; every corner holds its panel's."""

_SHARED = (PANELS, "vertices", "controls")
"""Groups whose entries are of one kind, so that their gradients compare."""


def _adam(momentum: float | Array, memory: float | Array) -> optax.GradientTransformation:
    return optax.scale_by_adam(b1=momentum, b2=memory, eps=_EPSILON)


def init_optimizer(unknowns: Unknowns, options: FitOptions) -> dict[str, optax.OptState]:
    """Fresh moments for every group, and for the panel stretches."""
    transform = _adam(options.momentum, options.memory)
    arrays = {**groups(unknowns), PANELS: jnp.zeros_like(unknowns.pattern.vertices)}
    return {name: transform.init(array) for name, array in arrays.items()}


def rates(options: FitOptions, iteration: int, scale: float) -> dict[str, float]:
    """The learning rate of every group in one iteration.

    Half a cosine from the initial rate to `final_rate` of it; zero for control points in stage one.
    """
    part = min(iteration / max(options.iterations, 1), 1.0)
    decay = options.final_rate + (1.0 - options.final_rate) * 0.5 * (1.0 + math.cos(math.pi * part))
    result = {name: getattr(options.rates, name) * decay * scale for name in (PANELS, *GROUPS)}
    if iteration < options.stage_one:
        result["controls"] = 0.0
    return result


def propose(
    unknowns: Unknowns,
    gradient: Unknowns,
    optimizer: dict[str, optax.OptState],
    options: FitOptions,
    step_rates: dict[str, float],
    corner_panel: Int[np.ndarray, " V"],
    links: Float[np.ndarray, "V V"],
) -> tuple[Unknowns, dict[str, optax.OptState]]:
    """The next unknowns to try.

    A group whose rate is zero keeps its values and its moments, so that a group that is freed
    later starts as a fresh one would.

    Args:
        unknowns: accepted values.
        gradient: of the loss there.
        optimizer: state of every group.
        options: decays and clipping.
        step_rates: learning rate of every group.
        corner_panel: panel of every pattern corner, (V,).
        links: from `corner_links`.
    """
    values, slopes = groups(unknowns), groups(gradient)
    arms = _arms(values["vertices"], corner_panel)
    values[PANELS] = jnp.zeros_like(arms)
    slopes[PANELS] = _panel_sums(slopes["vertices"] * arms, corner_panel)
    moved, states = {}, {}
    for name in (PANELS, *GROUPS):
        moved[name], states[name] = values[name], optimizer[name]
        if step_rates[name] > 0.0:
            moved[name], states[name] = _update(
                values[name],
                slopes[name],
                optimizer[name],
                jnp.asarray(step_rates[name]),
                jnp.asarray(options.momentum),
                jnp.asarray(options.memory),
                jnp.asarray(options.clip),
                jnp.asarray(options.sharing if name in _SHARED else 0.0),
            )
    free = moved["vertices"] - values["vertices"]
    alone = jnp.sum(jnp.asarray(links)[:, :, None] * free[None], axis=1)
    moved["vertices"] = values["vertices"] + alone + moved.pop(PANELS) * arms
    # Colours are projected onto what a picture can show.
    moved["colors"] = jnp.clip(moved["colors"], 0.0, 1.0)
    return from_groups(moved), states


def corner_links(
    vertices: Float[np.ndarray, "V 2"], edges: Int[np.ndarray, "E 2"]
) -> Float[np.ndarray, "V V"]:
    """Smooths displacements of corners along short edges (host).

    Row by row the d that minimizes sum |d_i - u_i|^2 + sum (s / l_e)^4 |d_i - d_j|^2 for given u,
    with the edge lengths l and s = 15 mm: ends of longer edges are free, those of shorter ones
    tied.

    Args:
        vertices: corners of the pattern [m].
        edges: the two corners of every edge.
    """
    i, j = np.asarray(edges).T
    lengths = np.linalg.norm(vertices[i] - vertices[j], axis=1)
    weights = (_LINK_LENGTH / lengths) ** 4
    matrix = np.eye(len(vertices))
    np.add.at(matrix, (i, i), weights)
    np.add.at(matrix, (j, j), weights)
    np.add.at(matrix, (i, j), -weights)
    np.add.at(matrix, (j, i), -weights)
    return np.linalg.inv(matrix)


def _panel_sums(
    values: Float[Array, "V 2"], corner_panel: Int[np.ndarray, " V"]
) -> Float[Array, "V 2"]:
    """The sum over its panel, at every corner."""
    count = int(corner_panel.max()) + 1
    return jax.ops.segment_sum(values, corner_panel, num_segments=count)[corner_panel]


def _arms(
    vertices: Float[Array, "V 2"], corner_panel: Int[np.ndarray, " V"]
) -> Float[Array, "V 2"]:
    """From the middle of its panel's corners to every corner [m]."""
    total = _panel_sums(vertices, corner_panel)
    return vertices - total / _panel_sums(jnp.ones_like(vertices), corner_panel)


@jax.jit
def _update(
    value: Array,
    slope: Array,
    state: optax.ScaleByAdamState,
    rate: Float[Array, ""],
    momentum: Float[Array, ""],
    memory: Float[Array, ""],
    clip: Float[Array, ""],
    sharing: Float[Array, ""],
) -> tuple[Array, optax.OptState]:
    """One Adam step of a group, its gradient shortened to `clip` times its usual length.

    A single wild gradient (a fold that is about to snap) would otherwise fill the second moment
    and stall the group for as long as the moment remembers.

    Adam moves every number by about the rate, however little the loss depends on it: corners that
    hardly show would wander at the speed of the hem. So the step of an entry with second moment v
    is scaled by (v / max v)^(sharing / 2): 0 is Adam, 1 keeps the direction of the gradient, and
    the fastest entry moves by about the rate in either case.
    """
    count = jnp.asarray(state.count)
    corrected = 1.0 - memory ** jnp.maximum(count, 1)
    usual = jnp.sqrt(jnp.sum(cast(Array, state.nu)) / corrected)
    length = jnp.sqrt(jnp.sum(slope**2))
    limit = jnp.where(count > 0, clip * usual, jnp.inf)
    over = (length > limit) & (limit > 0.0)
    slope = jnp.where(over, limit / jnp.where(over, length, 1.0), 1.0) * slope
    direction, following = _adam(momentum, memory).update(slope, state)  # type: ignore[arg-type]
    second = cast(Array, following.nu)  # type: ignore[union-attr]
    largest = jnp.max(second)
    relative = jnp.where(largest > 0.0, second / jnp.where(largest > 0.0, largest, 1.0), 1.0)
    return value - rate * relative ** (0.5 * sharing) * cast(Array, direction), following
