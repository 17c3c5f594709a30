"""The cost of a drape, and its quadratic model in the unknowns.

Outlines of the drawn garment against outlines of the masks, and the prior. The unknowns are the
pattern and the two stiffnesses, as one vector; colours stay as they are.
"""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Parameters
from dress_jax.optimisation.gauss_newton.normal_equations import (
    Model,
    add,
    mean_square_model,
    outline_cost,
    outline_model,
    prior_model,
)
from dress_jax.optimisation.gauss_newton.options import GaussNewtonOptions
from dress_jax.optimisation.gauss_newton.outline import (
    Crossings,
    Outline,
    Rows,
    find_outline,
    outline_rows,
)
from dress_jax.optimisation.gauss_newton.prior import Quadratic, edge_strain_matrix
from dress_jax.optimisation.problem import FitProblem
from dress_jax.optimisation.state import Unknowns
from dress_jax.pattern import Discretization, edge_lengths, pattern_parameters, rest_positions
from dress_jax.pattern.parameters import EdgeTable, PatternParameters
from dress_jax.render.cameras import Camera, CameraKind
from dress_jax.render.contours import find_contour
from dress_jax.render.mesh import RenderMesh
from dress_jax.sim.sensitivity import static_sensitivity

Vector = Float[np.ndarray, " k"]


@dataclasses.dataclass(frozen=True, eq=False)
class Reference:
    """What every step of a fit compares with; made once by `make_reference`.

    Attributes:
        outlines: of the masks.
        prior: around the initial pattern.
    """

    outlines: list[Outline]
    prior: Quadratic


@dataclasses.dataclass(frozen=True, eq=False)
class Measurement:
    """The cost of a drape and what its model is made of.

    Attributes:
        cost: see `GaussNewtonOptions`.
        outline: root mean square distance of the outlines [m].
        unfinished: contours that could not be followed.
        rows: distances of the outlines.
        seams: changes of length differences [m].
    """

    cost: float
    outline: float
    unfinished: int
    rows: Rows
    seams: Float[np.ndarray, " stitches"]


def as_vector(unknowns: Unknowns) -> Vector:
    """Corners [m], control points [chord lengths], logarithms of stiffness factors."""
    pattern = unknowns.pattern
    parts = (pattern.vertices, pattern.controls, unknowns.log_stiffness)
    return np.concatenate([np.asarray(part).ravel() for part in parts])


def from_vector(vector: Vector, like: Unknowns) -> Unknowns:
    """The inverse of `as_vector`; colours are those of `like`."""
    pattern, log_stiffness = _split(jnp.asarray(vector), like.pattern)
    return Unknowns(pattern=pattern, log_stiffness=log_stiffness, colors=like.colors)


def _split(vector: Array, like: PatternParameters) -> tuple[PatternParameters, Array]:
    corners = like.vertices.size
    controls = corners + like.controls.size
    pattern = PatternParameters(
        vertices=vector[:corners].reshape(like.vertices.shape),
        controls=vector[corners:controls].reshape(like.controls.shape),
    )
    return pattern, vector[controls:]


def step_limits(unknowns: Unknowns, options: GaussNewtonOptions) -> Vector:
    """The largest change of each unknown in one step."""
    return np.concatenate(
        [
            np.full(unknowns.pattern.vertices.size, options.longest_step),
            np.full(unknowns.pattern.controls.size, options.longest_control_step),
            np.full(unknowns.log_stiffness.size, options.longest_stiffness_step),
        ]
    )


def make_reference(problem: FitProblem) -> Reference:
    """Outlines of the images, and the prior."""
    observation = problem.observation
    masks, valid = np.asarray(observation.mask), np.asarray(observation.valid) > 0.0
    outlines = [find_outline(m, v) for m, v in zip(masks, valid, strict=True)]
    return Reference(outlines, _prior(problem))


def _prior(problem: FitProblem) -> Quadratic:
    options = problem.options.gauss_newton
    start = pattern_parameters(problem.pattern)
    edges = problem.tables.edges
    strain = edge_strain_matrix(
        np.asarray(start.vertices),
        np.asarray(edges.vertices),
        np.asarray(edges.panel),
        shape_scale=options.shape_scale,
        size_scale=options.size_scale,
    )
    controls, factors = start.controls.size, 2
    corners = np.kron(strain, np.eye(2))  # x and y alike
    rest = np.concatenate(
        [
            np.full(controls, 2.0 / (controls * options.control_scale**2)),
            np.full(factors, 1.0 / options.stiffness_scale**2),
        ]
    )
    matrix = np.zeros((len(corners) + len(rest),) * 2)
    matrix[: len(corners), : len(corners)] = corners
    matrix[len(corners) :, len(corners) :] = np.diag(rest)
    center = [np.asarray(start.vertices).ravel(), np.asarray(start.controls).ravel(), np.zeros(2)]
    return Quadratic(np.concatenate(center), matrix)


