"""One measure for all: what an end state is, by dress_jax's energy and exact tests."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from benchmarks.peers.contestants.dress import build
from benchmarks.peers.scenes import Scene
from dress_jax.energy.elastic import TimeStep
from dress_jax.geometry.intersection import count_intersections, minimum_distance
from dress_jax.sim.inputs import StepInputs
from dress_jax.sim.objective import StepObjective


def objective(
    scene: Scene,
    start: Float[np.ndarray, "n 3"],
    velocity: Float[np.ndarray, "n 3"],
    *,
    inertia: bool = True,
) -> StepObjective:
    """dress_jax's incremental potential of a step of the scene."""
    jax.config.update("jax_enable_x64", True)
    simulator, parameters = build(scene)
    inverse = jnp.asarray(1.0 / scene.time_step if inertia else 0.0)
    step = TimeStep(jnp.asarray(start), jnp.asarray(velocity), inverse)
    return StepObjective(simulator, StepInputs(step, parameters, parameters.body_vertices))


def judge(scene: Scene, positions: Float[np.ndarray, "n 3"]) -> dict[str, Any]:
    """Of an end state.

    Returns:
        `energy` [J]: membrane, bending, barrier, pins, and weight from the scene's start; infinite
        where a pair is closer than the thickness. `smallest_distance` [m], `self_intersections`,
        `body_intersections`, and `contacts`: pairs closer than dhat beyond the thickness.
    """
    if not np.all(np.isfinite(positions)):
        return {"fault": "positions that are not finite"}
    mesh = (positions, scene.faces, scene.body_vertices, scene.body_faces)
    crossings = count_intersections(*mesh)
    potential = objective(scene, scene.start, np.zeros_like(scene.start), inertia=False)
    return {
        "energy": potential.value(positions),
        "smallest_distance": minimum_distance(*mesh, reach=2.0 * scene.dhat),
        "self_intersections": crossings.self,
        "body_intersections": crossings.body,
        "contacts": sum(int(pairs.count) for pairs in potential.contacts(positions)),
    }
