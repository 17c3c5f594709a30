"""The forward solve of one implicit step (S2.1-S2.3): Newton's method on the incremental potential.

Positions in, positions and a report out; `implicit` makes it a differentiable function.
"""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.core.errors import InputError
from dress_jax.core.precision import require_float64
from dress_jax.core.pytree import pytree
from dress_jax.core.results import Result
from dress_jax.energy.faults import check_parameters
from dress_jax.energy.membrane import principal_stretches
from dress_jax.energy.panels import triangle_place
from dress_jax.energy.stretching import stretching_rest
from dress_jax.geometry.intersection import IntersectionCounts
from dress_jax.sim.adjoint import Linearization
from dress_jax.sim.inputs import StepInputs
from dress_jax.sim.objective import StepObjective
from dress_jax.sim.places import place_of_closest_pair, place_of_intersections
from dress_jax.sim.simulator import Simulator
from dress_jax.solver.newton import NewtonProgress, minimize


@pytree
class Report:
    """How a solve went; carries no derivative.

    Attributes:
        result: a `core.results.Result`.
        iterations: Newton steps.
        step_size: longest vertex displacement of the last Newton step [m].
        residual: largest force on a vertex [N].
        energy: [J].
        smallest_distance: of all pairs within reach [m].
        smallest_scaled_distance: likewise, over the contact scale of the pair; above the thickness
            [m].
        self_intersections, body_intersections: by the exact test.
    """

    result: Int[Array, ""]
    iterations: Int[Array, ""]
    step_size: Float[Array, ""]
    residual: Float[Array, ""]
    energy: Float[Array, ""]
    smallest_distance: Float[Array, ""]
    smallest_scaled_distance: Float[Array, ""]
    self_intersections: Int[Array, ""]
    body_intersections: Int[Array, ""]

    @property
    def converged(self) -> bool:
        """Whether the stopping rule was met."""
        return int(self.result) == Result.CONVERGED

    @property
    def intersection_free(self) -> bool:
        """Whether the exact test found no intersection."""
        return int(self.self_intersections) == 0 and int(self.body_intersections) == 0


def solve_step(
    simulator: Simulator, inputs: StepInputs
) -> tuple[Float[Array, "n 3"], Report, Linearization]:
    """Positions at the end of one implicit step, how the solve went, and what derivatives need.

    Args:
        simulator: host object.
        inputs: all concrete.

    Raises:
        RuntimeError: double precision is off.
        InputError: arrays that do not fit the simulator or are not finite, a start state closer
            than the thickness, or one beyond the strain limit.
    """
    require_float64("the cloth simulator")
    _validate(simulator, inputs)
    objective = StepObjective(simulator, inputs)
    x0 = np.asarray(inputs.step.start)
    _check_start(x0, objective)
    _check_strain(x0, objective)
    solution = minimize(objective, x0, simulator.newton, progress=_told(objective))
    x = solution.positions
    crossings = _count_intersections(x, objective)
    smallest = objective.smallest_distances(x)
    report = Report(
        result=jnp.asarray(int(solution.result)),
        iterations=jnp.asarray(solution.iterations),
        step_size=jnp.asarray(solution.step_size),
        residual=jnp.asarray(solution.residual),
        energy=jnp.asarray(solution.energy),
        smallest_distance=jnp.asarray(smallest.plain),
        smallest_scaled_distance=jnp.asarray(smallest.scaled),
        self_intersections=jnp.asarray(crossings.self),
        body_intersections=jnp.asarray(crossings.body),
    )
    return jnp.asarray(x), report, Linearization(objective, x, solution.factorization)


def _told(objective: StepObjective) -> Callable[[NewtonProgress], None]:
    """Passes an iteration on to those who want to know about it."""
    simulator = objective.simulator
    body = np.asarray(objective.parameters.body_vertices)

    def tell(progress: NewtonProgress) -> None:
        if simulator.progress is not None:
            simulator.progress(progress)
        if simulator.observer is not None:
            simulator.observer(progress.positions, body)

    return tell


def _count_intersections(x, objective: StepObjective) -> IntersectionCounts:
    """The exact test, of a state with the body at the end of the step."""
    simulator = objective.simulator
    return simulator.clean_state.count(
        x,
        np.asarray(simulator.cloth.faces).T,
        np.asarray(objective.parameters.body_vertices),
        simulator.body_faces,
        weld_map=simulator.weld_map,
    )


def _check_start(x0, objective: StepObjective) -> None:
    """Raise where the start state intersects or is closer than the thickness."""
    mend = (
        "start from a state without intersections, put the garment on with `sim.dressing.dress`, "
        "or free this state with `sim.dressing.repair_start`"
    )
    crossings = _count_intersections(x0, objective)
    if crossings.self or crossings.body:
        body = np.asarray(objective.parameters.body_vertices)
        raise InputError(
            f"the start state has {crossings.self} intersections of the cloth with itself and "
            f"{crossings.body} with the body",
            where=place_of_intersections(objective.simulator, x0, body),
            mend=mend,
        )
    thickness = float(objective.simulator.settings.thickness)
    part = objective.smallest_distances(x0).scaled / thickness if thickness > 0.0 else np.inf
    if part <= 1.0:
        raise InputError(
            f"the start state has a pair at {part:.4f} times its thickness (of up to "
            f"{thickness * 1e3:.4f} mm); pairs must be further apart",
            where=place_of_closest_pair(objective, x0),
            mend=mend,
        )


def _check_strain(x0, objective: StepObjective) -> None:
    """Raise where a triangle of the start state is stretched to its limit or beyond."""
    parameters, cloth = objective.parameters, objective.simulator.cloth
    if parameters.strain_limit is None:
        return
    rest = stretching_rest(parameters, cloth)
    stretch = np.asarray(principal_stretches(jnp.asarray(x0), cloth.faces, rest)[0])
    limit = np.broadcast_to(np.asarray(parameters.strain_limit.stretch), stretch.shape)
    beyond = np.flatnonzero(~(stretch < limit))
    if len(beyond):
        worst = int(beyond[np.argmax(stretch[beyond] / limit[beyond])])
        raise InputError(
            f"the start state stretches {len(beyond)} triangles to the strain limit or beyond, "
            f"this one by {stretch[worst]:.4f} where {limit[worst]:.4f} is allowed",
            where=triangle_place(worst, objective.simulator.panels),
            mend="drape without the limit first, start from a state that keeps it, or raise it",
        )


def _validate(simulator: Simulator, inputs: StepInputs) -> None:
    parameters = inputs.parameters
    n, b = simulator.vertex_count, len(simulator.body_areas)
    expected = {
        "start positions": (inputs.step.start, (n, 3)),
        "start velocities": (inputs.step.velocity, (n, 3)),
        "body vertices": (parameters.body_vertices, (b, 3)),
        "body vertices at the start": (inputs.body_start, (b, 3)),
        "pin targets": (parameters.pin_targets, (len(simulator.cloth.pins), 3)),
    }
    for name, (array, shape) in expected.items():
        if array.shape != shape:
            raise InputError(f"{name} have shape {array.shape}, expected {shape}")
    for name, (array, _) in expected.items():
        bad = np.flatnonzero(~np.isfinite(np.asarray(array)).all(axis=1))
        if len(bad):
            raise InputError("a number is not finite", where=f"{name}, row {bad[0]}")
    check_parameters(parameters, simulator.cloth, simulator.panels)
