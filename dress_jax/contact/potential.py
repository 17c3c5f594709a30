"""The contact potential: barrier over pairs, weighted by area (S1.9, S1.13).

Every pair contributes k w m dhat b(d): k is a pressure [Pa], w an area of the rest shape, so the
potential of two facing sheets does not depend on the mesh while edges are long against dhat, and
carries a derivative through the areas (S9.7). Cloth and
body share one vertex numbering: cloth first, then body.

A pair may have lengths of its own: dhat and thickness times its scale s. In units of s it is a pair
like all others, so its barrier is that of d / s, and its weight is k w m s dhat.
"""

import enum
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from dress_jax.contact.barrier import (
    BarrierDerivatives,
    ContactSettings,
    barrier,
    barrier_derivatives,
)
from dress_jax.contact.candidates import gather, mask
from dress_jax.core.pytree import pytree, static
from dress_jax.geometry.distance import (
    edge_edge_closest,
    edge_edge_squared,
    vertex_face_closest,
    vertex_face_squared,
)

# Pairs of stencil vertices (p, q), p <= q, in the order of the blocks.
CONTACT_PAIRS = tuple((p, q) for p in range(4) for q in range(p, 4))
# Squared sine below which two edges count as nearly parallel. C-IPC's mollifier compares
# |ea x eb|^2 with 1e-3 |ea|^2 |eb|^2 of the rest lengths; taken with the current lengths it is an
# angle, and no rest length of body edges is needed.
_PARALLEL_SINE_SQUARED = 1e-3


class PairKind(enum.Enum):
    """The two families of primitive pairs."""

    VERTEX_FACE = "vertex-face"
    EDGE_EDGE = "edge-edge"


@pytree
class Pairs:
    """One family of pairs, padded.

    Attributes:
        indices: stencil vertices, (4, m).
        count: number of true pairs, ().
        scales: factors of dhat and thickness of each pair, in (0, 1]; constants, (m,).
        kind: the family.
    """

    indices: Int[Array, "4 m"]
    count: Int[Array, ""]
    scales: Float[Array, " m"]
    kind: PairKind = static()


@pytree
class Contact:
    """One family of pairs, and what the barrier between them is made of.

    Attributes:
        pairs: the pairs.
        areas: vertex areas of cloth and body [m^2], (n,).
        barrier_stiffness: contact pressure scale [Pa], ().
        settings: lengths of the contact model.
    """

    pairs: Pairs
    areas: Float[Array, " n"]
    barrier_stiffness: Float[Array, ""]
    settings: ContactSettings


def stencils(
    positions: Float[Array, "n 3"], pairs: Pairs
) -> tuple[Float[Array, "4 3 m"], Bool[Array, " m"]]:
    """Stencils of the pairs [m], and which of them are true pairs."""
    indices, count = pairs.indices, pairs.count
    return gather(positions, indices, count), mask(indices, count)


def mollifier(points: Float[Array, "4 3 m"]) -> Float[Array, " m"]:
    """Fades an edge-edge pair out as its edges become parallel, where its distance has a kink."""
    first = [points[1, k] - points[0, k] for k in range(3)]
    second = [points[3, k] - points[2, k] for k in range(3)]
    normal = [
        first[1] * second[2] - first[2] * second[1],
        first[2] * second[0] - first[0] * second[2],
        first[0] * second[1] - first[1] * second[0],
    ]
    cross = normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2
    lengths = (first[0] ** 2 + first[1] ** 2 + first[2] ** 2) * (
        second[0] ** 2 + second[1] ** 2 + second[2] ** 2
    )
    ratio = cross / (_PARALLEL_SINE_SQUARED * lengths)
    return jnp.where(ratio < 1.0, (2.0 - ratio) * ratio, 1.0)


def squared_distances(points: Float[Array, "4 3 m"], kind: PairKind) -> Float[Array, " m"]:
    """Squared distances of the pairs [m^2]."""
    if kind is PairKind.VERTEX_FACE:
        return vertex_face_squared(points)
    return edge_edge_squared(points)


def closest(points: Float[Array, "4 3 m"], kind: PairKind) -> tuple[Array, Array]:
    """Weights (4, m) of the vertices in the shortest connection, and its squared length [m^2]."""
    if kind is PairKind.VERTEX_FACE:
        return vertex_face_closest(points)
    return edge_edge_closest(points)


def pair_areas(areas: Float[Array, " n"], pairs: Pairs) -> Float[Array, " m"]:
    """The area that each pair stands for [m^2]: of its vertex, or the mean over its two edges.

    Two facing sheets are seen from both sides and by both families, hence the factors.
    """
    indices = pairs.indices
    if pairs.kind is PairKind.VERTEX_FACE:
        return 0.5 * areas[indices[0]]
    return 0.125 * (areas[indices[0]] + areas[indices[1]] + areas[indices[2]] + areas[indices[3]])


