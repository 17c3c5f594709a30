"""The cost of a drape, and its quadratic model in the unknowns.

Outlines of the drawn garment against outlines of the masks, normals against normals, and the prior.
The unknowns are the pattern, the stiffnesses and the pins, as one vector; colours stay as they are.
"""

import dataclasses
import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
import scipy.sparse
from jaxtyping import Array, Float, Int

from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import STRETCHING_LEAVES, Parameters
from dress_jax.optimisation.draping import fitted_parameters, initial_unknowns
from dress_jax.optimisation.fabric_freedom import FabricTable, likely_alike, with_fabric
from dress_jax.optimisation.gauss_newton.guidance import Pull
from dress_jax.optimisation.gauss_newton.landmark_rows import rows_in_pictures, rows_in_space
from dress_jax.optimisation.gauss_newton.normal_equations import (
    add,
    along_rows,
    mean_square_model,
    prior_model,
)
from dress_jax.optimisation.gauss_newton.normals import (
    choose_samples,
    normal_jacobian,
    normal_rows,
)
from dress_jax.optimisation.gauss_newton.outline import (
    Drawn,
    Target,
    outline_rows,
)
from dress_jax.optimisation.gauss_newton.prior import Quadratic, edge_strain_matrix
from dress_jax.optimisation.gauss_newton.quadratic_model import Model
from dress_jax.optimisation.gauss_newton.residuals import (
    Observed,
    Residuals,
    length_residuals,
)
from dress_jax.optimisation.gauss_newton.scan_rows import scan_rows
from dress_jax.optimisation.gauss_newton.vector import (
    PIN_SHIFT,
    Vector,
    as_vector,
    felt_directions,
    split,
)
from dress_jax.optimisation.problem import FitProblem, rest_shape
from dress_jax.optimisation.state import Unknowns
from dress_jax.pattern import Discretization, edge_lengths, pattern_parameters, rest_positions
from dress_jax.pattern.parameters import EdgeTable, PatternParameters
from dress_jax.pattern.symmetry import Symmetry, validated
from dress_jax.render.cameras import CameraKind
from dress_jax.render.contours import Contour, find_contours
from dress_jax.render.mesh import RenderMesh, join_meshes
from dress_jax.sim.sensitivity import static_sensitivity


@dataclasses.dataclass(frozen=True, eq=False)
class Reference:
    """What every step of a fit compares with; made once by `make_reference`.

    Attributes:
        targets: the masks, views in turn, part by part.
        prior: around the initial pattern.
        felt: basis of the directions that the drape can feel, (r, k).
    """

    targets: list[Target]
    prior: Quadratic
    felt: Float[np.ndarray, "r k"]


@dataclasses.dataclass(frozen=True, eq=False)
class Measurement:
    """The cost of a drape and what its model is made of.

    Attributes:
        cost: see `GaussNewtonOptions`.
        outline: root mean square distance of the outlines [m].
        unfinished: contours that could not be followed.
        felt: differences that the drape can feel, kind by kind.
        seams: changes of length differences [m].
    """

    cost: float
    outline: float
    unfinished: int
    felt: tuple[Residuals, ...]
    seams: Float[np.ndarray, " stitches"]


def make_reference(problem: FitProblem) -> Reference:
    """The masks on the host, and the prior."""
    observation = problem.observation
    # Views of the first part, then those of the next.
    masks = np.moveaxis(np.asarray(observation.parts), -1, 0).reshape(
        -1, *observation.mask.shape[1:]
    )
    valid = np.tile(np.asarray(observation.valid) > 0.0, (observation.parts.shape[-1], 1, 1))
    return Reference(
        targets=[Target(*pair) for pair in zip(masks, valid, strict=True)],
        prior=_prior(problem),
        felt=felt_directions(
            pattern_parameters(problem.pattern),
            problem.tables.symmetry,
            len(problem.tables.fabric.names),
        ),
    )


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
    controls = start.controls.size
    corners = np.kron(strain, np.eye(2))  # x and y alike
    matrix = scipy.linalg.block_diag(
        corners,
        np.eye(controls) * 2.0 / (controls * options.control_scale**2),
        likely_alike(problem.tables.fabric, options.stiffness_scale, options.fabric_scale),
        np.eye(PIN_SHIFT) / options.pin_scale**2,
    )
    return Quadratic(as_vector(initial_unknowns(problem)), np.asarray(matrix))


