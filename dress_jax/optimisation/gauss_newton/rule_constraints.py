"""Design rules as constraints on a Gauss-Newton step."""

import jax.numpy as jnp
import numpy as np

from dress_jax.optimisation.gauss_newton.constraints import Constraints
from dress_jax.optimisation.gauss_newton.vector import as_vector
from dress_jax.optimisation.problem import FitProblem
from dress_jax.optimisation.rules import at_least, rule_gaps
from dress_jax.optimisation.state import Unknowns


def rule_constraints(problem: FitProblem, unknowns: Unknowns) -> Constraints | None:
    """The rules around some unknowns, linearized; None without any."""
    if not problem.rules:
        return None
    pattern, vector = unknowns.pattern, as_vector(unknowns)
    count = pattern.vertices.size + pattern.controls.size
    gap, slope = rule_gaps(problem, jnp.asarray(vector[:count]), pattern)
    jacobian = np.zeros((len(gap), len(vector)))
    jacobian[:, :count] = slope
    return Constraints(gap, jacobian, at_least(problem))