def measure(
    problem: FitProblem, reference: Reference, unknowns: Unknowns, positions: Array
) -> Measurement:
    """The cost of a drape.

    Args:
        problem: what is fitted.
        reference: of the problem.
        unknowns: pattern and stiffnesses.
        positions: their drape [m], (n, 3).
    """
    options, tables = problem.options.gauss_newton, problem.tables
    cameras = problem.observation.cameras
    garment = replace(tables.garment, positions=positions)
    contours = jax.tree.map(np.asarray, _contours(cameras, garment, tables.occluder))
    valid = np.asarray(problem.observation.valid) > 0.0
    drawn = []
    for view in range(problem.observation.view_count):
        used = contours.used[view].copy()
        at = np.round(contours.point[view][used]).astype(int)
        used[used] = valid[view][
            np.clip(at[:, 1], 0, valid.shape[1] - 1), np.clip(at[:, 0], 0, valid.shape[2] - 1)
        ]
        fields = (contours.point, contours.vertical, contours.vertices, contours.slope)
        drawn.append(Crossings(*(np.asarray(field[view][used]) for field in fields)))
    metres = _metres_per_pixel(cameras, np.mean(np.asarray(positions), axis=0))
    rows = outline_rows(reference.outlines, drawn, metres, len(positions))
    seams = np.asarray(
        _seam_changes(as_vector(unknowns), unknowns.pattern, tables.edges, *_seam_data(problem))
    )
    cost = outline_cost(rows, scale=options.outline_scale, limit=options.robust)
    cost += reference.prior.value(as_vector(unknowns))
    cost += 0.5 * float(np.mean((seams / options.seam_scale) ** 2)) if len(seams) else 0.0
    return Measurement(
        cost=cost,
        outline=math.sqrt(float(np.sum(rows.weight * rows.residual**2))),
        unfinished=int(contours.unfinished.sum()),
        rows=rows,
        seams=seams,
    )


def make_model(
    problem: FitProblem,
    reference: Reference,
    unknowns: Unknowns,
    positions: Array,
    measurement: Measurement,
    parameters: Parameters,
) -> Model:
    """The quadratic model of the cost around a drape.

    Args:
        problem: what is fitted.
        reference: of the problem.
        unknowns: pattern and stiffnesses.
        positions: their drape [m], (n, 3).
        measurement: of the drape.
        parameters: of the drape.

    Raises:
        LinearSolveError: the drape is no stable equilibrium, so it has no derivative.
    """
    options, tables = problem.options.gauss_newton, problem.tables
    at = as_vector(unknowns)
    seam_data = (unknowns.pattern, tables.edges, *_seam_data(problem))
    directions = _parameter_directions(at, unknowns.pattern, problem.discretization, parameters)
    # A copy, as for the drapes; see `draping`.
    simulator = dataclasses.replace(problem.simulator)
    sensitivity = static_sensitivity(simulator, parameters, np.asarray(positions), directions)
    return add(
        outline_model(
            measurement.rows,
            sensitivity.reshape(-1, len(at)),
            scale=options.outline_scale,
            limit=options.robust,
        ),
        prior_model(reference.prior, at),
        mean_square_model(
            measurement.seams / options.seam_scale,
            np.asarray(_seam_jacobian(at, *seam_data)) / options.seam_scale,
        ),
    )


@jax.jit
def _contours(cameras: Camera, garment: RenderMesh, occluder: RenderMesh | None):
    return jax.lax.map(lambda camera: find_contour(camera, garment, occluder), cameras)


def _metres_per_pixel(cameras: Camera, center: Float[np.ndarray, "3"]) -> Float[np.ndarray, " v"]:
    """Size of a pixel at the garment's distance, for every view (host)."""
    scale = np.asarray(cameras.scale, np.float64).mean(axis=-1)
    if cameras.kind is CameraKind.ORTHOGRAPHIC:
        return 1.0 / scale
    toward = np.asarray(cameras.rotation, np.float64)[:, 2]
    depth = np.sum(toward * (np.asarray(cameras.position, np.float64) - center), axis=1)
    return depth / scale


def _seam_data(problem: FitProblem) -> tuple[Int[np.ndarray, "s 2"], Array]:
    return problem.tables.stitch_edges, problem.tables.seam_ratios


@jax.jit
def _seam_changes(
    vector: Array,
    like: PatternParameters,
    edges: EdgeTable,
    stitch_edges: Int[Array, "s 2"],
    ratios: Float[Array, " s"],
) -> Float[Array, " s"]:
    """First side of every seam minus the length that the design gives it [m]."""
    lengths = edge_lengths(_split(vector, like)[0], edges)
    return lengths[stitch_edges[:, 0]] - ratios * lengths[stitch_edges[:, 1]]


_seam_jacobian = jax.jit(jax.jacfwd(_seam_changes))


@jax.jit
def _parameter_directions(
    vector: Array, like: PatternParameters, discretization: Discretization, parameters: Parameters
) -> dict[str, Array]:
    """Derivatives of the drape's parameters in every unknown, leading axis: unknowns."""

    def rest(vector: Array) -> Array:
        return rest_positions(_split(vector, like)[0], discretization)

    count = vector.shape[0]
    stretching = jnp.zeros(count).at[count - 2].set(parameters.stretching_stiffness)
    bending = jnp.zeros(count).at[count - 1].set(parameters.bending_stiffness)
    return {
        "rest_positions": jnp.moveaxis(jax.jacfwd(rest)(vector), -1, 0),
        "stretching_stiffness": stretching,
        "bending_stiffness": bending,
    }
