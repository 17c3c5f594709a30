"""One implicit step as a differentiable layer (S2.1-S2.11).

Forward: Newton's method on the incremental potential. Backward: one linear solve with the exact
Hessian at the solution, by conjugate gradients preconditioned with the factorization that the
forward solve kept, and one product with the mixed derivative, by autodiff of the gradient.
Memory does not depend on the number of Newton iterations.
"""

import functools
import warnings

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.core.errors import InputError
from dress_jax.core.precision import require_float64
from dress_jax.core.pytree import pytree
from dress_jax.core.results import Result
from dress_jax.energy.cloth import Parameters
from dress_jax.energy.elastic import TimeStep
from dress_jax.geometry.intersection import IntersectionCounts
from dress_jax.sim.kernels import make_frame
from dress_jax.sim.objective import StepObjective
from dress_jax.sim.simulator import Simulator
from dress_jax.solver.conjugate_gradient import conjugate_gradient
from dress_jax.solver.newton import hessian_operator, minimize

_ADJOINT_TOLERANCE = 1e-10
_ADJOINT_LIMIT = 300


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
        self_intersections, body_intersections: by the exact test.
    """

    result: Int[Array, ""]
    iterations: Int[Array, ""]
    step_size: Float[Array, ""]
    residual: Float[Array, ""]
    energy: Float[Array, ""]
    smallest_distance: Float[Array, ""]
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


class AdjointWarning(UserWarning):
    """A backward solve failed; the gradient is NaN."""


class _Kept:
    """A host object that rides along in the residuals of a custom derivative."""

    def __init__(self, value: object):
        self.value = value


jax.tree_util.register_pytree_node(_Kept, lambda kept: ((), kept), lambda kept, _: kept)


def check_concrete(caller: str, *trees: object) -> None:
    """Raise where an argument is traced: the Newton loop runs on the host."""
    for leaf in jax.tree.leaves(trees):
        if isinstance(leaf, jax.core.Tracer):
            raise TypeError(
                f"{caller} runs its Newton loop on the host and cannot be traced by jit or vmap; "
                "call it outside of jit (jax.grad and jax.vjp work), and jit what comes before "
                "and after it"
            )


@functools.partial(jax.custom_vjp, nondiff_argnums=(0,))
def advance(
    simulator: Simulator,
    start: Float[Array, "n 3"],
    velocity: Float[Array, "n 3"],
    parameters: Parameters,
    body_start: Float[Array, "b 3"],
    inverse_step: Float[Array, ""],
) -> tuple[Float[Array, "n 3"], Report]:
    """Positions at the end of one implicit step, and how the solve went.

    Args:
        simulator: host object.
        start: x^n [m], intersection-free with the body at `parameters.body_vertices`.
        velocity: v^n [m/s].
        parameters: all continuous parameters; `body_vertices` is the body at the end of the step.
        body_start: the body at the start of the step, for friction [m].
        inverse_step: 1/h [1/s]; zero leaves inertia out.

    Raises:
        RuntimeError: double precision is off.
        TypeError: called under jit or vmap.
        InputError: arrays that do not fit the simulator or are not finite, or a start state closer
            than the thickness.
    """
    positions, report, _ = _solve(simulator, start, velocity, parameters, body_start, inverse_step)
    return positions, report


def _solve(simulator, start, velocity, parameters, body_start, inverse_step):
    require_float64("the cloth simulator")
    check_concrete("the cloth simulator", start, velocity, parameters, body_start, inverse_step)
    _validate(simulator, start, velocity, parameters, body_start)
    step = TimeStep(start, velocity, inverse_step)
    objective = StepObjective(simulator, parameters, step, body_start)
    x0 = np.asarray(start)
    _check_start(x0, objective)
    solution = minimize(objective, x0, simulator.newton, progress=simulator.progress)
    x = solution.positions
    crossings = _count_intersections(x, objective)
    report = Report(
        result=jnp.asarray(int(solution.result)),
        iterations=jnp.asarray(solution.iterations),
        step_size=jnp.asarray(solution.step_size),
        residual=jnp.asarray(solution.residual),
        energy=jnp.asarray(solution.energy),
        smallest_distance=jnp.asarray(objective.smallest_distance(x)),
        self_intersections=jnp.asarray(crossings.self),
        body_intersections=jnp.asarray(crossings.body),
    )
    return jnp.asarray(x), report, (objective, solution.factorization)


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
    mend = "start from a state without intersections, or put the garment on with `dress`"
    crossings = _count_intersections(x0, objective)
    if crossings.self or crossings.body:
        raise InputError(
            f"the start state has {crossings.self} intersections of the cloth with itself and "
            f"{crossings.body} with the body",
            mend=mend,
        )
    thickness = float(objective.simulator.settings.thickness)
    distance = objective.smallest_distance(x0)
    if distance <= thickness:
        raise InputError(
            f"the start state has a pair at {distance * 1e3:.4f} mm, at or below the thickness "
            f"of {thickness * 1e3:.4f} mm",
            mend=mend,
        )


def _validate(simulator, start, velocity, parameters: Parameters, body_start) -> None:
    n, b = simulator.vertex_count, len(simulator.body_areas)
    expected = {
        "start positions": (start, (n, 3)),
        "start velocities": (velocity, (n, 3)),
        "body vertices": (parameters.body_vertices, (b, 3)),
        "body vertices at the start": (body_start, (b, 3)),
        "pin targets": (parameters.pin_targets, (len(simulator.cloth.pins), 3)),
    }
    for name, (array, shape) in expected.items():
        if array.shape != shape:
            raise InputError(f"{name} have shape {array.shape}, expected {shape}")
    for path, leaf in jax.tree_util.tree_leaves_with_path((start, velocity, parameters)):
        if not np.all(np.isfinite(np.asarray(leaf))):
            raise InputError(
                "a number is not finite", where=f"simulation input {jax.tree_util.keystr(path)}"
            )


def _forward(simulator, start, velocity, parameters, body_start, inverse_step):
    positions, report, kept = _solve(
        simulator, start, velocity, parameters, body_start, inverse_step
    )
    residuals = (positions, start, velocity, parameters, body_start, inverse_step, _Kept(kept))
    return (positions, report), residuals


def _backward(simulator, residuals, cotangents):
    positions, start, velocity, parameters, body_start, inverse_step, kept = residuals
    objective, factorization = kept.value
    cotangent = np.asarray(cotangents[0])
    adjoint = solve_adjoint(objective, np.asarray(positions), cotangent, factorization)
    return mixed_product(
        objective,
        jnp.asarray(adjoint),
        positions,
        (start, velocity, parameters, body_start, inverse_step),
    )


advance.defvjp(_forward, _backward)


def solve_adjoint(objective, positions, cotangent, factorization) -> np.ndarray:
    """H^-1 times the cotangent with the exact Hessian (S2.5, S2.8).

    Returns NaN, with a warning, where the solve fails: a derivative that does not exist must not
    pass as a number.
    """
    if not np.any(cotangent):
        return np.zeros_like(cotangent)
    reason = "the forward solve kept no factorization"
    if factorization is not None:
        solved = conjugate_gradient(
            hessian_operator(objective, positions),
            np.asarray(cotangent, np.float64).ravel(),
            factorization,
            tolerance=_ADJOINT_TOLERANCE,
            iteration_limit=_ADJOINT_LIMIT,
        )
        if solved.converged:
            return solved.solution.reshape(positions.shape)
        if solved.smallest_curvature <= 0.0:
            reason = Result.INDEFINITE_HESSIAN.message
        else:
            reason = (
                f"conjugate gradients reached a relative residual of "
                f"{solved.relative_residual:.1e} in {solved.iterations} iterations"
            )
    warnings.warn(
        f"the adjoint solve failed and the gradient is NaN: {reason}",
        AdjointWarning,
        stacklevel=2,
    )
    return np.full_like(cotangent, np.nan)


Inputs = tuple[Array, Array, Parameters, Array, Array]


def mixed_product(
    objective: StepObjective,
    adjoint: Float[Array, "n 3"],
    positions: Float[Array, "n 3"],
    inputs: Inputs,
) -> Inputs:
    """Minus the adjoint times the derivative of the gradient in every input (S2.7, S2.9).

    Each energy is compiled apart, like the pieces of the forward solve.

    Args:
        adjoint: H^-1 times the cotangent.
        positions: the solution.
        inputs: start, velocity, parameters, body_start and inverse_step.

    Returns:
        Cotangents of the inputs.
    """
    simulator = objective.simulator
    padding = simulator.padding
    start, velocity, parameters, body_start, inverse_step = inputs
    step = padding.step(TimeStep(start, velocity, inverse_step))
    padded = (
        step.start,
        step.velocity,
        padding.parameters(parameters),
        padding.body(np.asarray(body_start)),
        inverse_step,
    )
    x = np.asarray(positions)
    fixed = (
        padding.vectors(np.asarray(adjoint)),
        padding.positions(x),
        padding.cloth,
        padding.body(np.asarray(simulator.body_areas)),
        simulator.settings,
    )
    terms = objective.terms(objective.contacts(x))
    parts = [_mixed(term.energy, padded, *fixed, *pairs) for term, pairs in terms]
    found = jax.tree.map(lambda *leaves: -sum(leaves[1:], leaves[0]), *parts)
    n, b = len(x), len(body_start)
    return found[0][:n], found[1][:n], padding.cut(found[2], parameters), found[3][:b], found[4]


@functools.partial(jax.jit, static_argnums=0)
def _mixed(energy, inputs: Inputs, adjoint, positions, cloth, body_areas, settings, *pairs):
    """Gradient in the inputs of the force along the adjoint."""

    def work(inputs: Inputs):
        start, velocity, parameters, body_start, inverse_step = inputs
        step = TimeStep(start, velocity, inverse_step)
        frame = make_frame(parameters, cloth, step, body_start, body_areas, settings)

        def along(x):
            return energy(x, parameters, cloth, frame, *pairs)

        return jax.jvp(along, (positions,), (adjoint,))[1]

    return jax.grad(work)(inputs)
