"""The unknowns of a Gauss-Newton fit as one vector, and its directions that a drape can feel."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from dress_jax.optimisation.gauss_newton.options import GaussNewtonOptions
from dress_jax.optimisation.state import Unknowns
from dress_jax.pattern.parameters import PatternParameters
from dress_jax.pattern.symmetry import Symmetry, validated

Vector = Float[np.ndarray, " k"]

PIN_SHIFT = 3
"""Unknowns of the pins; they come last."""

_FELT = 0.5  # eigenvalues of the validation are 1, or epsilon for what it takes away


def as_vector(unknowns: Unknowns) -> Vector:
    """Corners [m], control points [chord lengths], the fabric's unknowns, pins [m]."""
    pattern = unknowns.pattern
    parts = (pattern.vertices, pattern.controls, unknowns.log_stiffness, unknowns.pin_shift)
    return np.concatenate([np.asarray(part).ravel() for part in parts])


def from_vector(vector: Vector, like: Unknowns) -> Unknowns:
    """The inverse of `as_vector`; colours are those of `like`."""
    pattern, log_stiffness, pin_shift = split(jnp.asarray(vector), like.pattern)
    return Unknowns(
        pattern=pattern, log_stiffness=log_stiffness, pin_shift=pin_shift, colors=like.colors
    )


def split(vector: Array, like: PatternParameters) -> tuple[PatternParameters, Array, Array]:
    """Pattern, the fabric's unknowns and pins of a vector; `like` gives the shapes."""
    corners = like.vertices.size
    controls = corners + like.controls.size
    pattern = PatternParameters(
        vertices=vector[:corners].reshape(like.vertices.shape),
        controls=vector[corners:controls].reshape(like.controls.shape),
    )
    return pattern, vector[controls:-PIN_SHIFT], vector[-PIN_SHIFT:]


def step_limits(unknowns: Unknowns, options: GaussNewtonOptions) -> Vector:
    """The largest change of each unknown in one step."""
    return np.concatenate(
        [
            np.full(unknowns.pattern.vertices.size, options.longest_step),
            np.full(unknowns.pattern.controls.size, options.longest_control_step),
            np.full(unknowns.log_stiffness.size, options.longest_stiffness_step),
            np.full(unknowns.pin_shift.size, options.longest_pin_step),
        ]
    )


def felt_directions(
    like: PatternParameters, symmetry: Symmetry | None, fabric: int
) -> Float[np.ndarray, "r k"]:
    """An orthonormal basis of the directions in which validated unknowns change (host).

    What mirrored panels differ in has no effect, so about half as many sensitivities will do.

    Args:
        like: gives the shapes.
        symmetry: of the pattern.
        fabric: number of its unknowns.
    """
    count = like.vertices.size + like.controls.size
    rest = fabric + PIN_SHIFT
    if symmetry is None:
        return np.eye(count + rest)

    def pattern(vector: Array) -> Array:
        valid = validated(split(vector, like)[0], symmetry)
        return jnp.concatenate([valid.vertices.ravel(), valid.controls.ravel()])

    matrix = np.asarray(jax.jacfwd(pattern)(jnp.zeros(count + rest)))[:, :count]
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    felt = vectors[:, values > _FELT].T
    basis = np.zeros((len(felt) + rest, count + rest))
    basis[: len(felt), :count] = felt
    basis[len(felt) :, count:] = np.eye(rest)
    return basis