def measure(
    problem: FitProblem,
    reference: Reference,
    prior: Quadratic,
    unknowns: Unknowns,
    positions: Array,
) -> Measurement:
    """The cost of a drape.

    Args:
        problem: what is fitted.
        reference: of the problem.
        prior: of the problem, around some centre.
        unknowns: pattern and stiffnesses.
        positions: their drape [m], (n, 3).
    """
    options = problem.options.gauss_newton
    felt, unfinished = _compare(problem, reference, positions)
    seams = np.asarray(_seam_changes(as_vector(unknowns), unknowns.pattern, *_seam_data(problem)))
    cost = sum(residuals.cost for residuals in felt) + prior.value(as_vector(unknowns))
    cost += 0.5 * float(np.mean((seams / options.seam_scale) ** 2)) if len(seams) else 0.0
    outline = felt[0]
    return Measurement(
        cost=cost,
        outline=math.sqrt(float(np.sum(outline.weight * outline.value[:, 0] ** 2))),
        unfinished=unfinished,
        felt=felt,
        seams=seams,
    )


def pulls(problem: FitProblem, reference: Reference, positions: Array) -> list[Pull]:
    """What the observations ask of a state's positions (`guidance`)."""
    return [residuals.pull() for residuals in _compare(problem, reference, positions)[0]]


def make_model(
    problem: FitProblem,
    reference: Reference,
    prior: Quadratic,
    unknowns: Unknowns,
    positions: Array,
    measurement: Measurement,
    parameters: Parameters,
) -> Model:
    """The quadratic model of the cost around a drape.

    Args:
        problem: what is fitted.
        reference: of the problem.
        prior: of the problem, around some centre.
        unknowns: pattern and stiffnesses.
        positions: their drape [m], (n, 3).
        measurement: of the drape.
        parameters: of the drape.

    Raises:
        LinearSolveError: the drape is no stable equilibrium, so it has no derivative.
    """
    options = problem.options.gauss_newton
    at = as_vector(unknowns)
    sensitivity = drape_sensitivity(problem, reference, unknowns, positions, parameters)
    felt = add(*(residuals.model(sensitivity) for residuals in measurement.felt))
    return add(
        along_rows(felt, reference.felt),
        prior_model(prior, at),
        mean_square_model(
            measurement.seams / options.seam_scale,
            seam_slopes(problem, unknowns) / options.seam_scale,
        ),
    )


def drape_sensitivity(
    problem: FitProblem,
    reference: Reference,
    unknowns: Unknowns,
    positions: Array,
    parameters: Parameters,
) -> Float[np.ndarray, "n3 r"]:
    """Derivatives of a drape's flattened positions along `Reference.felt`.

    Raises:
        LinearSolveError: the drape is no stable equilibrium.
    """
    directions = _parameter_directions(
        as_vector(unknowns), reference.felt, *_direction_data(problem, unknowns)
    )
    # A copy, as for the drapes; see `optimisation.trial.try_unknowns`.
    simulator = dataclasses.replace(problem.simulator)
    sensitivity = static_sensitivity(simulator, parameters, np.asarray(positions), directions)
    return sensitivity.reshape(-1, len(reference.felt))


def seam_slopes(problem: FitProblem, unknowns: Unknowns) -> Float[np.ndarray, "stitches k"]:
    """Derivatives of the seams' changes in the unknowns [m]."""
    data = _seam_data(problem)
    return np.asarray(_seam_jacobian(as_vector(unknowns), unknowns.pattern, *data))


def _compare(
    problem: FitProblem, reference: Reference, positions: Array
) -> tuple[tuple[Residuals, ...], int]:
    """A state against the observations, outlines first; and contours without an end."""
    tables, cameras = problem.tables, problem.observation.cameras
    garment = replace(tables.garment, positions=positions)
    whole = jax.tree.map(np.asarray, find_contours(cameras, garment, tables.occluder))
    contours = [whole]
    if tables.parts:
        contours = [
            jax.tree.map(np.asarray, _part_contours(problem, *part, positions))
            for part in tables.parts
        ]
    found = [
        _outlines(problem, reference, contours, positions),
        _normals(problem, garment, whole.face),
        _scan(problem, positions),
        *_landmarks(problem, positions),
    ]
    return tuple(f for f in found if f is not None), int(whole.unfinished.sum())


