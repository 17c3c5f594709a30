"""Random walker segmentation with priors (Grady 2005, "Multilabel random walker")."""

import numpy as np
import scipy.sparse as sparse
import scipy.sparse.linalg as sparse_linalg
from jaxtyping import Bool, Float

_LEAST_WEIGHT = 1e-3


def random_walk(
    colors: Float[np.ndarray, "h w 3"],
    priors: Float[np.ndarray, "h w k"],
    seeds: Bool[np.ndarray, "h w"],
    region: Bool[np.ndarray, "h w"],
    *,
    spread: float,
    strength: float,
    seed_strength: float,
) -> Float[np.ndarray, "h w k"]:
    """Probabilities that follow the priors and change where colours change.

    They solve (L + D) x = D p for every label, L the Laplacian of the grid with weights
    exp(-|dc|^2 / 2 s^2), D the trust in the prior p.

    Args:
        colors: in which neighbours are compared, shape (h, w, 3).
        priors: of each label, summing to 1, shape (h, w, k).
        seeds: where the prior is a seed, shape (h, w).
        region: pixels that take part, shape (h, w).
        spread: s, the difference of colours that a walker crosses easily.
        strength, seed_strength: trust in the prior, elsewhere and at seeds, against a weight of 1.

    Returns:
        Probabilities, zero outside of the region.
    """
    result = np.zeros(priors.shape)
    count = int(region.sum())
    if count == 0:
        return result
    number = np.full(region.shape, -1)
    number[region] = np.arange(count)
    pairs, weights = [], []
    for first, second in (
        (np.s_[:, :-1], np.s_[:, 1:]),
        (np.s_[:-1], np.s_[1:]),
    ):
        both = region[first] & region[second]
        step = np.sum((colors[first] - colors[second]) ** 2, axis=-1)[both]
        weights.append(np.maximum(np.exp(-0.5 * step / spread**2), _LEAST_WEIGHT))
        pairs.append(np.stack([number[first][both], number[second][both]]))
    (rows, columns), weight = np.concatenate(pairs, axis=1), np.concatenate(weights)
    graph = sparse.coo_array((weight, (rows, columns)), shape=(count, count)).tocsr()
    graph = graph + graph.T
    trust = np.where(seeds[region], seed_strength, strength)
    matrix = sparse.diags_array(graph.sum(axis=1) + trust) - graph
    # Symmetric and diagonally dominant: a symmetric ordering fills in least.
    factor = sparse_linalg.splu(
        sparse.csc_matrix(matrix), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}
    )
    result[region] = factor.solve(trust[:, None] * priors[region])
    return np.clip(result, 0.0, 1.0)
