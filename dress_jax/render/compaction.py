"""Lists of the entries that matter, so that work follows their number and not the image size."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

CHUNK = 1 << 14
"""Entries that a data-dependent loop takes at a time."""


def padded_size(size: int) -> int:
    """`size` rounded up to whole chunks."""
    return -(-size // CHUNK) * CHUNK


def compact(flags: Bool[Array, "p"]) -> tuple[Int[Array, "q"], Int[Array, ""]]:
    """Indices of the set flags in order, and how many there are.

    Returns:
        Indices of shape (padded_size(p),), int32; entries past the count are 0. There is room for
        every flag, so none is ever dropped. And the count, shape ().
    """
    size = flags.shape[0]
    room = padded_size(size)
    rank = jnp.cumsum(flags.astype(jnp.int32))
    slot = jnp.where(flags, rank - 1, room)
    index = jnp.arange(size, dtype=jnp.int32)
    return jnp.zeros(room, jnp.int32).at[slot].set(index, mode="drop"), rank[-1]


def append(
    lists: tuple[Int[Array, "q"], ...],
    count: Int[Array, ""],
    entries: tuple[Int[Array, "k"], ...],
    flags: Bool[Array, "k"],
) -> tuple[tuple[Int[Array, "q"], ...], Int[Array, ""]]:
    """Put the flagged entries behind the first `count` of some lists; the lists have room."""
    rank = jnp.cumsum(flags.astype(jnp.int32))
    slot = jnp.where(flags, count + rank - 1, lists[0].shape[0])
    grown = tuple(
        full.at[slot].set(entry, mode="drop") for full, entry in zip(lists, entries, strict=True)
    )
    return grown, count + rank[-1]
