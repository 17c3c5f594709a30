"""Differences between a drape and what was observed of it, linear in its positions. Host, numpy.

Outlines, normals, scans and landmarks all come as this: what they cost, what they say about the
unknowns once the sensitivities of the drape are known, and how they pull at positions.
"""

import dataclasses
import enum
import functools
from collections.abc import Callable

import numpy as np
import scipy.sparse
from jaxtyping import Float

from dress_jax.optimisation.gauss_newton.guidance import Pull
from dress_jax.optimisation.gauss_newton.normal_equations import huber
from dress_jax.optimisation.gauss_newton.quadratic_model import Model


class Observed(enum.Enum):
    """What differences are about."""

    OUTLINES = "outlines"
    NORMALS = "normals"
    SCAN = "scan"
    LANDMARKS = "landmarks"


@dataclasses.dataclass(frozen=True, eq=False)
class Residuals:
    """Differences of one kind, each of d components.

    Attributes:
        kind: what they are about.
        value: the differences, (q, d).
        weight: share of each in the mean, (q,).
        jacobian: makes their derivatives in the flattened positions, (q d, 3 n).
        scale: a difference of this length costs 1/2.
        limit: length beyond which a difference pulls with constant strength (Huber).
    """

    kind: Observed
    value: Float[np.ndarray, "q d"]
    weight: Float[np.ndarray, " q"]
    jacobian: Callable[[], scipy.sparse.csr_array]
    scale: float
    limit: float

    @functools.cached_property
    def _huber(self) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, " q"]]:
        return huber(np.linalg.norm(self.value, axis=1), self.limit)

    @functools.cached_property
    def _strength(self) -> Float[np.ndarray, " qd"]:
        """The factor on the square of every component."""
        strength = self.weight * self._huber[1] / self.scale**2
        return np.repeat(strength, self.value.shape[1])

    @property
    def cost(self) -> float:
        """The mean of Huber's function of the lengths, in units of the scale."""
        return float(np.sum(self.weight * self._huber[0])) / self.scale**2

    def model(self, sensitivity: Float[np.ndarray, "n3 k"]) -> Model:
        """The model of the cost.

        Args:
            sensitivity: derivatives of the flattened positions in the unknowns.
        """
        used = self._strength > 0.0
        root = np.sqrt(self._strength[used])
        rows = root[:, None] * (self.jacobian()[used] @ sensitivity)
        return Model(rows.T @ (root * self.value.ravel()[used]), rows.T @ rows)

    def pull(self) -> Pull:
        """What they ask of the positions themselves."""
        used = self._strength > 0.0
        return Pull(self.value.ravel()[used], self.jacobian()[used], self._strength[used])


def length_residuals(
    kind: Observed,
    residual: Float[np.ndarray, " r"],
    jacobian: scipy.sparse.csr_array,
    weight: Float[np.ndarray, " r"],
    *,
    scale: float,
    limit: float,
) -> Residuals:
    """Residuals of one component whose derivatives are at hand."""
    return Residuals(kind, residual[:, None], weight, lambda: jacobian, scale, limit)