def _outlines(
    problem: FitProblem, reference: Reference, contours: list[Contour], positions: Array
) -> Residuals:
    """Distances of the outlines; none where masks do not count."""
    options = problem.options.gauss_newton
    views = range(problem.observation.view_count)
    drawn = [_drawn(own, view) for own in contours for view in views]
    metres = np.tile(metres_per_pixel(problem, positions), len(contours))
    if "mask" not in problem.options.active_weights:
        drawn, metres = [], metres[:0]
    rows = outline_rows(reference.targets[: len(drawn)], drawn, metres, len(positions))
    return length_residuals(
        Observed.OUTLINES, *rows, scale=options.outline_scale, limit=options.robust
    )


def _part_contours(
    problem: FitProblem, own: RenderMesh, others: RenderMesh, positions: Array
) -> Contour:
    """Outlines of one garment of an outfit, hidden by the others and the body.

    Where another garment hides it, its outline is that garment's, and moves with that.
    """
    hiding = replace(others, positions=positions)
    if problem.tables.occluder is not None:
        corners, faces, adjacency = join_meshes(hiding, problem.tables.occluder)
        hiding = RenderMesh(
            positions=corners,
            faces=faces,
            adjacency=adjacency,
            colors=jnp.ones_like(corners),
            attributes=jnp.zeros((len(corners), 0)),
        )
    return find_contours(problem.observation.cameras, replace(own, positions=positions), hiding)


def _scan(problem: FitProblem, positions: Array) -> Residuals | None:
    """Distances of the scan, if there is one."""
    if problem.scan is None:
        return None
    options, faces = problem.options.gauss_newton, np.asarray(problem.discretization.faces)
    rows = scan_rows(problem.scan, np.asarray(positions, np.float64), faces)
    return length_residuals(
        Observed.SCAN, *rows, scale=options.scan_scale, limit=options.scan_robust
    )


def _landmarks(problem: FitProblem, positions: Array) -> list[Residuals]:
    """Differences of the landmarks in space, and of those in pictures."""
    if not problem.landmarks:
        return []
    options, at = problem.options.gauss_newton, np.asarray(positions, np.float64)
    data = (problem.landmarks, problem.discretization, at)
    rows = rows_in_space(*data), rows_in_pictures(*data, problem.observation.cameras)
    return [
        Residuals(
            Observed.LANDMARKS,
            own.value,
            np.full(len(own.value), 1.0 / len(own.value)),
            functools.partial(_same, own.jacobian),
            options.landmark_scale,
            options.landmark_robust,
        )
        for own in rows
        if len(own.value)
    ]


