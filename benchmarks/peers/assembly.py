"""Sums of element Hessians into one upper-triangular sparse matrix with a fixed pattern."""

from collections.abc import Sequence

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int


class FixedPattern:
    """Sums the Hessians of elements whose vertices never change."""

    def __init__(self, vertex_count: int, elements: Sequence[Int[np.ndarray, "m k"]]):
        self._size = 3 * vertex_count
        keys, self._picks = [], []
        for vertices in elements:
            dofs = (3 * vertices[:, :, None] + np.arange(3)).reshape(len(vertices), -1)
            first, second = np.triu_indices(dofs.shape[1])
            low = np.minimum(dofs[:, first], dofs[:, second])
            high = np.maximum(dofs[:, first], dofs[:, second])
            keys.append((low.astype(np.int64) * self._size + high).ravel())
            self._picks.append(first * dofs.shape[1] + second)
        diagonal = np.arange(self._size, dtype=np.int64) * (self._size + 1)
        keys.append(diagonal)
        unique, slots = np.unique(np.concatenate(keys), return_inverse=True)
        self._slots = np.split(slots, np.cumsum([len(key) for key in keys])[:-1])
        self._indices = (unique % self._size).astype(np.int32)
        counts = np.bincount(unique // self._size, minlength=self._size)
        self._indptr = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)

    def sum(
        self, hessians: Sequence[Float[np.ndarray, "m d d"]], diagonal: Float[np.ndarray, " s"]
    ) -> scipy.sparse.csr_matrix:
        """The upper triangle of the sum, and of a diagonal matrix."""
        data = np.zeros(len(self._indices))
        for hessian, pick, slots in zip(hessians, self._picks, self._slots, strict=False):
            values = hessian.reshape(len(hessian), -1)[:, pick].ravel()
            data += np.bincount(slots, values, minlength=len(data))
        data[self._slots[-1]] += diagonal
        shape = (self._size, self._size)
        return scipy.sparse.csr_matrix((data, self._indices, self._indptr), shape=shape)


def scatter(
    vertex_count: int, vertices: Int[np.ndarray, "m k"], values: Float[np.ndarray, "m k 3"]
) -> Float[np.ndarray, "n 3"]:
    """Sums of what the elements give to their vertices."""
    index, rows = vertices.ravel(), values.reshape(-1, 3)
    return np.stack(
        [np.bincount(index, rows[:, k], minlength=vertex_count) for k in range(3)], axis=1
    )
