"""Validated parameters: symmetric where the design is (checklist S4.3 to S4.7).

The optimised parameters stay raw. Everything that is computed from a pattern takes the validated
ones, a fixed linear function of them.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from dress_jax.core.pytree import pytree
from dress_jax.pattern.mirror import Mirror, find_mirror
from dress_jax.pattern.model import EdgeKind, Pattern
from dress_jax.pattern.parameters import EdgeTable, PatternParameters, edge_table

NEARNESS = 1e-6
"""epsilon of S4.3: the share of an asymmetry that is left. The paper gives no value."""


@pytree
class Symmetry:
    """The linear map from raw to validated parameters.

    Args:
        vertices: corners there from corners here, x and y interleaved, shape (2 V, 2 V).
        partner: the row of controls that mirrors each row, shape (K,); itself where none does.
        factor: what the partner's coordinates are multiplied with, shape (K, 2).
        shift: and what is added [chord lengths], shape (K, 2).
    """

    vertices: Float[np.ndarray, "W W"]
    partner: Int[np.ndarray, "K"]
    factor: Float[np.ndarray, "K 2"]
    shift: Float[np.ndarray, "K 2"]


def make_symmetry(
    pattern: Pattern, mirror: Mirror | None = None, *, nearness: float = NEARNESS
) -> Symmetry | None:
    """The validation of a pattern's parameters (host).

    Args:
        pattern: the pattern.
        mirror: what mirrors each other in it; `find_mirror` of the pattern when None.
        nearness: epsilon.

    Returns:
        The map, or None where nothing mirrors anything.
    """
    mirror = find_mirror(pattern) if mirror is None else mirror
    if not mirror.pairs:
        return None
    edges = edge_table(pattern)
    offsets = np.cumsum([0] + [len(panel.edges) for panel in pattern.panels])
    partner = np.arange(edges.controls[-1, 1] + 1)
    factor, shift = np.ones((len(partner), 2)), np.zeros((len(partner), 2))
    size = 2 * int(np.max(edges.vertices) + 1)
    matrix = nearness * np.eye(size)
    for pair in mirror.pairs:
        first = offsets[pair.first] + np.arange(len(pair.edges))
        second = offsets[pair.second] + pair.edges
        for e, f in zip(first.tolist(), second.tolist(), strict=True):
            _add_pair(matrix, edges, e, f, pair.reflection, against=pair.reversed)
            for one, other in ((e, f), (f, e)):
                _link_controls(partner, factor, shift, edges, one, other, against=pair.reversed)
    return Symmetry(
        vertices=nearness * np.linalg.inv(matrix), partner=partner, factor=factor, shift=shift
    )


def validated(parameters: PatternParameters, symmetry: Symmetry | None) -> PatternParameters:
    """The parameters made symmetric, differentiable and linear.

    Corners minimize sum |(P_j - P_i) - R (P_m - P_k)|^2 + epsilon sum |P - P_raw|^2 over the pairs
    of mirrored edges i -> j and k -> m, with R the reflection of their panels (S4.3); controls are
    the means of both edges' coordinates in their chord frames (S4.5).

    Args:
        parameters: raw ones.
        symmetry: from `make_symmetry`; with None the parameters are returned as they are.
    """
    if symmetry is None:
        return parameters
    corners = jnp.asarray(symmetry.vertices) @ parameters.vertices.reshape(-1)
    mirrored = parameters.controls[symmetry.partner] * symmetry.factor + symmetry.shift
    return PatternParameters(
        vertices=corners.reshape(parameters.vertices.shape),
        controls=0.5 * (parameters.controls + mirrored),
    )


def _add_pair(
    matrix: np.ndarray,
    edges: EdgeTable,
    first: int,
    second: int,
    reflection: np.ndarray,
    *,
    against: bool,
) -> None:
    """Add one pair's term to the normal matrix."""
    i, j = edges.vertices[first]
    k, m = edges.vertices[second][:: -1 if against else 1]
    rows = np.zeros((2, len(matrix)))
    for sign, corner, block in (
        (1.0, m, np.eye(2)),
        (-1.0, k, np.eye(2)),
        (-1.0, j, reflection),
        (1.0, i, reflection),
    ):
        rows[:, 2 * corner : 2 * corner + 2] += sign * block
    matrix += rows.T @ rows


def _link_controls(
    partner: np.ndarray,
    factor: np.ndarray,
    shift: np.ndarray,
    edges: EdgeTable,
    edge: int,
    mirrored: int,
    *,
    against: bool,
) -> None:
    """Mirroring turns the chord frame's y around; running against it turns x and y around."""
    (first, last), (other_first, other_last) = edges.controls[edge], edges.controls[mirrored]
    own, other = np.arange(first, last + 1), np.arange(other_first, other_last + 1)
    partner[own] = other[::-1] if against else other
    factor[own] = (-1.0, 1.0) if against else (1.0, -1.0)
    shift[own] = (1.0, 0.0) if against else (0.0, 0.0)
    if edges.kind[edge] == int(EdgeKind.ARC):
        shift[own], factor[own, 0] = (0.0, 0.0), 1.0  # only the height counts
