"""A moving body as boundary condition (S8.6, S8.7): every state on the way is intersection-free.

Body and cloth move in turns. The body takes the largest part of its way that continuous collision
detection allows, with the cloth near it carried along; then the cloth relaxes.
"""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from dress_jax.contact.broad_phase import find_candidates
from dress_jax.contact.candidates import make_candidates
from dress_jax.contact.ccd import step_bound
from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Parameters
from dress_jax.sim.simulator import Simulator
from dress_jax.sim.solve import State, step
from dress_jax.solver.newton import NewtonOptions

_CARRY_NEAR, _CARRY_FAR = 0.01, 0.05  # cloth is carried fully, and not at all, beyond these [m]
_SMALLEST_ADVANCE = 1e-4
_SAFETY = 0.9  # of the collision-free part of a motion


@dataclasses.dataclass(frozen=True)
class MotionOptions:
    """How the cloth follows a moving body.

    Attributes:
        longest_advance: no body vertex moves further than this before the cloth relaxes [m].
        relaxation_step: time step of the relaxation [s]; its inertia is what keeps the cloth from
            drifting while nothing else holds it.
        relaxation_iterations: Newton iterations of each relaxation.
    """

    longest_advance: float = 0.02
    relaxation_step: float = 0.05
    relaxation_iterations: int = 8


def motion_bound(
    simulator: Simulator,
    positions: Float[np.ndarray, "n 3"],
    displacement: Float[np.ndarray, "n 3"],
    body: Float[np.ndarray, "b 3"],
    body_displacement: Float[np.ndarray, "b 3"],
) -> float:
    """Part of a common motion of cloth and body that is free of collisions, in [0, 1]."""
    start = np.concatenate([positions, body])
    motion = np.concatenate([displacement, body_displacement])
    thickness = float(simulator.settings.thickness)
    rows = find_candidates(simulator.broad_phase, start, start + motion, 2.0 * thickness)
    return float(
        step_bound(
            jnp.asarray(start),
            jnp.asarray(motion),
            make_candidates(*rows),
            min_distance=simulator.settings.thickness,
        )
    )


def follow_body(
    simulator: Simulator,
    parameters: Parameters,
    positions: Float[np.ndarray, "n 3"],
    targets: Float[np.ndarray, "frames b 3"],
    *,
    options: MotionOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> Float[np.ndarray, "n 3"]:
    """Move the body through a sequence of shapes, the cloth giving way.

    Args:
        simulator: host object.
        parameters: `body_vertices` is where the body starts.
        positions: intersection-free cloth positions [m].
        targets: shapes of the body that are reached in turn [m].
        progress: called with the fraction of the way that is done.

    Returns:
        Cloth positions, intersection-free with the body at the last target.

    Raises:
        InputError: the body cannot advance: the cloth is caught, for example between body parts.
    """
    options = MotionOptions() if options is None else options
    loose = NewtonOptions(
        tolerance=1e-3,
        iteration_limit=options.relaxation_iterations,
        longest_step=simulator.newton.longest_step,
    )
    tight = dataclasses.replace(simulator, newton=loose)
    x = np.array(positions, np.float64)
    body = np.array(parameters.body_vertices)
    for number, target in enumerate(targets):
        stalled = 0
        while True:
            remaining = np.asarray(target) - body
            distance = float(np.max(np.linalg.norm(remaining, axis=1), initial=0.0))
            if distance == 0.0:
                break
            part = min(1.0, options.longest_advance / distance)
            advance = part * remaining
            carried = _carried(x, body, advance)
            bound = motion_bound(tight, x, carried, body, advance)
            taken = 1.0 if bound >= 1.0 else _SAFETY * bound
            if taken * part * distance < _SMALLEST_ADVANCE and taken < 1.0:
                stalled += 1
                if stalled > 8:
                    raise InputError(
                        f"the body cannot move on: after {_percent(number, targets)} of its way "
                        "the cloth is caught between it and something else",
                        mend="check that the garment can be put on this body in this pose",
                    )
            else:
                stalled = 0
            x = x + taken * carried
            body = np.asarray(target) if taken * part == 1.0 else body + taken * advance
            moved = replace(parameters, body_vertices=jnp.asarray(body))
            state = State(jnp.asarray(x), jnp.zeros_like(jnp.asarray(x)))
            state, _ = step(tight, state, moved, time_step=options.relaxation_step)
            x = np.asarray(state.positions)
            if progress is not None:
                left = distance * (1.0 - taken * part)
                whole = float(np.max(np.linalg.norm(remaining, axis=1), initial=1e-12))
                progress((number + 1.0 - left / max(whole, left)) / len(targets))
    simulator.pattern, simulator.slots = tight.pattern, tight.slots
    return x


def _percent(number: int, targets: np.ndarray) -> str:
    return f"{100 * number // len(targets)} %"


def _carried(x: np.ndarray, body: np.ndarray, advance: np.ndarray) -> np.ndarray:
    """Displacement of the nearest body vertex, faded out with the distance to it."""
    distance, nearest = cKDTree(body).query(x)
    weight = np.clip((_CARRY_FAR - distance) / (_CARRY_FAR - _CARRY_NEAR), 0.0, 1.0)
    return weight[:, None] * advance[nearest]
