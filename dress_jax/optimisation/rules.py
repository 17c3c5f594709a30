"""Design rules in a fit: proposals are moved to the nearest pattern that keeps them (host).

Rules are constraints and no penalties: Gauss-Newton looks for its steps in the directions that they
leave, and what their curvature adds, or Adam's step breaks, is mended here.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.optimisation.problem import FitProblem, validated_pattern
from dress_jax.optimisation.state import Unknowns
from dress_jax.pattern.parameters import EdgeTable, PatternParameters
from dress_jax.pattern.rules import TOLERANCE, Rule, gaps
from dress_jax.pattern.symmetry import Symmetry, validated

_ROUNDS = 30
_CHORD = 0.2  # [m] that a control moves by per chord length, to weigh it against corners
_REACHED = 1e-3  # of the tolerance


def follow_rules(problem: FitProblem, unknowns: Unknowns) -> Unknowns:
    """The nearest unknowns whose pattern keeps the problem's rules; themselves if it does.

    Gauss-Newton with the smallest change of corners and controls; rules that contradict each other
    are kept as well as they can be, which `broken_rules` tells.
    """
    if not problem.rules:
        return unknowns
    pattern = unknowns.pattern
    corners = pattern.vertices.size
    scale = np.ones(corners + pattern.controls.size)
    scale[corners:] = 1.0 / _CHORD
    vector = jnp.concatenate([pattern.vertices.ravel(), pattern.controls.ravel()])
    bounds = at_least(problem)
    moved = False
    for _ in range(_ROUNDS):
        gap, jacobian = rule_gaps(problem, vector, pattern)
        off = ~bounds | (gap < 0.0)
        if np.max(np.abs(gap[off]), initial=0.0) <= _REACHED * TOLERANCE:
            break
        way = np.linalg.lstsq(jacobian[off] * scale, -gap[off], rcond=1e-9)[0]
        vector, moved = vector + jnp.asarray(scale * way), True
    if not moved:
        return unknowns
    return replace(
        unknowns,
        pattern=PatternParameters(
            vertices=vector[:corners].reshape(pattern.vertices.shape),
            controls=vector[corners:].reshape(pattern.controls.shape),
        ),
    )


def broken_rules(problem: FitProblem, pattern: PatternParameters) -> dict[str, float]:
    """The rules that optimised parameters do not keep, with their largest gaps [m or rad]."""
    valid, broken = validated_pattern(problem, pattern), {}
    for rule in problem.rules:
        gap = np.asarray(rule.gap(valid, problem.tables.edges))
        worst = float(np.max(-gap if rule.at_least else np.abs(gap)))
        if not worst <= TOLERANCE:
            broken[rule.name] = worst
    return broken


def check_rules(problem: FitProblem, pattern: PatternParameters) -> None:
    """Refuse rules that the initial pattern cannot be brought to keep.

    Raises:
        InputError: names the rules.
    """
    broken = broken_rules(problem, pattern)
    if broken:
        raise InputError(
            "the initial pattern cannot be made to follow " + "; ".join(broken),
            where="design rules",
            mend="take out what contradicts the others",
        )


def at_least(problem: FitProblem) -> Bool[np.ndarray, " m"]:
    """Which gaps may be positive."""
    edges, reference = problem.tables.edges, problem.tables.reference
    sizes = [
        jax.eval_shape(lambda p, rule=rule: rule.gap(p, edges), reference).size
        for rule in problem.rules
    ]
    return np.repeat(np.array([rule.at_least for rule in problem.rules], bool), sizes)


def rule_gaps(
    problem: FitProblem, vector: Array, like: PatternParameters
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m k"]]:
    """Gaps of all rules, and their derivatives in corners and controls.

    Args:
        problem: holds the rules.
        vector: corners and controls, flattened.
        like: gives their shapes.
    """
    data = (like, problem.tables.symmetry, problem.tables.edges)
    value, slope = _gaps_and_slopes(problem.rules, vector, *data)
    return np.asarray(value), np.asarray(slope)


@functools.partial(jax.jit, static_argnums=0)
def _gaps_and_slopes(
    rules: tuple[Rule, ...],
    vector: Array,
    like: PatternParameters,
    symmetry: Symmetry | None,
    edges: EdgeTable,
) -> tuple[Float[Array, " m"], Float[Array, "m k"]]:
    corners = like.vertices.size

    def own(vector: Array) -> Array:
        pattern = PatternParameters(
            vertices=vector[:corners].reshape(like.vertices.shape),
            controls=vector[corners:].reshape(like.controls.shape),
        )
        return gaps(rules, validated(pattern, symmetry), edges)

    return own(vector), jax.jacfwd(own)(vector)
