"""When a fit needs another mesh, and how it goes on with one (S13).

A fit moves a mesh by its outline alone. Where a panel has changed a lot, triangles are stretched or
too large for their fabric. A new mesh of the fitted pattern cannot be laid onto the drape: between
the old vertices the surface is another one, and next to a contact it may cross. So the new mesh is
put on like the first one, from the flat start placement: with the curve parameters and harmonic
coordinates of the new mesh the initial pattern has the same triangulation (the pull-back of S13.3),
and that garment is dressed; then it relaxes to the fitted rest shape. Dressing is the caller's, who
knows the body's way to its pose.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Float

from dress_jax.core.pytree import replace
from dress_jax.optimisation.problem import FitProblem, rest_shape
from dress_jax.optimisation.state import DrapedUnknowns, Unknowns
from dress_jax.pattern import Discretization, pattern_parameters, rest_positions
from dress_jax.pattern.parameters import PatternParameters
from dress_jax.pattern.transfer import vertex_transfer


def distortion(problem: FitProblem, pattern: PatternParameters) -> float:
    """The largest factor by which a length in a triangle has changed since it was meshed.

    max over triangles of max(s1, 1 / s2) with the singular values s1 >= s2 of the map from the
    meshed to the rest triangle; infinite for flipped ones (S22.12).

    Args:
        problem: with the mesh.
        pattern: optimised parameters.
    """
    faces = np.asarray(problem.discretization.rest_faces)

    def sides(points: np.ndarray) -> np.ndarray:
        a, b, c = (points[faces[:, k]] for k in range(3))
        return np.stack([b - a, c - a], axis=-1)

    meshed = sides(np.asarray(problem.discretization.meshed_positions))
    rest = sides(np.asarray(rest_shape(problem, pattern)))
    gradient = np.linalg.solve(np.swapaxes(meshed, 1, 2), np.swapaxes(rest, 1, 2))
    if np.any(np.linalg.det(gradient) <= 0.0):
        return np.inf
    first, second = np.linalg.svd(gradient, compute_uv=False).T
    return float(max(first.max(), 1.0 / second.min()))


def pulled_back(problem: FitProblem, discretization: Discretization) -> Float[np.ndarray, "P 2"]:
    """The initial pattern in the triangulation of a later one (S13.3) [m].

    Args:
        problem: holds the initial pattern.
        discretization: of a fitted pattern.
    """
    start = pattern_parameters(problem.pattern)
    return np.asarray(rest_positions(start, discretization))


def transfer_weights(
    old: FitProblem, new: FitProblem, pattern: PatternParameters
) -> scipy.sparse.csr_array:
    """Weights from the vertices of one problem's mesh to those of the other's."""
    before, after = (np.asarray(rest_shape(problem, pattern)) for problem in (old, new))
    return vertex_transfer(old.discretization, before, new.discretization, after)


def at_new_vertices(colors: Any, weights: scipy.sparse.csr_array) -> Any:
    """Vertex colours, or an optimiser's moments of them, looked up in the old mesh."""

    def moved(leaf: Array) -> Array:
        return jnp.asarray(weights.dot(np.asarray(leaf))) if np.ndim(leaf) else leaf

    return jax.tree.map(moved, colors)


def pin_change(old: FitProblem, new: FitProblem) -> Float[Array, "3"]:
    """What keeps pins where they were when a garment is put on again: added to their shift [m].

    Dressing finds a height of its own for the waist loop; the fitted one is known better.
    """
    before, after = old.parameters.pin_targets, new.parameters.pin_targets
    if not len(before) or not len(after):
        return jnp.zeros(3)
    return jnp.mean(before, axis=0) - jnp.mean(after, axis=0)


def carried_unknowns(
    old: FitProblem, new: FitProblem, unknowns: Unknowns, weights: scipy.sparse.csr_array
) -> Unknowns:
    """The unknowns on another mesh: the same pattern, colours looked up, pins where they were."""
    return replace(
        unknowns,
        colors=at_new_vertices(unknowns.colors, weights),
        pin_shift=unknowns.pin_shift + pin_change(old, new),
    )


def needs_remeshing(problem: FitProblem, state: DrapedUnknowns) -> bool:
    """Whether a state's triangles are distorted beyond `FitOptions.remesh_distortion` (S13.1)."""
    return distortion(problem, state.unknowns.pattern) > problem.options.remesh_distortion
