"""A moving body as boundary condition (S8.6, S8.7): every state on the way is intersection-free.

Body and cloth move in turns. The body takes the largest part of its way that continuous collision
detection allows, with the cloth near it carried along; then the cloth relaxes. With friction, what
was carried stays where friction holds it.
"""

import dataclasses
from collections.abc import Callable, Iterator

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from dress_jax.contact.ccd import step_bound
from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Parameters
from dress_jax.sim.objective import resting_objective
from dress_jax.sim.places import place_of_closest_pair
from dress_jax.sim.simulator import Simulator
from dress_jax.sim.solve import State, step
from dress_jax.solver.newton import NewtonOptions

_CARRY_NEAR, _CARRY_FAR = 0.01, 0.05  # cloth is carried fully, and not at all, beyond these [m]
_SMALLEST_ADVANCE = 1e-4  # [m]
_PATIENCE = 8  # relaxations without an advance, or without enough distance
# Tight cloth presses until the gap that is left bounds the advance; a stiffer barrier holds it
# further away. So many relaxations without an advance make it so much stiffer, for the rest of the
# way.
_STIFFEN_AFTER, _STIFFER = 2, 4.0
_KEPT_SHARE = 0.5  # of the smallest distance, while it is below twice the thickness
# The same where cloth has to be driven apart at the end: a barrier that begins close to where a
# tight cuff presses with all its force lifts it, one that begins at half of it does not.
_DRIVEN_SHARE, _DRIVES = 0.97, 40
_DRIVEN_TOLERANCE = 0.05  # of Newton, over the thickness; on the way it is far coarser
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
    reach = 2.0 * float(simulator.settings.thickness) * simulator.contact_scales
    padding = simulator.padding
    candidates = simulator.broad_phase.find(
        start,
        start + motion,
        reach,
        body_offset=padding.padded.vertices,
        scales=padding.together(simulator.contact_scales),
    )
    return float(
        step_bound(
            jnp.asarray(np.concatenate([padding.positions(positions), padding.body(body)])),
            jnp.asarray(
                np.concatenate([padding.vectors(displacement), padding.body(body_displacement)])
            ),
            candidates,
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
        positions: intersection-free cloth positions [m]; they may be closer than the thickness.
        targets: shapes of the body that are reached in turn [m].
        progress: called with the fraction of the way that is done.

    Returns:
        Cloth positions, intersection-free with the body at the last target and further than the
        thickness from it and from each other.

    Raises:
        InputError: the body cannot advance: the cloth is caught, for example between body parts
            that close to less than its thickness; the message says where. The advances are
            bounded below, so it comes in bounded time.
    """
    options = MotionOptions() if options is None else options
    walk = _Walk(simulator, parameters, np.array(positions, np.float64), options)
    walk.relax()
    for number, target in enumerate(targets):
        stalled = 0
        for left, whole in walk.towards(np.asarray(target)):
            stalled = stalled + 1 if walk.last_advance < _SMALLEST_ADVANCE else 0
            if stalled and stalled % _STIFFEN_AFTER == 0:
                walk.stiffen()
            if stalled > _PATIENCE:
                done = 100.0 * (number + 1.0 - left / whole) / len(targets)
                raise InputError(
                    f"the body cannot move on: after {done:.0f} % of its way the cloth is caught "
                    f"between it and something else, {1e3 * left:.2f} mm before a shape that it "
                    "has to take",
                    where=walk.tightest(),
                    mend="check that the garment can be put on this body in this pose, and that "
                    "body parts leave room for the thickness of the cloth between them",
                )
            if progress is not None:
                progress((number + 1.0 - left / whole) / len(targets))
    walk.finish()
    return walk.positions


def settle(
    simulator: Simulator,
    parameters: Parameters,
    positions: Float[np.ndarray, "n 3"],
    *,
    steps: int,
    time_step: float,
    iterations: int = 12,
) -> Float[np.ndarray, "n 3"]:
    """Let the cloth fall for a few implicit steps, each from rest: rough, and quick.

    Args:
        simulator: host object.
        parameters: with gravity.
        positions: intersection-free cloth positions [m].
        steps: number of steps.
        time_step: of each [s].
        iterations: Newton iterations of each.
    """
    options = MotionOptions(relaxation_step=time_step, relaxation_iterations=iterations)
    walk = _Walk(simulator, parameters, np.array(positions, np.float64), options)
    for _ in range(steps):
        walk.relax()
    walk.finish()
    return walk.positions


class _Walk:
    """A cloth and a body on their way.

    Parts that start closer than the thickness get a smaller one, which grows back as they part.
    """

    def __init__(
        self,
        simulator: Simulator,
        parameters: Parameters,
        positions: np.ndarray,
        options: MotionOptions,
    ):
        self._simulator = simulator
        loose = NewtonOptions(
            tolerance=1e-3,
            iteration_limit=options.relaxation_iterations,
            longest_step=simulator.newton.longest_step,
            exact_below=0.0,
        )
        self._loose = dataclasses.replace(simulator, newton=loose)
        self._parameters = parameters
        self._options = options
        self.positions = positions
        self.body = np.array(parameters.body_vertices)
        self.last_advance = 0.0
        objective = resting_objective(simulator, parameters, positions)
        self._keep(objective.smallest_distances(positions).scaled)

    def _keep(self, smallest: float, share: float = _KEPT_SHARE) -> None:
        """Adapt the thickness to the smallest distance of a pair over its scale [m]."""
        wanted = float(self._simulator.settings.thickness)
        self._smallest = smallest
        self._loose.settings = replace(
            self._simulator.settings,
            thickness=jnp.asarray(min(wanted, share * smallest), jnp.float64),
        )

    def _tell(self) -> None:
        if self._simulator.observer is not None:
            self._simulator.observer(self.positions, self.body)

    def tightest(self) -> str:
        """Where the cloth is closest to anything, for messages."""
        moved = replace(self._parameters, body_vertices=jnp.asarray(self.body))
        objective = resting_objective(self._loose, moved, self.positions)
        return place_of_closest_pair(objective, self.positions)

    def relax(self) -> None:
        """One implicit step of the cloth with the body at rest."""
        moved = replace(self._parameters, body_vertices=jnp.asarray(self.body))
        state = State(jnp.asarray(self.positions), jnp.zeros(self.positions.shape))
        state, report = step(self._loose, state, moved, time_step=self._options.relaxation_step)
        if not report.intersection_free:
            raise RuntimeError(
                "the cloth passed through itself or the body while it relaxed "
                f"({int(report.self_intersections)} and {int(report.body_intersections)} crossings)"
            )
        self.positions = np.asarray(state.positions)
        self._keep(float(report.smallest_scaled_distance))

    def towards(self, target: np.ndarray) -> Iterator[tuple[float, float]]:
        """Advance to a shape; yields the distances that are left and that were to go [m]."""
        whole = None
        while True:
            remaining = target - self.body
            distance = float(np.max(np.linalg.norm(remaining, axis=1), initial=0.0))
            if distance == 0.0:
                return
            whole = distance if whole is None else max(whole, distance)
            still = np.zeros_like(self.positions)
            # With friction the cloth comes along, whether or not it is in the way.
            if not self._simulator.friction and self._bound(still, remaining) >= 1.0:
                self.body = target
                self._tell()
                return
            part = min(1.0, self._options.longest_advance / distance)
            advance = part * remaining
            carried = _carried(self.positions, self.body, advance)
            bound = self._bound(carried, advance)
            taken = 1.0 if bound >= 1.0 else _SAFETY * bound
            self.positions = self.positions + taken * carried
            self.body = target if taken * part == 1.0 else self.body + taken * advance
            self.last_advance = taken * part * distance
            self._tell()
            self.relax()
            yield distance - self.last_advance, whole

    def stiffen(self) -> None:
        """Make the barrier stiffer, for the rest of the way."""
        stiffness = _STIFFER * self._parameters.barrier_stiffness
        self._parameters = replace(self._parameters, barrier_stiffness=stiffness)

    def _bound(self, displacement: np.ndarray, body_displacement: np.ndarray) -> float:
        return motion_bound(self._loose, self.positions, displacement, self.body, body_displacement)

    def finish(self) -> None:
        """Relax until everything is further apart than the thickness."""
        self.relax()
        wanted = float(self._simulator.settings.thickness)
        self._loose.newton = dataclasses.replace(
            self._loose.newton, tolerance=_DRIVEN_TOLERANCE * wanted
        )
        for _ in range(_DRIVES):
            if self._smallest > wanted:
                break
            self._keep(self._smallest, _DRIVEN_SHARE)
            self.relax()
        if self._smallest <= wanted:
            raise InputError(
                f"parts of the cloth stay {1e3 * self._smallest:.4f} mm from each other or from "
                f"the body, which is less than the thickness of {1e3 * wanted:.4f} mm",
                where=self.tightest(),
                mend="use a smaller thickness, or check that the garment fits this body",
            )
        self._simulator.pattern = self._loose.pattern
        self._simulator.slots = self._loose.slots


def _carried(x: np.ndarray, body: np.ndarray, advance: np.ndarray) -> np.ndarray:
    """Displacement of the nearest body vertex, faded out with the distance to it."""
    distance, nearest = cKDTree(body).query(x)
    weight = np.clip((_CARRY_FAR - distance) / (_CARRY_FAR - _CARRY_NEAR), 0.0, 1.0)
    return weight[:, None] * advance[nearest]
