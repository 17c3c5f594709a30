"""Semi-implicit Coulomb friction (S1.16): normal forces and contact frames of the step's start.

Because they are functions of the start positions, not stored numbers, the derivative of a dynamic
step through its initial state contains them.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from dress_jax.contact.barrier import ContactSettings, barrier_derivatives
from dress_jax.contact.candidates import gather, gather_displacements, mask
from dress_jax.contact.potential import PairKind, mollifier, pair_areas
from dress_jax.core.components import dot
from dress_jax.geometry.distance import edge_edge_closest, vertex_face_closest


def _lagged(
    start: Float[Array, "n 3"],
    areas: Float[Array, " n"],
    indices: Int[Array, "4 m"],
    count: Int[Array, ""],
    barrier_stiffness: Float[Array, ""],
    settings: ContactSettings,
    kind: PairKind,
) -> tuple[Array, tuple[Array, ...], Array]:
    """Weights, unit normals and normal forces [N] of the pairs at the start of the step."""
    points, used = gather(start, indices, count), mask(indices, count)
    closest = vertex_face_closest if kind is PairKind.VERTEX_FACE else edge_edge_closest
    weights, squared = closest(points)
    length = jnp.sqrt(jnp.where(used, squared, 1.0))
    normal = tuple(sum(weights[p] * points[p, k] for p in range(4)) / length for k in range(3))
    scale = barrier_stiffness * settings.dhat * pair_areas(areas, indices, kind)
    if kind is PairKind.EDGE_EDGE:
        scale = scale * mollifier(points)
    force = -2.0 * length * scale * barrier_derivatives(squared, settings).first
    return weights, normal, jnp.where(used, force, 0.0)


def _slip(
    moved: Float[Array, "4 3 m"], weights: Array, normal: tuple[Array, ...]
) -> tuple[tuple[Array, ...], Array]:
    """Tangential part of the relative displacement, and its squared length."""
    relative = tuple(sum(weights[p] * moved[p, k] for p in range(4)) for k in range(3))
    along = sum(relative[k] * normal[k] for k in range(3))
    tangential = tuple(relative[k] - along * normal[k] for k in range(3))
    return tangential, dot(tangential, tangential)


def friction_energy(
    positions: Float[Array, "n 3"],
    start: Float[Array, "n 3"],
    areas: Float[Array, " n"],
    indices: Int[Array, "4 m"],
    count: Int[Array, ""],
    barrier_stiffness: Float[Array, ""],
    friction_coefficient: Float[Array, ""],
    slip_length: Float[Array, ""],
    settings: ContactSettings,
    *,
    kind: PairKind,
) -> Float[Array, ""]:
    """mu N f0(|u_T|) over the pairs in contact at the start of the step [J].

    Args:
        positions, start: cloth and body vertices at the end and at the start of the step [m].
        slip_length: slip speed times h [m]: below it friction grows smoothly from zero.
    """
    weights, normal, force = _lagged(
        start, areas, indices, count, barrier_stiffness, settings, kind
    )
    moved = gather_displacements(positions - start, indices, count)
    _, squared = _slip(moved, weights, normal)
    sliding = squared >= slip_length**2
    positive = squared > 0.0
    length = jnp.sqrt(jnp.where(positive, squared, 1.0))
    cubic = jnp.where(positive, squared * length, 0.0)
    sticking = squared / slip_length - cubic / (3.0 * slip_length**2) + slip_length / 3.0
    value = jnp.where(sliding, length, sticking)
    return friction_coefficient * jnp.sum(force * value)


def friction_blocks(
    positions: Float[Array, "n 3"],
    start: Float[Array, "n 3"],
    areas: Float[Array, " n"],
    indices: Int[Array, "4 m"],
    count: Int[Array, ""],
    barrier_stiffness: Float[Array, ""],
    friction_coefficient: Float[Array, ""],
    slip_length: Float[Array, ""],
    settings: ContactSettings,
    *,
    kind: PairKind,
) -> tuple[Array, tuple[Array, ...], Array]:
    """Blocks s w_p w_q (I - n n^T) with s = mu N f0'(u)/u, a positive-semidefinite majorizer.

    Returns:
        Weights (4, m), normal components, and s (m,) [N/m].
    """
    weights, normal, force = _lagged(
        start, areas, indices, count, barrier_stiffness, settings, kind
    )
    moved = gather_displacements(positions - start, indices, count)
    _, squared = _slip(moved, weights, normal)
    length = jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0))
    sticking = 2.0 / slip_length - jnp.where(squared > 0.0, length, 0.0) / slip_length**2
    slope = jnp.where(squared >= slip_length**2, 1.0 / length, sticking)
    return weights, normal, friction_coefficient * force * slope
