"""What the observations say about a fitted pattern and fabric, and what they leave open.

Around a drape at rest the observations determine the unknowns as well as their information matrix,

    I = sum over kinds of  N J^T W J / s^2

says, with the sensitivities J of the differences, s the standard deviation of what remains of
them, and N how many of them are independent: neighbouring pixels see the same fold, so a piece of
outline or surface of `CORRELATION` counts once. Before any observation, lengths are taken to be
known within `Before`. Intervals come from the sum of both; where they are about as wide as before,
the pictures say nothing, and the fit has kept what it began with.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float

from dress_jax.optimisation.draping import fitted_parameters
from dress_jax.optimisation.gauss_newton.information import (
    deviations,
    least_known,
    make_knowledge,
    told,
    with_rows,
)
from dress_jax.optimisation.gauss_newton.model import (
    Reference,
    drape_sensitivity,
    make_reference,
    measure,
    metres_per_pixel,
    seam_slopes,
)
from dress_jax.optimisation.gauss_newton.prior import edge_strain_matrix
from dress_jax.optimisation.gauss_newton.residuals import Observed, Residuals
from dress_jax.optimisation.gauss_newton.vector import PIN_SHIFT, as_vector, split
from dress_jax.optimisation.problem import FitProblem, rest_shape
from dress_jax.optimisation.state import Unknowns
from dress_jax.pattern import EdgeTable, edge_lengths
from dress_jax.pattern.parameters import PatternParameters
from dress_jax.pattern.symmetry import Symmetry, validated

CORRELATION = 0.05  # [m]; folds are a few centimetres wide
_LEAST_PIXELS = 0.3  # standard deviation of an outline that fits perfectly [px]
_LEAST = {Observed.NORMALS: 0.05, Observed.SCAN: 1e-3, Observed.LANDMARKS: 2e-3}  # likewise
_DIRECTIONS = 6


@dataclasses.dataclass(frozen=True)
class Before:
    """Standard deviations of what is known without any observation.

    Attributes:
        strain: change of an edge's length over its length.
        control: way of a control point [chord lengths].
        fabric: of the fabric's unknowns; log 2.7 is one.
        pin: displacement of the pins [m].
        seam: change of a seam's length difference between its two sides [m].
    """

    strain: float = 0.1
    control: float = 0.05
    fabric: float = 1.0
    pin: float = 0.03
    seam: float = 5e-3


@dataclasses.dataclass(frozen=True, eq=False)
class Uncertainty:
    """How well a fit is determined.

    Attributes:
        lengths: of the edges [m], (E,).
        length_deviation: their standard deviations [m], (E,).
        length_told: share of what was unknown of each that the observations tell, in [0, 1], (E,).
        fabric: values of the fabric's unknowns, (s,).
        fabric_deviation: their standard deviations, (s,).
        fabric_told: as for lengths, (s,).
        directions: the combinations of lengths that are known least, each one standard deviation
            long [m], (d, E).
        ways: the most likely changes of the unknowns along them, (d, k).
        noise: standard deviation of what remains of the differences, by kind [m, or none].
        independent: how many of them count as independent, by kind.
    """

    lengths: Float[np.ndarray, " E"]
    length_deviation: Float[np.ndarray, " E"]
    length_told: Float[np.ndarray, " E"]
    fabric: Float[np.ndarray, " s"]
    fabric_deviation: Float[np.ndarray, " s"]
    fabric_told: Float[np.ndarray, " s"]
    directions: Float[np.ndarray, "d E"]
    ways: Float[np.ndarray, "d k"]
    noise: dict[Observed, float]
    independent: dict[Observed, float]


def find_uncertainty(
    problem: FitProblem,
    unknowns: Unknowns,
    positions: Array,
    *,
    before: Before | None = None,
) -> Uncertainty:
    """How well observations determine the unknowns around their drape.

    Rules of the design are not taken into account.

    Args:
        problem: what was fitted.
        unknowns: of the drape.
        positions: a drape at rest [m], (n, 3).
        before: what is known without them; default `Before()`.

    Raises:
        LinearSolveError: the drape is no stable equilibrium, so it has no derivative.
    """
    before = Before() if before is None else before
    reference = make_reference(problem)
    felt = measure(problem, reference, reference.prior, unknowns, positions).felt
    rest = rest_shape(problem, unknowns.pattern)
    parameters = fitted_parameters(problem, rest, unknowns.log_stiffness, unknowns.pin_shift)
    sensitivity = drape_sensitivity(problem, reference, unknowns, positions, parameters)
    information = np.zeros((len(reference.felt),) * 2)
    noise: dict[Observed, float] = {}
    independent: dict[Observed, float] = {}
    for own in felt:
        if not len(own.value):
            continue
        deviation = _remaining(problem, own, positions)
        count = _independent(problem, reference, own, positions)
        information += own.model(sensitivity).matrix * own.scale**2 * count / deviation**2
        noise[own.kind], independent[own.kind] = deviation, count

    knowledge = make_knowledge(
        reference.felt, _known_before(problem, unknowns, before), information
    )
    lengths, slopes = _lengths(problem, unknowns)
    fabric = np.asarray(unknowns.log_stiffness)
    own = np.zeros((len(fabric), slopes.shape[1]))
    own[:, -PIN_SHIFT - len(fabric) : -PIN_SHIFT] = np.eye(len(fabric))
    directions, ways = least_known(knowledge, slopes, _DIRECTIONS)
    return Uncertainty(
        lengths=lengths,
        length_deviation=deviations(knowledge, slopes),
        length_told=told(knowledge, slopes),
        fabric=fabric,
        fabric_deviation=deviations(knowledge, own),
        fabric_told=told(knowledge, own),
        directions=directions,
        ways=ways,
        noise=noise,
        independent=independent,
    )


def _remaining(problem: FitProblem, felt: Residuals, positions: Array) -> float:
    """Standard deviation of one component of what remains of the differences."""
    freedoms = 2 if felt.kind is Observed.NORMALS else felt.value.shape[1]
    square = float(np.sum(felt.weight * np.sum(felt.value**2, axis=1)) / np.sum(felt.weight))
    if felt.kind is Observed.OUTLINES:
        least = _LEAST_PIXELS * float(metres_per_pixel(problem, positions).mean())
    else:
        least = _LEAST[felt.kind]
    return max(float(np.sqrt(square / freedoms)), least)


def _independent(
    problem: FitProblem, reference: Reference, felt: Residuals, positions: Array
) -> float:
    """How many differences of a kind are independent."""
    x = np.asarray(positions, np.float64)
    if felt.kind is Observed.LANDMARKS:
        return float(len(felt.value))
    if felt.kind is Observed.OUTLINES:
        metres = np.resize(metres_per_pixel(problem, positions), len(reference.targets))
        lengths = np.array([target.length for target in reference.targets])
        # A slanted outline crosses rows and columns: 4 / pi crossings per pixel of its length.
        return max(float(np.sum(lengths * metres)) * np.pi / 4.0 / CORRELATION, 1.0)
    corners = x[np.asarray(problem.discretization.faces)]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * float(np.linalg.norm(normal, axis=1).sum())
    return max(area / CORRELATION**2, 1.0)


def _known_before(
    problem: FitProblem, unknowns: Unknowns, before: Before
) -> Float[np.ndarray, "k k"]:
    """Precision of the unknowns without observations."""
    edges, pattern = problem.tables.edges, unknowns.pattern
    count = len(np.asarray(edges.panel))
    strain = count * edge_strain_matrix(
        np.asarray(pattern.vertices),
        np.asarray(edges.vertices),
        np.asarray(edges.panel),
        shape_scale=before.strain,
        size_scale=before.strain,
    )
    # A panel as a whole may lie anywhere in its plane; no length knows of it.
    strain += 1e-6 * np.trace(strain) / len(strain) * np.eye(len(strain))
    precision = scipy.linalg.block_diag(
        np.kron(strain, np.eye(2)),
        np.eye(pattern.controls.size) / before.control**2,
        np.eye(len(np.asarray(unknowns.log_stiffness))) / before.fabric**2,
        np.eye(PIN_SHIFT) / before.pin**2,
    )
    return with_rows(np.asarray(precision), seam_slopes(problem, unknowns), before.seam)


def _lengths(
    problem: FitProblem, unknowns: Unknowns
) -> tuple[Float[np.ndarray, " E"], Float[np.ndarray, "E k"]]:
    """Edge lengths and their derivatives in the unknowns [m]."""
    data = (unknowns.pattern, problem.tables.symmetry, problem.tables.edges)
    lengths, slopes = _lengths_and_slopes(jnp.asarray(as_vector(unknowns)), *data)
    return np.asarray(lengths), np.asarray(slopes)


@jax.jit
def _lengths_and_slopes(
    vector: Array, like: PatternParameters, symmetry: Symmetry | None, edges: EdgeTable
) -> tuple[Float[Array, " E"], Float[Array, "E k"]]:
    def lengths(vector: Array) -> Array:
        return edge_lengths(validated(split(vector, like)[0], symmetry), edges)

    return lengths(vector), jax.jacfwd(lengths)(vector)
