"""Pairs that may come close: padded index arrays, and the gather that makes padding harmless."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from dress_jax.core.buckets import bucket_size, pad_columns
from dress_jax.core.components import Components, split
from dress_jax.core.components import gather as gather_columns
from dress_jax.core.pytree import pytree

# What padded lanes hold: 1 km apart as a vertex-face stencil and 650 m as an edge-edge stencil,
# neither degenerate nor parallel.
_SAFE = 1000.0 * np.array(
    [[0.25, 1.0, 0.25], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], np.float64
)

# Smaller lists would be compiled for without being faster. Few sizes: as a cloth comes to rest, the
# number of candidates runs through all of them.
_SMALLEST_CAPACITY, _GROWTH = 8192, 4


@pytree
class Candidates:
    """Vertex-face and edge-edge pairs, padded to a bucket size.

    Attributes:
        vertex_face: [vertex, face corners] in each column, shape (4, cv).
        edge_edge: [edge a, edge b] in each column, shape (4, ce).
        vertex_face_count: number of columns in use.
        edge_edge_count: number of columns in use.
        vertex_face_scales: factors of the lengths of contact of each pair, shape (cv,).
        edge_edge_scales: likewise, shape (ce,).
    """

    vertex_face: Int[Array, "4 cv"]
    edge_edge: Int[Array, "4 ce"]
    vertex_face_count: Int[Array, ""]
    edge_edge_count: Int[Array, ""]
    vertex_face_scales: Float[Array, " cv"]
    edge_edge_scales: Float[Array, " ce"]


def make_candidates(
    vertex_face: Int[np.ndarray, "m 4"],
    edge_edge: Int[np.ndarray, "k 4"],
    *,
    scales: Float[np.ndarray, " n"] | None = None,
) -> Candidates:
    """Pad the pairs of the broad phase to bucket sizes.

    Args:
        vertex_face: rows [vertex, face corners], shape (m, 4).
        edge_edge: rows [edge a, edge b], shape (k, 4).
        scales: factors of the lengths of contact at each vertex; a pair has the smallest of its
            four. Default: 1.
    """

    def padded(rows: np.ndarray) -> tuple[Array, Array]:
        rows = np.asarray(rows, np.int32).reshape(-1, 4)
        capacity = candidate_capacity(len(rows))
        factors = np.ones(capacity)
        if scales is not None:
            factors[: len(rows)] = pair_scales(scales, rows.T)
        return jnp.asarray(pad_columns(rows.T, capacity)), jnp.asarray(factors)

    (first, first_scales), (second, second_scales) = padded(vertex_face), padded(edge_edge)
    return Candidates(
        vertex_face=first,
        edge_edge=second,
        vertex_face_count=jnp.asarray(len(vertex_face), jnp.int32),
        edge_edge_count=jnp.asarray(len(edge_edge), jnp.int32),
        vertex_face_scales=first_scales,
        edge_edge_scales=second_scales,
    )


def candidate_capacity(count: int) -> int:
    """Length of the padded list of so many pairs."""
    return bucket_size(count, smallest=_SMALLEST_CAPACITY, growth=_GROWTH)


def pair_scales(
    scales: Float[np.ndarray, " n"], indices: Int[np.ndarray, "4 m"]
) -> Float[np.ndarray, " m"]:
    """The factor of each pair: the smallest of its four vertices."""
    return np.minimum.reduce([scales[indices[k]] for k in range(4)])


def mask(indices: Int[Array, "4 c"], count: Int[Array, ""]) -> Bool[Array, "c"]:
    """True for the columns in use."""
    return jnp.arange(indices.shape[1], dtype=jnp.int32) < count


def gather(
    positions: Float[Array, "n 3"], indices: Int[Array, "4 c"], count: Int[Array, ""]
) -> Float[Array, "4 3 c"]:
    """Stencils of the pairs; padded columns hold a fixed configuration with a large distance.

    Args:
        positions: positions [m], shape (n, 3).
        indices: columns of `Candidates`, shape (4, c).
        count: number of columns in use.

    Returns:
        Stencils [m], shape (4, 3, c); padded columns do not depend on `positions`.
    """
    return _stack(gather_components(positions, indices, mask(indices, count)))


def gather_displacements(
    displacement: Float[Array, "n 3"], indices: Int[Array, "4 c"], count: Int[Array, ""]
) -> Float[Array, "4 3 c"]:
    """Like `gather`, for differences of positions [m]: padded columns are zero."""
    used = mask(indices, count)
    return _stack(gather_components(displacement, indices, used, padding=np.zeros((4, 3))))


def gather_components(
    rows: Float[Array, "n 3"],
    indices: Int[Array, "4 c"],
    used: Bool[Array, "c"],
    *,
    padding: Float[np.ndarray, "4 3"] = _SAFE,
) -> tuple[Components, ...]:
    """The stencils as four points of three components each, `padding` where not used."""
    columns = split(rows)
    return tuple(
        tuple(
            jnp.where(used, component, padding[corner, axis])
            for axis, component in enumerate(gather_columns(columns, indices[corner]))
        )
        for corner in range(4)
    )


def _stack(stencils: tuple[Components, ...]) -> Float[Array, "4 3 c"]:
    return jnp.stack([jnp.stack(point) for point in stencils])
