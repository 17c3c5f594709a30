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
from jax import lax
from jaxtyping import Array, Float

from dress_jax.contact.candidates import Candidates, gather, gather_displacements
from dress_jax.core.precision import require_float64
from dress_jax.geometry.distance import edge_edge_squared, vertex_face_squared

_ETA = 0.1
_ITERATION_LIMIT = 2000


def _norms(p: Array) -> Array:
    return jnp.sqrt(p[:, 0] * p[:, 0] + p[:, 1] * p[:, 1] + p[:, 2] * p[:, 2])


def _vertex_face_speed(p: Array) -> Array:
    """Bound on how fast the distance can shrink: |dp| + max |dt_i|."""
    n = _norms(p)
    return n[0] + jnp.maximum(n[1], jnp.maximum(n[2], n[3]))


def _edge_edge_speed(p: Array) -> Array:
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

    For every step up to the bound each candidate keeps a distance of more than `min_distance` plus
    a fraction (about a tenth) of its initial gap. Lanes that are not finished at the iteration
    limit bound the step by the time they have proven safe.

    Args:
        start: positions [m], shape (n, 3).
        displacement: displacement of the full step [m], shape (n, 3).
        candidates: all pairs that can touch during the full step.
        min_distance: distance [m] that is kept.
        iteration_limit: bound on the advances of one lane.

    Returns:
        A step in (0, 1]; 0 where a moving pair starts at or below `min_distance`, or where a
        position or displacement is not finite.

    Raises:
        RuntimeError: double precision is off.
    """
    require_float64("step_bound")
    return _step_bound(
        start, displacement, candidates, jnp.asarray(min_distance, start.dtype), iteration_limit
    )


@functools.partial(jax.jit, static_argnames="iteration_limit")
def _step_bound(
    start: Array, displacement: Array, candidates: Candidates, xi: Array, iteration_limit: int
) -> Array:
    best = jnp.ones((), start.dtype)
    for squared, speed, indices, count in (
        (
            vertex_face_squared,
            _vertex_face_speed,
            candidates.vertex_face,
            candidates.vertex_face_count,
        ),
        (edge_edge_squared, _edge_edge_speed, candidates.edge_edge, candidates.edge_edge_count),
    ):
        x = gather(start, indices, count)
        p = gather_displacements(displacement, indices, count)
        best = _accd(squared, speed, x, p, xi, best, iteration_limit)
    return best


def _accd(
    squared: Callable[[Array], Array],
    speed: Callable[[Array], Array],
    x: Float[Array, "4 3 c"],
    p: Float[Array, "4 3 c"],
    xi: Float[Array, ""],
    best: Float[Array, ""],
    iteration_limit: int,
) -> Float[Array, ""]:
    """The smaller of `best` and the earliest hit of the stencils x moving by p."""
    p = p - 0.25 * (p[0] + p[1] + p[2] + p[3])[None]
    rate = speed(p)
    moving = ~(rate <= 0.0)
    gap = jnp.sqrt(squared(x)) - xi
    # Comparisons with NaN are false: such lanes count as hits at time 0.
    sound = (gap > 0.0) & jnp.isfinite(rate)
    best = jnp.where(jnp.any(moving & ~sound), 0.0, best)
    active = moving & sound
    goal = _ETA * gap
    pace = (1.0 - _ETA) / jnp.where(active, rate, 1.0)

    def unfinished(state):
        _, _, active, _, iteration = state
        return (iteration < iteration_limit) & jnp.any(active)

    def advance(state):
        time, gap, active, best, iteration = state
        following = time + pace * gap
        gap = jnp.sqrt(squared(x + following[None, None] * p)) - xi
        # The first advance is safe by the triangle inequality, whatever rounding does to its gap.
        hit = active & ~(gap >= goal) & (time > 0.0)
        best = jnp.minimum(best, jnp.min(jnp.where(hit, time, 1.0), initial=1.0))
        active = active & ~hit & (following < best)
        return jnp.where(active, following, time), gap, active, best, iteration + 1

    time, _, active, best, _ = lax.while_loop(
        unfinished, advance, (jnp.zeros_like(gap), gap, active, best, 0)
    )
    return jnp.minimum(best, jnp.min(jnp.where(active, time, 1.0), initial=1.0))
