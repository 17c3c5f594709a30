"""Some of the pairs of a list, as a list of their own: on the host, or where the list is."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from dress_jax.contact.candidates import mask as used_columns
from dress_jax.contact.potential import Pairs
from dress_jax.core.buckets import bucket_size, pad_columns


def selected(
    pairs: Pairs,
    mask: Bool[Array, " m"] | Bool[np.ndarray, " m"],
    *,
    on_device: bool,
    smallest: int = 4096,
) -> Pairs:
    """The pairs of a mask, padded to a bucket.

    Args:
        pairs: the list.
        mask: of those to be kept, false where the list is padded.
        on_device: select in compiled code: only the number of pairs comes to the host. Where jax
            computes on the processor, NumPy is faster.
        smallest: bucket.
    """
    if on_device:
        mask = jnp.asarray(mask)
        count = jnp.sum(mask, dtype=jnp.int32)
        indices, scales = _compacted(
            pairs.indices, pairs.scales, mask, capacity=bucket_size(int(count), smallest=smallest)
        )
        return Pairs(indices, count, scales, pairs.kind)
    columns = np.nonzero(np.asarray(mask))[0]
    count = len(columns)
    capacity = bucket_size(count, smallest=smallest)
    scales = np.ones(capacity)
    scales[:count] = np.asarray(pairs.scales)[columns]
    return Pairs(
        jnp.asarray(pad_columns(np.asarray(pairs.indices)[:, columns], capacity)),
        jnp.asarray(count, jnp.int32),
        jnp.asarray(scales),
        pairs.kind,
    )


def separated(
    pairs: Pairs, mask: Bool[Array, " m"], *, on_device: bool, smallest: int
) -> tuple[Pairs, Pairs]:
    """The pairs outside of a mask, and those in it.

    Args:
        pairs: the list.
        mask: of any value where the list is padded.
        on_device: see `selected`.
        smallest: bucket of those in the mask.
    """
    inside, outside = _parted(mask, pairs.indices, pairs.count)
    return (
        selected(pairs, outside, on_device=on_device),
        selected(pairs, inside, on_device=on_device, smallest=smallest),
    )


@jax.jit
def _parted(
    mask: Bool[Array, " m"], indices: Int[Array, "4 m"], count: Int[Array, ""]
) -> tuple[Bool[Array, " m"], Bool[Array, " m"]]:
    used = used_columns(indices, count)
    return used & mask, used & ~mask


@functools.partial(jax.jit, static_argnames="capacity")
def _compacted(
    indices: Int[Array, "4 m"],
    scales: Float[Array, " m"],
    mask: Bool[Array, " m"],
    *,
    capacity: int,
) -> tuple[Int[Array, "4 c"], Float[Array, " c"]]:
    """Columns of a mask, in their order; zeros and factors of one behind them."""
    columns = jnp.nonzero(mask, size=capacity, fill_value=len(mask))[0]
    return (
        indices.at[:, columns].get(mode="fill", fill_value=0),
        scales.at[columns].get(mode="fill", fill_value=1.0),
    )
