"""The largest safe fraction of a displacement, by additive continuous collision detection (ACCD).

Li, Kaufman, Jiang: "Codimensional Incremental Potential Contact" (2021), section 5. A lane advances
by the time in which its points cannot use up more than 1 - ETA of the gap, measures the gap again,
and stops when it has fallen below ETA of the initial one. Only the earliest hit of all lanes
matters, so a lane that has passed the best hit so far stops as well.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from dress_jax.contact.candidates import Candidates, gather_components, mask
from dress_jax.core.components import Components, add, dot, scale, subtract
from dress_jax.core.precision import require_float64
from dress_jax.geometry.distance import edge_edge_squared, vertex_face_squared

_ETA = 0.1
_ITERATION_LIMIT = 2000
_STILL = np.zeros((4, 3))


def _norms(p: tuple[Components, ...]) -> list[Array]:
    return [jnp.sqrt(dot(point, point)) for point in p]


def _vertex_face_speed(p: tuple[Components, ...]) -> Array:
    """Bound on how fast the distance can shrink: |dp| + max |dt_i|."""
    n = _norms(p)
    return n[0] + jnp.maximum(n[1], jnp.maximum(n[2], n[3]))


def _edge_edge_speed(p: tuple[Components, ...]) -> Array:
    """Bound on how fast the distance can shrink: max |dea_i| + max |deb_i|."""
    n = _norms(p)
    return jnp.maximum(n[0], n[1]) + jnp.maximum(n[2], n[3])


def step_bound(
    start: Float[Array, "n 3"],
    displacement: Float[Array, "n 3"],
    candidates: Candidates,
    *,
    min_distance: float | Float[Array, ""] = 0.0,
    iteration_limit: int = _ITERATION_LIMIT,
) -> Float[Array, ""]:
    """The largest step along `displacement` that is known to keep all candidates apart.

    For every step up to the bound each candidate keeps a distance of more than `min_distance` times
    its scale plus a fraction (at least a hundredth) of its initial gap. Lanes that are not finished
    at the iteration limit bound the step by the time they have proven safe.

    Args:
        start: positions [m], shape (n, 3).
        displacement: displacement of the full step [m], shape (n, 3).
        candidates: all pairs that can touch during the full step.
        min_distance: distance [m] that is kept by a pair whose scale is 1.
        iteration_limit: bound on the advances of one lane.

    Returns:
        A step in (0, 1]; 0 where a moving pair starts at or below `min_distance`, or where a
        position or displacement is not finite.

    Raises:
        RuntimeError: double precision is off.
    """
    require_float64("step_bound")
    families = (
        (
            True,
            candidates.vertex_face,
            candidates.vertex_face_count,
            candidates.vertex_face_scales,
        ),
        (False, candidates.edge_edge, candidates.edge_edge_count, candidates.edge_edge_scales),
    )
    best = jnp.ones((), start.dtype)
    for is_vertex_face, indices, count, scales in families:
        xi = jnp.asarray(min_distance, start.dtype) * scales
        # Two programs: gaps used twice within one would be fused into, and computed by, each use.
        gap, rate = _measure(start, displacement, indices, count, xi, is_vertex_face=is_vertex_face)
        best = _earliest_hit(
            start,
            displacement,
            indices,
            gap,
            rate,
            xi,
            best,
            is_vertex_face=is_vertex_face,
            iteration_limit=iteration_limit,
        )
    return best


@functools.partial(jax.jit, static_argnames="is_vertex_face")
def _measure(
    start: Float[Array, "n 3"],
    displacement: Float[Array, "n 3"],
    indices: Int[Array, "4 c"],
    count: Int[Array, ""],
    xi: Float[Array, "c"],
    *,
    is_vertex_face: bool,
) -> tuple[Float[Array, "c"], Float[Array, "c"]]:
    """Gaps [m], and bounds on how much they shrink in the full step [m]."""
    used = mask(indices, count)
    squared = vertex_face_squared if is_vertex_face else edge_edge_squared
    speed = _vertex_face_speed if is_vertex_face else _edge_edge_speed
    x = gather_components(start, indices, used)
    p = _relative(gather_components(displacement, indices, used, padding=_STILL))
    return jnp.sqrt(squared(x)) - xi, speed(p)


def _relative(p: tuple[Components, ...]) -> tuple[Components, ...]:
    """Displacements without their mean, which changes no distance."""
    mean = scale(0.25, add(add(p[0], p[1]), add(p[2], p[3])))
    return tuple(subtract(point, mean) for point in p)


@functools.partial(jax.jit, static_argnames=("is_vertex_face", "iteration_limit"))
def _earliest_hit(
    start: Float[Array, "n 3"],
    displacement: Float[Array, "n 3"],
    indices: Int[Array, "4 c"],
    gap: Float[Array, "c"],
    rate: Float[Array, "c"],
    xi: Float[Array, "c"],
    best: Float[Array, ""],
    *,
    is_vertex_face: bool,
    iteration_limit: int,
) -> Float[Array, ""]:
    """The smaller of `best` and the earliest hit of all lanes."""
    squared = vertex_face_squared if is_vertex_face else edge_edge_squared
    capacity = max(indices.shape[1] // 16, min(indices.shape[1], 1024))
    moving = ~(rate <= 0.0)
    # Comparisons with NaN are false: such lanes count as hits at time 0.
    sound = (gap > 0.0) & jnp.isfinite(rate)
    best = jnp.where(jnp.any(moving & ~sound), 0.0, best)
    # Times proven safe by the triangle inequality. Few lanes are left where they do not reach to
    # the end of the step, and those are processed in compact chunks.
    proven = jnp.where(moving & sound, (1.0 - _ETA) * gap / jnp.where(moving, rate, 1.0), 1.0)

    def unfinished(state):
        pending, _ = state
        return jnp.any(pending)

    def chunk(state):
        pending, best = state
        lanes = jnp.nonzero(pending, size=capacity, fill_value=pending.shape[0])[0]
        used = lanes < pending.shape[0]
        columns = indices.at[:, lanes].get(mode="fill", fill_value=0)
        x = gather_components(start, columns, used)
        p = _relative(gather_components(displacement, columns, used, padding=_STILL))
        lane_gap = gap.at[lanes].get(mode="fill", fill_value=1.0)
        lane_rate = rate.at[lanes].get(mode="fill", fill_value=0.0)
        lane_xi = xi.at[lanes].get(mode="fill", fill_value=0.0)
        best = _accd(squared, x, p, lane_gap, lane_rate, lane_xi, best, iteration_limit)
        pending = pending.at[lanes].set(False, mode="drop")
        return pending & (proven < best), best

    return lax.while_loop(unfinished, chunk, (proven < best, best))[1]


def _accd(
    squared: Callable[..., Array],
    x: tuple[Components, ...],
    p: tuple[Components, ...],
    gap: Float[Array, "c"],
    rate: Float[Array, "c"],
    xi: Float[Array, "c"],
    best: Float[Array, ""],
    iteration_limit: int,
) -> Float[Array, ""]:
    """The smaller of `best` and the earliest hit of the stencils x moving by p.

    Args:
        gap: gaps at the start [m], positive.
        rate: bound on how much a gap shrinks in the full step [m]; 0 marks unused lanes.
    """
    active = rate > 0.0
    pace = (1.0 - _ETA) / jnp.where(active, rate, 1.0)
    goal = _ETA * gap

    def unfinished(state):
        _, _, _, active, _, iteration = state
        return (iteration < iteration_limit) & jnp.any(active)

    def reached(kept, time):
        # The first advance keeps the goal by the triangle inequality, whatever rounding says.
        return jnp.where(kept > 0.0, kept, time)

    def advance(state):
        # `gap` is that at `time`; `kept` is the last time with at least the goal. The gap cannot be
        # used up at `time`, because it was reached from `kept` by a step too short for that.
        kept, time, gap, active, best, iteration = state
        hit = active & ~(gap >= goal)
        best = jnp.minimum(best, jnp.min(jnp.where(hit, reached(kept, time), 1.0)))
        active = active & ~hit
        kept = jnp.where(active, time, kept)
        following = time + pace * gap
        active = active & (following < best)
        time = jnp.where(active, following, time)
        moved = tuple(add(point, scale(time, motion)) for point, motion in zip(x, p, strict=True))
        return kept, time, jnp.sqrt(squared(moved)) - xi, active, best, iteration + 1

    start = jnp.zeros_like(gap)
    kept, time, _, active, best, _ = lax.while_loop(
        unfinished, advance, (start, start, gap, active, best, 0)
    )
    return jnp.minimum(best, jnp.min(jnp.where(active, reached(kept, time), 1.0)))