def energy_scales(points: Float[Array, "4 3 m"], contact: Contact) -> Float[Array, " m"]:
    """k w m s dhat, by which the barrier of each pair is multiplied [J]."""
    pairs, settings = contact.pairs, contact.settings
    dhat = settings.dhat * pairs.scales
    scale = contact.barrier_stiffness * dhat * pair_areas(contact.areas, pairs)
    return scale * mollifier(points) if pairs.kind is PairKind.EDGE_EDGE else scale


def pair_barrier(squared: Float[Array, " m"], contact: Contact) -> BarrierDerivatives:
    """The barrier of each pair, with its derivatives in the squared distance [m^2]."""
    unit = contact.pairs.scales**2
    value, first, second = barrier_derivatives(squared / unit, contact.settings)
    return BarrierDerivatives(value, first / unit, second / unit**2)


def contact_energy(positions: Float[Array, "n 3"], contact: Contact) -> Float[Array, ""]:
    """Energy of one family of pairs [J]; pairs beyond dhat contribute zero.

    Args:
        positions: cloth and body vertices [m].
        contact: the pairs.
    """
    return stencil_energy(*stencils(positions, contact.pairs), contact)


def stencil_energy(
    points: Float[Array, "4 3 m"], used: Bool[Array, " m"], contact: Contact
) -> Float[Array, ""]:
    """The same, as a function of the stencils [J].

    Args:
        points, used: from `stencils`.
        contact: the pairs.
    """
    pairs, settings = contact.pairs, contact.settings
    squared = squared_distances(points, pairs.kind)
    value = barrier(squared / pairs.scales**2, settings)
    if pairs.kind is PairKind.EDGE_EDGE:
        value = mollifier(points) * value
    weights = jnp.where(used, pairs.scales * pair_areas(contact.areas, pairs), 0.0)
    total = jnp.sum(jnp.where(used, weights * value, 0.0))
    return contact.barrier_stiffness * settings.dhat * total


class PairBlocks(NamedTuple):
    """Hessian of the pairs: block (p, q) is stiffness w_p w_q times a projection.

    The barrier's projection is n n^T, along the normal; that of friction is I - n n^T, across it.
    """

    weights: Float[Array, "4 m"]
    normal: tuple[Array, ...]
    stiffness: Float[Array, " m"]


def contact_blocks(positions: Float[Array, "n 3"], contact: Contact) -> PairBlocks:
    """The positive-semidefinite part that Newton uses: second derivative along the distance.

    The other part of the Hessian is the repulsive force times the curvature of the distance. It is
    negative semidefinite between two vertices and indefinite otherwise; leaving it out keeps the
    blocks positive semidefinite without an eigendecomposition, and the exact Hessian of the last
    iterations makes up for it.
    """
    pairs = contact.pairs
    points, used = stencils(positions, pairs)
    weights, squared = closest(points, pairs.kind)
    derivatives = pair_barrier(squared, contact)
    along = 2.0 * derivatives.first + 4.0 * squared * derivatives.second
    scale = energy_scales(points, contact)
    stiffness = jnp.where(used, scale * jnp.maximum(along, 0.0), 0.0)
    length = jnp.sqrt(jnp.where(used, squared, 1.0))
    normal = tuple(
        sum(weights[p] * points[p, k] for p in range(1, 4)) / length
        + weights[0] * points[0, k] / length
        for k in range(3)
    )
    return PairBlocks(weights, normal, stiffness)


class ActivePairs(NamedTuple):
    """What is known about the distances of one family of pairs.

    Attributes:
        mask: which pairs are closer than their dhat, (m,).
        smallest: squared distance of the closest pair [m^2].
        smallest_scaled: likewise, every distance over the scale of its pair [m^2].
    """

    mask: Bool[Array, " m"]
    smallest: Float[Array, ""]
    smallest_scaled: Float[Array, ""]


def active_pairs(
    positions: Float[Array, "n 3"], pairs: Pairs, settings: ContactSettings
) -> ActivePairs:
    """Which pairs are closer than dhat, and how close the closest are."""
    points, used = stencils(positions, pairs)
    squared = jnp.where(used, squared_distances(points, pairs.kind), jnp.inf)
    scaled = squared / pairs.scales**2
    return ActivePairs(
        scaled < (settings.dhat + settings.thickness) ** 2,
        jnp.min(squared, initial=jnp.inf),
        jnp.min(scaled, initial=jnp.inf),
    )
