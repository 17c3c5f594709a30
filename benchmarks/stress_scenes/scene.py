"""What a stress scene is."""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Gravity, Parameters, make_cloth
from dress_jax.energy.fabric import Fabric, make_parameters
from dress_jax.sim import Simulator, State, make_simulation, step
from dress_jax.solver import NewtonOptions

FABRIC = Fabric(density=0.2, stretching_stiffness=200.0, bending_stiffness=1e-5)
LIMIT = NewtonOptions(tolerance=1e-4, iteration_limit=20)
NO_BODY = (np.eye(3) * 0.01 + [0.0, -50.0, 0.0], np.array([[0, 1, 2]]))  # one triangle, far away


@dataclasses.dataclass(frozen=True)
class Scene:
    """A cloth at its start, and what is done to it.

    Attributes:
        simulator, parameters: at the start.
        positions: of the cloth at the start [m], (n, 3).
        act: (simulator, parameters, positions) -> positions at the end; every solve of it goes
            through this simulator.
    """

    simulator: Simulator
    parameters: Parameters
    positions: Float[np.ndarray, "n 3"]
    act: Callable[[Simulator, Parameters, np.ndarray], np.ndarray]


def make_scene(
    rest: Float[np.ndarray, "p 2"],
    faces: Int[np.ndarray, "f 3"],
    positions: Float[np.ndarray, "n 3"],
    act: Callable[[Simulator, Parameters, np.ndarray], np.ndarray],
    *,
    body: tuple[np.ndarray, np.ndarray] = NO_BODY,
    pins: Int[np.ndarray, " k"] | None = None,
    rest_faces: Int[np.ndarray, "f 3"] | None = None,
    gravity: Gravity = Gravity.DOWN,
    friction: bool = True,
) -> Scene:
    """A scene of one fabric.

    Args:
        body: vertices [m] and triangles.
        pins: vertices that are held, at first where they are.
        rest_faces: default the same indices as `faces`.
    """
    cloth = make_cloth(faces, rest_faces, vertex_count=len(positions), pins=pins)
    targets = None if pins is None else positions[pins]
    simulator, _ = make_simulation(
        cloth,
        positions,
        rest,
        fabric=FABRIC,
        body_vertices=body[0],
        body_faces=body[1],
        newton=LIMIT,
    )
    parameters = make_parameters(
        cloth,
        FABRIC,
        jnp.asarray(rest),
        body_vertices=jnp.asarray(body[0]),
        pin_targets=None if targets is None else jnp.asarray(targets),
        gravity=gravity,
    )
    simulator.friction = friction
    return Scene(simulator, parameters, positions, act)


def fall(
    simulator: Simulator,
    parameters: Parameters,
    positions: np.ndarray,
    *,
    steps: int,
    time_step: float,
    velocity: Float[np.ndarray, "3"] | None = None,
    targets: Callable[[float], np.ndarray] | None = None,
) -> np.ndarray:
    """Dynamic steps.

    Args:
        steps, time_step: number and length [s].
        velocity: of the whole cloth at first [m/s].
        targets: pin targets [m] after a part of the steps.
    """
    start = np.zeros(3) if velocity is None else velocity
    state = State(jnp.asarray(positions), jnp.asarray(np.tile(start, (len(positions), 1))))
    for number in range(steps):
        if targets is not None:
            moved = jnp.asarray(targets((number + 1) / steps))
            parameters = replace(parameters, pin_targets=moved)
        state, _ = step(simulator, state, parameters, time_step=time_step)
    return np.asarray(state.positions)
