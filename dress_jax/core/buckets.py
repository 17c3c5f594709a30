"""Shape buckets: padded sizes are rounded up to few values, so that few programs are compiled."""

import numpy as np


def bucket_size(count: int, *, smallest: int = 256, growth: float = 2) -> int:
    """The smallest allowed capacity that holds `count` entries.

    Capacities grow from `smallest` by a factor: padded lanes cost little next to a compilation, and
    a garment meets only a handful of sizes.
    """
    size = smallest
    while size < count:
        size = int(np.ceil(size * growth))
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
