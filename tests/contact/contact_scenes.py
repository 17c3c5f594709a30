"""Two rough sheets of order one facing each other, so that finite differences are well scaled."""

import itertools

import jax.numpy as jnp
import numpy as np
from scenes import grid

from dress_jax.contact.barrier import contact_settings
from dress_jax.contact.potential import Contact, PairKind, Pairs
from dress_jax.core.pytree import replace
from dress_jax.geometry.topology import unique_edges

SETTINGS = contact_settings(dhat=0.6, thickness=0.05, slip_speed=1e-3)
STIFFNESS = jnp.asarray(1.3, jnp.float64)
KINDS = list(PairKind)


def all_pairs(faces: np.ndarray, vertex_count: int, kind: PairKind) -> np.ndarray:
    """Every pair of one kind between two sheets of `vertex_count` vertices each, (4, m)."""
    layer = [np.arange(vertex_count), np.arange(vertex_count, 2 * vertex_count)]
    own = [faces[(faces // vertex_count == k).all(1)] for k in (0, 1)]
    if kind is PairKind.VERTEX_FACE:
        rows = [
            np.concatenate([[v], f])
            for k in (0, 1)
            for v, f in itertools.product(layer[k], own[1 - k])
        ]
    else:
        edges = [unique_edges(part) for part in own]
        rows = [np.concatenate(pair) for pair in itertools.product(*edges)]
    return np.array(rows, np.int32).T


def facing_sheets(kind: PairKind, *, gap: float = 0.35, seed: int = 0):
    """Positions (18, 3), and every pair of one kind."""
    rng = np.random.default_rng(seed)
    lower, faces = grid(3, spacing=1.0)
    turn = np.array([[np.cos(0.4), 0, np.sin(0.4)], [0, 1, 0], [-np.sin(0.4), 0, np.cos(0.4)]])
    upper = lower @ turn.T + np.array([0.3, gap, 0.25])
    positions = np.concatenate([lower, upper])
    positions = positions + 0.05 * rng.normal(size=positions.shape)
    areas = rng.uniform(0.5, 1.5, len(positions))
    pairs = all_pairs(np.concatenate([faces, faces + len(lower)]), len(lower), kind)
    return jnp.asarray(positions), contact_of(pairs, areas, kind)


def contact_of(indices: np.ndarray, areas: np.ndarray, kind: PairKind) -> Contact:
    """Pairs without padding, of the stiffness and the lengths above."""
    count = indices.shape[1]
    pairs = Pairs(jnp.asarray(indices), jnp.asarray(count), jnp.ones(count), kind)
    return Contact(pairs, jnp.asarray(areas), STIFFNESS, SETTINGS)


def with_pairs(contact: Contact, **changes) -> Contact:
    """The same contact with other indices or another count."""
    return replace(contact, pairs=replace(contact.pairs, **changes))
