"""Semi-implicit Coulomb friction (S1.16): normal forces and contact frames of the step's start.

Because they are functions of the start positions, not stored numbers, the derivative of a dynamic
step through its initial state contains them.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from dress_jax.contact.candidates import gather_displacements
from dress_jax.contact.potential import (
    Contact,
    PairBlocks,
    closest,
    energy_scales,
    pair_barrier,
    stencils,
)
from dress_jax.core.components import dot
from dress_jax.core.pytree import pytree


@pytree
class Friction:
    """Pairs in contact at the start of a step, and what holds them back from sliding.

    Attributes:
        contact: the pairs.
        start: cloth and body vertices at the start of the step [m], (n, 3).
        coefficient: Coulomb's mu, ().
        slip_length: slip speed times h [m]: below it friction grows smoothly from zero, ().
    """

    contact: Contact
    start: Float[Array, "n 3"]
    coefficient: Float[Array, ""]
    slip_length: Float[Array, ""]


def _lagged(friction: Friction) -> tuple[Array, tuple[Array, ...], Array]:
    """Weights, unit normals and normal forces [N] of the pairs at the start of the step."""
    contact, pairs = friction.contact, friction.contact.pairs
    points, used = stencils(friction.start, pairs)
    weights, squared = closest(points, pairs.kind)
    length = jnp.sqrt(jnp.where(used, squared, 1.0))
    normal = tuple(sum(weights[p] * points[p, k] for p in range(4)) / length for k in range(3))
    scale = energy_scales(points, contact)
    force = -2.0 * length * scale * pair_barrier(squared, contact).first
    return weights, normal, jnp.where(used, force, 0.0)


def _squared_slip(
    positions: Float[Array, "n 3"], friction: Friction, weights: Array, normal: tuple[Array, ...]
) -> Float[Array, " m"]:
    """Squared length of the tangential part of the relative displacement [m^2]."""
    pairs = friction.contact.pairs
    moved = gather_displacements(positions - friction.start, pairs.indices, pairs.count)
    relative = tuple(sum(weights[p] * moved[p, k] for p in range(4)) for k in range(3))
    along = sum(relative[k] * normal[k] for k in range(3))
    tangential = tuple(relative[k] - along * normal[k] for k in range(3))
    return dot(tangential, tangential)


def friction_energy(positions: Float[Array, "n 3"], friction: Friction) -> Float[Array, ""]:
    """mu N f0(|u_T|) over the pairs in contact at the start of the step [J].

    Args:
        positions: cloth and body vertices at the end of the step [m].
        friction: the pairs.
    """
    weights, normal, force = _lagged(friction)
    squared = _squared_slip(positions, friction, weights, normal)
    slip_length = friction.slip_length
    sliding = squared >= slip_length**2
    positive = squared > 0.0
    length = jnp.sqrt(jnp.where(positive, squared, 1.0))
    cubic = jnp.where(positive, squared * length, 0.0)
    sticking = squared / slip_length - cubic / (3.0 * slip_length**2) + slip_length / 3.0
    value = jnp.where(sliding, length, sticking)
    return friction.coefficient * jnp.sum(force * value)


def friction_blocks(positions: Float[Array, "n 3"], friction: Friction) -> PairBlocks:
    """Blocks s w_p w_q (I - n n^T) with s = mu N f0'(u)/u, a positive-semidefinite majorizer."""
    weights, normal, force = _lagged(friction)
    squared = _squared_slip(positions, friction, weights, normal)
    slip_length = friction.slip_length
    length = jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0))
    sticking = 2.0 / slip_length - jnp.where(squared > 0.0, length, 0.0) / slip_length**2
    slope = jnp.where(squared >= slip_length**2, 1.0 / length, sticking)
    return PairBlocks(weights, normal, friction.coefficient * force * slope)
