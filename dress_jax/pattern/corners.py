"""Corners of panels: the two edges that meet there, and the samples beside them (S11.2, S11.3)."""

import itertools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from dress_jax.core.pytree import pytree
from dress_jax.geometry.curves import end_directions
from dress_jax.geometry.polygons import signed_area
from dress_jax.pattern.discretization import Discretization
from dress_jax.pattern.model import EdgeKind
from dress_jax.pattern.parameters import EdgeTable, PatternParameters, edge_controls


@pytree
class CornerTable:
    """All corners of a pattern, panel by panel in loop order.

    Args:
        edges: the edge that arrives and the one that leaves, shape (C, 2).
        samples: panel vertices before, at and after the corner, shape (C, 3).
        turn: +1 in panels whose loop is counter-clockwise, -1 in the others, shape (C,).
        free: which of the two edges are sewn to nothing, shape (C, 2).
    """

    edges: Int[np.ndarray, "C 2"]
    samples: Int[np.ndarray, "C 3"]
    turn: Float[np.ndarray, "C"]
    free: Bool[np.ndarray, "C 2"]


def corner_table(discretization: Discretization) -> CornerTable:
    """The corners of a discretized pattern (host)."""
    edges, samples, turns = [], [], []
    offsets = np.asarray(discretization.edge_offset)
    starts = np.asarray(discretization.edge_sample_offset)
    along = np.asarray(discretization.edge_samples)
    positions = np.asarray(discretization.meshed_positions)
    for first, stop in itertools.pairwise(offsets.tolist()):
        own = [along[starts[e] : starts[e + 1]] for e in range(first, stop)]
        outline = np.concatenate([points[:-1] for points in own])
        turn = 1.0 if signed_area(positions[outline]) > 0.0 else -1.0
        for leaving in range(first, stop):
            arriving = leaving - 1 if leaving > first else stop - 1
            edges.append((arriving, leaving))
            before, after = own[arriving - first], own[leaving - first]
            samples.append((before[-2], after[0], after[1]))
            turns.append(turn)
    sewn = np.zeros(offsets[-1], dtype=bool)
    sewn[np.asarray(discretization.stitch_edges).ravel()] = True
    edge_pairs = np.array(edges, dtype=np.int32)
    return CornerTable(
        edges=edge_pairs,
        samples=np.array(samples, dtype=np.int32),
        turn=np.array(turns),
        free=~sewn[edge_pairs],
    )


def corner_tangents(
    parameters: PatternParameters, edges: EdgeTable, corners: CornerTable
) -> tuple[Float[Array, "C 2"], Float[Array, "C 2"]]:
    """Unit tangents at the corners, both in the sense of the loop: arriving and leaving.

    Args:
        parameters: the pattern's parameters.
        edges: its edge table.
        corners: its corners.

    Returns:
        Two arrays of unit vectors in panel coordinates, each of shape (C, 2).
    """
    first, second = edge_controls(parameters, edges)
    arc = jnp.asarray(edges.kind) == int(EdgeKind.ARC)
    at_start, at_end = end_directions(arc, first, second)
    start = parameters.vertices[edges.vertices[:, 0]]
    chord = parameters.vertices[edges.vertices[:, 1]] - start
    across = jnp.stack([-chord[:, 1], chord[:, 0]], axis=1)

    def placed(local: Array) -> Array:
        direction = local[:, :1] * chord + local[:, 1:] * across
        return direction / jnp.linalg.norm(direction, axis=1, keepdims=True)

    return placed(at_end)[corners.edges[:, 0]], placed(at_start)[corners.edges[:, 1]]
