"""Sparsity of the Hessian: fixed for elasticity, growing with self-contact.

Contact with the body couples only vertices of one triangle, which elasticity couples already, so
only self-contact ever adds a block.
"""

import jax.numpy as jnp
import numpy as np

from dress_jax.energy.bending import HINGE_PAIRS
from dress_jax.energy.cloth import Cloth
from dress_jax.energy.membrane import TRIANGLE_PAIRS
from dress_jax.sim.matrices import ElasticSlots
from dress_jax.solver.block_matrix import (
    BlockPattern,
    block_pattern,
    element_pairs,
    element_slots,
)

STITCH_PAIRS = ((0, 0), (0, 1), (1, 1))
_EXTRA_SHARE = 0.5  # blocks kept for past self-contacts, relative to all others


def _elastic_pairs(cloth: Cloth) -> list[tuple[np.ndarray, np.ndarray]]:
    return [
        element_pairs(np.asarray(cloth.faces), TRIANGLE_PAIRS),
        element_pairs(np.asarray(cloth.hinges), HINGE_PAIRS),
        element_pairs(np.asarray(cloth.stitches), STITCH_PAIRS),
    ]


def _slots(cloth: Cloth, pattern: BlockPattern) -> ElasticSlots:
    # Vertices beyond the pattern's are padding, and as little part of the matrix as the body.
    vertices = np.arange(cloth.vertex_count, dtype=np.int32)
    diagonal, _, _ = pattern.find(vertices, vertices)
    return ElasticSlots(
        triangles=element_slots(pattern, np.asarray(cloth.faces), TRIANGLE_PAIRS),
        hinges=element_slots(pattern, np.asarray(cloth.hinges), HINGE_PAIRS),
        stitches=element_slots(pattern, np.asarray(cloth.stitches), STITCH_PAIRS),
        pins=jnp.asarray(diagonal[np.asarray(cloth.pins)]),
        diagonal=jnp.asarray(diagonal),
    )


def elastic_slots(size: int, cloth: Cloth) -> tuple[BlockPattern, ElasticSlots]:
    """The pattern of elasticity alone, and the slots of its elements.

    Args:
        size: number of vertices that move.
        cloth: with these vertices first; others (padding) get no place in the matrix.
    """
    pattern = block_pattern(size, _elastic_pairs(cloth))
    return pattern, _slots(cloth, pattern)


def extended(
    cloth: Cloth, current: BlockPattern, contacts: list[tuple[np.ndarray, np.ndarray]]
) -> tuple[BlockPattern, ElasticSlots]:
    """A pattern that also holds the given contact pairs.

    Blocks of past contacts are kept while they are few, so that contacts that come and go do not
    change the pattern (and with it the symbolic factorization) at every iteration.
    """
    size = current.size
    needed = block_pattern(size, [*_elastic_pairs(cloth), *contacts])
    past = block_pattern(size, [*_elastic_pairs(cloth), *contacts, (current.rows, current.cols)])
    keep = len(past.rows) <= (1.0 + _EXTRA_SHARE) * len(needed.rows)
    pattern = past if keep else needed
    return pattern, _slots(cloth, pattern)
