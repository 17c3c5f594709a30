"""How a drape answers to its parameters: forward-mode derivatives, many directions at once.

The adjoint of `equilibrium` costs one linear solve per scalar; here the exact Hessian is factorized
once, and every direction costs one back-substitution. A pattern has a few hundred unknowns.
"""

import functools
from collections.abc import Mapping

import jax
import numpy as np
from jaxtyping import Array, Float

from dress_jax.core.precision import require_float64
from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Parameters
from dress_jax.sim.kernels import make_frame
from dress_jax.sim.objective import resting_objective
from dress_jax.sim.simulator import Simulator

_BATCH = 16  # directions that are differentiated together
_HALVINGS = 4  # of a prediction before it is given up


def static_sensitivity(
    simulator: Simulator,
    parameters: Parameters,
    positions: Float[np.ndarray, "n 3"],
    directions: Mapping[str, Float[Array, "k *leaf"]],
) -> Float[np.ndarray, "n 3 k"]:
    """Derivatives of a static drape along directions in the space of its parameters.

    They are those of `static_solve` from the drape itself: of one implicit step of 1 s that begins
    at rest there, so they predict where the next such step with other parameters ends.

    Args:
        simulator: host object; its sparsity may be extended.
        parameters: of the drape.
        positions: the drape [m].
        directions: changes of leaves of `Parameters`, by name; leaves that are absent stay.

    Returns:
        dx/ds [m] per unit of each direction.

    Raises:
        RuntimeError: double precision is off.
        LinearSolveError: the exact Hessian is not positive definite, so that the state is no stable
            minimum and has no derivative.
    """
    require_float64("static_sensitivity")
    objective = resting_objective(simulator, parameters, positions)
    x = np.asarray(positions, np.float64)
    terms = objective.terms(objective.contacts(x))
    padding = simulator.padding
    padded = {name: padding.directions(name, rows) for name, rows in directions.items()}
    fixed = (
        padding.positions(x),
        padding.parameters(parameters),
        padding.cloth,
        objective.frame,
        padding.body(np.asarray(simulator.body_areas)),
    )
    parts = [_force_changes(term.energy, padded, *fixed, *pairs) for term, pairs in terms]
    change = np.sum([np.asarray(part) for part in parts], axis=0)[:, : len(x)]
    factorization = objective.factorize(x, exact=True)
    return -factorization.solve(change.reshape(len(change), -1).T).reshape(*x.shape, -1)


def predicted_start(
    simulator: Simulator,
    parameters: Parameters,
    positions: Float[np.ndarray, "n 3"],
    displacement: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 3"]:
    """Where to begin a drape whose parameters have changed: along the predicted displacement.

    As far as no pair touches, and no further than where the energy is below that at the positions;
    so a prediction that fails costs time and nothing else. Close to the new equilibrium Newton
    needs fewer steps, and folds stay what they are.

    Args:
        simulator: host object.
        parameters: of the new drape.
        positions: an intersection-free state [m], the drape of other parameters.
        displacement: from `static_sensitivity` [m].

    Returns:
        An intersection-free state [m].
    """
    objective = resting_objective(simulator, parameters, positions)
    fraction = objective.step_bound(positions, displacement)
    energy = objective.value(positions)
    for _ in range(_HALVINGS):
        predicted = positions + fraction * displacement
        if objective.value(predicted) < energy:
            return predicted
        fraction *= 0.5
    return positions


@functools.partial(jax.jit, static_argnums=0)
def _force_changes(energy, directions, positions, parameters, cloth, frame, body_areas, *pairs):
    """Changes of the gradient of one energy, (k, n, 3)."""
    base = {name: getattr(parameters, name) for name in directions}

    def gradient(varied):
        changed = replace(parameters, **varied)
        fixed = frame.step, frame.body_start, body_areas, frame.settings
        own_frame = make_frame(changed, cloth, *fixed)
        return jax.grad(energy)(positions, changed, cloth, own_frame, *pairs)

    def along(direction):
        return jax.jvp(gradient, (base,), (direction,))[1]

    return jax.lax.map(along, directions, batch_size=_BATCH)