def _same(jacobian: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
    return jacobian


def _normals(
    problem: FitProblem, garment: RenderMesh, face: Int[np.ndarray, "v h w"]
) -> Residuals | None:
    """Differences of the normals, unless their weight is zero or nothing is seen of both."""
    if "normal" not in problem.options.active_weights:
        return None
    observation, options = problem.observation, problem.options.gauss_newton
    samples = choose_samples(
        face,
        np.asarray(observation.normal),
        np.asarray(observation.garment),
        options.normal_stride,
    )
    if not samples.used.any():
        return None
    rows = normal_rows(observation.cameras, garment, samples)
    return Residuals(
        Observed.NORMALS,
        rows.residual.reshape(-1, 3),
        rows.weight.ravel(),
        functools.partial(normal_jacobian, observation.cameras, garment, samples),
        options.normal_scale,
        options.normal_robust,
    )


def predict_displacement(
    problem: FitProblem,
    unknowns: Unknowns,
    positions: Float[np.ndarray, "n 3"],
    change: Vector,
) -> Float[np.ndarray, "n 3"]:
    """How a drape is expected to move when its unknowns change [m], to first order.

    Args:
        problem: what is fitted.
        unknowns: of the drape.
        positions: the drape [m].
        change: of `as_vector(unknowns)`.

    Raises:
        LinearSolveError: the drape is no stable equilibrium.
    """
    rest = rest_shape(problem, unknowns.pattern)
    parameters = fitted_parameters(problem, rest, unknowns.log_stiffness, unknowns.pin_shift)
    along = _parameter_change(as_vector(unknowns), change, *_direction_data(problem, unknowns))
    simulator = dataclasses.replace(problem.simulator)
    directions = {name: value[None] for name, value in along.items()}
    return static_sensitivity(simulator, parameters, positions, directions)[..., 0]


def _drawn(contours: Contour, view: int) -> Drawn:
    """One view's outline, without padding (host)."""
    used = np.asarray(contours.used[view])

    def kept(field: Array) -> np.ndarray:
        return np.asarray(field[view])[used]

    return Drawn(
        along=kept(contours.along),
        line=kept(contours.line),
        before=kept(contours.before),
        vertical=kept(contours.vertical),
        vertices=kept(contours.vertices),
        slope=kept(contours.slope),
        inside=np.asarray(contours.face[view]) >= 0,
    )


def metres_per_pixel(problem: FitProblem, positions: Array) -> Float[np.ndarray, " v"]:
    """Size of a pixel at the garment's distance, for every view (host)."""
    cameras, center = problem.observation.cameras, np.mean(np.asarray(positions), axis=0)
    scale = np.asarray(cameras.scale, np.float64).mean(axis=-1)
    if cameras.kind is CameraKind.ORTHOGRAPHIC:
        return 1.0 / scale
    toward = np.asarray(cameras.rotation, np.float64)[:, 2]
    depth = np.sum(toward * (np.asarray(cameras.position, np.float64) - center), axis=1)
    return depth / scale


def _seam_data(
    problem: FitProblem,
) -> tuple[Symmetry | None, EdgeTable, Int[np.ndarray, "s 2"], Array]:
    tables = problem.tables
    return tables.symmetry, tables.edges, tables.stitch_edges, tables.seam_ratios


@jax.jit
def _seam_changes(
    vector: Array,
    like: PatternParameters,
    symmetry: Symmetry | None,
    edges: EdgeTable,
    stitch_edges: Int[Array, "s 2"],
    ratios: Float[Array, " s"],
) -> Float[Array, " s"]:
    """First side of every seam minus the length that the design gives it [m]."""
    lengths = edge_lengths(validated(split(vector, like)[0], symmetry), edges)
    return lengths[stitch_edges[:, 0]] - ratios * lengths[stitch_edges[:, 1]]


_seam_jacobian = jax.jit(jax.jacfwd(_seam_changes))


def _direction_data(problem: FitProblem, unknowns: Unknowns) -> tuple[Any, ...]:
    tables = problem.tables
    data = (problem.discretization, problem.parameters, tables.fabric)
    return unknowns.pattern, tables.symmetry, *data


@jax.jit
def _parameter_directions(vector: Array, directions: Array, *data: Any) -> dict[str, Array]:
    """Derivatives of the drape's parameters along several directions, the leading axis."""
    return jax.vmap(lambda direction: _parameter_change(vector, direction, *data))(directions)


@jax.jit
def _parameter_change(
    vector: Array,
    direction: Array,
    like: PatternParameters,
    symmetry: Symmetry | None,
    discretization: Discretization,
    initial: Parameters,
    fabric: FabricTable,
) -> dict[str, Array]:
    """Derivative of the drape's parameters along one direction of the unknowns."""

    def rest(vector: Array) -> Array:
        return rest_positions(validated(split(vector, like)[0], symmetry), discretization)

    names = [*STRETCHING_LEAVES, "bending_stiffness"]
    if fabric.anisotropy is not None:
        names.append("bending_anisotropy")

    def leaves(log_stiffness: Array) -> dict[str, Array]:
        parameters = with_fabric(initial, log_stiffness, fabric)
        return {name: getattr(parameters, name) for name in names}

    _, way, shift = split(direction, like)
    return {
        "rest_positions": jax.jvp(rest, (vector,), (direction,))[1],
        **jax.jvp(leaves, (split(vector, like)[1],), (way,))[1],
        "pin_targets": jnp.broadcast_to(shift[None, :], initial.pin_targets.shape),
    }
