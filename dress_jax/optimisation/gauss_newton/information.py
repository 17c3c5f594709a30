"""Variances of quantities that are linear in the unknowns, before and after observing. Numpy."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

_NOTHING = 1e-24  # [m^2]; a smaller variance is none


class Knowledge(NamedTuple):
    """What is known about r coordinates of k unknowns.

    Attributes:
        basis: of the coordinates, (r, k).
        before: covariance without observations, (r, r).
        after: covariance with them, (r, r).
    """

    basis: Float[np.ndarray, "r k"]
    before: Float[np.ndarray, "r r"]
    after: Float[np.ndarray, "r r"]


def with_rows(
    precision: Float[np.ndarray, "k k"], rows: Float[np.ndarray, "m k"], deviation: float
) -> Float[np.ndarray, "k k"]:
    """A precision to which some linear quantities, each known with a deviation, are added."""
    return precision + rows.T @ rows / deviation**2


def make_knowledge(
    basis: Float[np.ndarray, "r k"],
    precision: Float[np.ndarray, "k k"],
    information: Float[np.ndarray, "r r"],
) -> Knowledge:
    """Combine what was known with what was observed.

    Args:
        basis: of the coordinates.
        precision: of the unknowns before, positive definite.
        information: of the observations, in the coordinates.
    """
    prior = basis @ precision @ basis.T
    return Knowledge(basis, np.linalg.inv(prior), np.linalg.inv(prior + information))


def deviations(knowledge: Knowledge, rows: Float[np.ndarray, "m k"]) -> Float[np.ndarray, " m"]:
    """Standard deviations of linear quantities."""
    own = rows @ knowledge.basis.T
    return np.sqrt(np.sum(own * (own @ knowledge.after), axis=1))


def told(knowledge: Knowledge, rows: Float[np.ndarray, "m k"]) -> Float[np.ndarray, " m"]:
    """One minus the variance of linear quantities over the one that they had before."""
    own = rows @ knowledge.basis.T
    variance = np.sum(own * (own @ knowledge.after), axis=1)
    return 1.0 - variance / np.sum(own * (own @ knowledge.before), axis=1)


def least_known(
    knowledge: Knowledge, rows: Float[np.ndarray, "m k"], count: int
) -> tuple[Float[np.ndarray, "d m"], Float[np.ndarray, "d k"]]:
    """Combinations of linear quantities with the largest variance, and their likeliest ways.

    Args:
        knowledge: about the unknowns.
        rows: the quantities.
        count: how many combinations at most.

    Returns:
        The combinations, one standard deviation long; and the mean changes of the unknowns along
        them.
    """
    own = rows @ knowledge.basis.T
    spread = own @ knowledge.after @ own.T
    values, vectors = np.linalg.eigh(0.5 * (spread + spread.T))
    chosen = np.argsort(values)[::-1][:count]
    sizes, vectors = np.sqrt(np.maximum(values[chosen], _NOTHING)), vectors[:, chosen]
    ways = (vectors / sizes).T @ own @ knowledge.after @ knowledge.basis
    return (vectors * sizes).T, ways
