"""Shape buckets: padded sizes are rounded up to few values, so that few programs are compiled."""

import numpy as np


def bucket_size(count: int, *, smallest: int = 256) -> int:
    """The smallest allowed capacity that holds `count` entries.

    Capacities grow by factors of 1.5 and 4/3 in turn (256, 384, 512, 768, ...): at most half of
    a buffer is padding, and a garment meets only a handful of them.
    """
    size = smallest
    while size < count:
        size = size * 3 // 2 if size & (size - 1) == 0 else size * 4 // 3
    return size


def pad_columns(array: np.ndarray, capacity: int) -> np.ndarray:
    """Pad the last axis with zeros up to `capacity`.

    Raises:
        ValueError: the array does not fit; entries are never dropped.
    """
    missing = capacity - array.shape[-1]
    if missing < 0:
        raise ValueError(f"{array.shape[-1]} entries do not fit a capacity of {capacity}")
    return np.pad(array, [(0, 0)] * (array.ndim - 1) + [(0, missing)])
