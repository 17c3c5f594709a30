"""One pattern, one body, one observation: what a fit works on."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from dress_jax.core.errors import InputError
from dress_jax.core.precision import require_float64
from dress_jax.core.pytree import pytree, replace
from dress_jax.energy.cloth import Cloth, Parameters
from dress_jax.loss.area_ratio import panel_areas
from dress_jax.loss.corners import corner_signs
from dress_jax.loss.laplacian import interior_vertices
from dress_jax.loss.seam_length import seam_ratios
from dress_jax.optimisation.fabric_freedom import FabricTable, make_fabric_table
from dress_jax.optimisation.landmarks import Landmark, check_landmarks
from dress_jax.optimisation.observation import Observation, part_channels
from dress_jax.optimisation.options import FitMethod, FitOptions
from dress_jax.optimisation.parts import assign_parts, merged
from dress_jax.optimisation.scan import Scan
from dress_jax.optimisation.state import DrapedUnknowns
from dress_jax.pattern import (
    Discretization,
    EdgeTable,
    Pattern,
    components,
    pattern_parameters,
    placed_positions,
    rest_positions,
    with_parameters,
)
from dress_jax.pattern.corners import CornerTable, corner_table
from dress_jax.pattern.parameters import PatternParameters
from dress_jax.pattern.rules import Rule
from dress_jax.pattern.symmetry import Symmetry, make_symmetry, validated
from dress_jax.render.mesh import RenderMesh, make_render_mesh
from dress_jax.sim import Simulator


@pytree
class Tables:
    """Arrays that the losses need and that never change.

    Attributes:
        garment: the welded mesh; its positions and colours are placeholders. Its attributes are the
            channels of the parts where masks tell parts apart.
        parts: for every such part its mesh, and everything that may hide it but the body; empty
            where there is one part only.
        occluder: the body as it is drawn, or None.
        cloth: topology of the garment.
        rest_faces: panel vertices of each triangle, (f, 3).
        face_panel: panel of each triangle, (f,).
        component: connected component of each panel, (panels,).
        reference_areas: areas of the panels of the initial pattern [m^2] (S21.11), (panels,).
        edges: corners and controls of every pattern edge.
        stitch_edges: the two edges of each stitch, (stitches, 2).
        seam_ratios: of their lengths in the initial pattern, so that gathers stay, (stitches,).
        reference: the initial pattern, validated (S21.11).
        corners: of all panels.
        corner_signs: on which side they open in the initial pattern, (corners,).
        interior: vertices off the garment's boundary, (n,).
        symmetry: from optimised to validated parameters; None where nothing mirrors anything.
        fabric: what is unknown of the fabric.
    """

    garment: RenderMesh
    parts: tuple[tuple[RenderMesh, RenderMesh], ...]
    occluder: RenderMesh | None
    cloth: Cloth
    rest_faces: Int[np.ndarray, "f 3"]
    face_panel: Int[np.ndarray, " f"]
    component: Int[np.ndarray, " panels"]
    reference_areas: Float[Array, " panels"]
    edges: EdgeTable
    stitch_edges: Int[np.ndarray, "stitches 2"]
    seam_ratios: Float[Array, " stitches"]
    reference: PatternParameters
    corners: CornerTable
    corner_signs: Float[Array, " corners"]
    interior: Bool[np.ndarray, " n"]
    symmetry: Symmetry | None
    fabric: FabricTable


@dataclasses.dataclass(frozen=True, eq=False)
class FitProblem:
    """Host object made by `make_problem`.

    Attributes:
        pattern: the initial pattern.
        discretization: of it.
        simulator: without friction (S9.9).
        parameters: of the first drape; rest positions and stiffnesses are replaced by what is
            fitted, everything else stays.
        observation: what the drape is compared with.
        options: see `FitOptions`.
        colors: vertex colours to begin with, (n, 3).
        tables: constants of the losses.
        scan: of the garment, which Gauss-Newton compares with as well; None without one.
        landmarks: likewise.
        rules: that every pattern keeps.
    """

    pattern: Pattern
    discretization: Discretization
    simulator: Simulator
    parameters: Parameters
    observation: Observation
    options: FitOptions
    colors: Float[np.ndarray, "n 3"]
    tables: Tables
    scan: Scan | None = None
    landmarks: tuple[Landmark, ...] = ()
    rules: tuple[Rule, ...] = ()


def make_problem(
    pattern: Pattern,
    discretization: Discretization,
    simulator: Simulator,
    parameters: Parameters,
    observation: Observation,
    *,
    options: FitOptions | None = None,
    colors: Float[np.ndarray, "n 3"] | None = None,
    occluder: RenderMesh | None = None,
    scan: Scan | None = None,
    landmarks: Sequence[Landmark] = (),
    rules: Sequence[Rule] = (),
) -> FitProblem:
    """Put a fit together and check that its parts fit each other.

    Args:
        pattern: the pattern to begin with.
        discretization: of the same pattern.
        simulator: of the welded garment (`DressedGarment.cloth`), without friction.
        parameters: fabric, pins and body.
        observation: images to fit.
        options: default `FitOptions()`.
        colors: vertex colours to begin with; grey when None.
        occluder: what hides the garment in the images; the simulator's body when None.
        scan: of the garment, from `make_scan`. For a scan alone, leave the weights of the images
            out; the observation is then only drawn for reports.
        landmarks: points of seams and hems whose place is known; Gauss-Newton only.
        rules: design rules; the pattern to begin with is moved to keep them.

    Raises:
        InputError: friction is on, or the parts do not belong together.
    """
    require_float64("make_problem")
    options = FitOptions() if options is None else options
    if simulator.friction:
        raise InputError(
            "friction makes a drape depend on how it came about",
            where="make_problem",
            mend="make the simulator with friction=False",
        )
    if options.method is FitMethod.ADAM and (scan is not None or landmarks):
        raise InputError(
            "Adam does not look at scans and landmarks",
            where="make_problem",
            mend="use Gauss-Newton",
        )
    check_landmarks(landmarks, pattern, observation.view_count)
    start = pattern_parameters(pattern)
    _check(discretization, simulator, parameters, start.vertices.shape[0])
    views = options.views_per_iteration
    if views is not None and views > observation.view_count:
        raise InputError(
            f"views_per_iteration is {views}, the observation has {observation.view_count} views",
            where="fit options",
        )
    count = discretization.vertex_count
    colors = np.full((count, 3), 0.5) if colors is None else np.asarray(colors, np.float64)
    body = np.asarray(parameters.body_vertices)
    if occluder is None and len(body):
        occluder = make_render_mesh(jnp.asarray(body), simulator.body_faces)
    component = components(discretization)
    observation, face_part = _matched_parts(observation, discretization, component)
    garment, part_meshes = _garment_meshes(discretization, face_part, colors)
    stitch_edges = np.asarray(discretization.stitch_edges)
    symmetry = make_symmetry(pattern) if options.symmetrize else None
    reference, corners = validated(start, symmetry), corner_table(discretization)
    rest = rest_positions(reference, discretization)
    tables = Tables(
        garment=garment,
        parts=part_meshes,
        occluder=occluder,
        cloth=simulator.cloth,
        rest_faces=np.asarray(discretization.rest_faces),
        face_panel=np.asarray(discretization.face_panel),
        component=component,
        reference_areas=panel_areas(
            rest,
            np.asarray(discretization.rest_faces),
            np.asarray(discretization.face_panel),
            discretization.panel_count,
        ),
        edges=discretization.edges,
        stitch_edges=stitch_edges,
        seam_ratios=seam_ratios(reference, discretization.edges, stitch_edges),
        reference=reference,
        corners=corners,
        corner_signs=corner_signs(rest, corners),
        interior=interior_vertices(np.asarray(discretization.faces), count),
        symmetry=symmetry,
        fabric=make_fabric_table(
            options.fabric, pattern, simulator.cloth, np.asarray(discretization.face_panel)
        ),
    )
    return FitProblem(
        pattern=pattern,
        discretization=discretization,
        simulator=simulator,
        parameters=parameters,
        observation=observation,
        options=options,
        colors=colors,
        tables=tables,
        scan=scan,
        landmarks=tuple(landmarks),
        rules=tuple(rules),
    )


def _matched_parts(
    observation: Observation,
    discretization: Discretization,
    component: Int[np.ndarray, " panels"],
) -> tuple[Observation, Int[np.ndarray, " f"]]:
    """The observation with as many parts as there are garments to show in them, and the part of
    every triangle (S10.5, S10.6)."""
    placed = np.asarray(
        placed_positions(jnp.asarray(discretization.meshed_positions), discretization)
    )
    owner = component[np.asarray(discretization.panel_of_vertex)]
    count = np.bincount(owner)
    heights = np.bincount(owner, weights=placed[:, 1]) / count
    parts = np.asarray(observation.parts)
    part_of = assign_parts(heights, parts[0])
    if len(heights) == 1 and parts.shape[-1] > 1:
        observation = replace(observation, parts=jnp.asarray(merged(parts)))
    return observation, part_of[component[np.asarray(discretization.face_panel)]]


def _garment_meshes(
    discretization: Discretization,
    face_part: Int[np.ndarray, " f"],
    colors: Float[np.ndarray, "n 3"],
) -> tuple[RenderMesh, tuple[tuple[RenderMesh, RenderMesh], ...]]:
    """The whole garment; and where it has several parts, each of them with what is beside it."""
    faces = np.asarray(discretization.faces)
    nowhere = jnp.zeros((discretization.vertex_count, 3))
    vertex_part = np.zeros(discretization.vertex_count, dtype=np.int32)
    vertex_part[faces] = face_part[:, None]
    garment = make_render_mesh(
        nowhere, faces, colors=jnp.asarray(colors), attributes=part_channels(vertex_part)
    )
    count = int(face_part.max(initial=0)) + 1
    if count == 1:
        return garment, ()
    return garment, tuple(
        (
            make_render_mesh(nowhere, faces[face_part == part]),
            make_render_mesh(nowhere, faces[face_part != part]),
        )
        for part in range(count)
    )


def corner_panels(pattern: Pattern) -> Int[np.ndarray, " V"]:
    """Panel of every corner, in the order of `PatternParameters.vertices` (host)."""
    return np.repeat(np.arange(len(pattern.panels)), [len(p.vertices) for p in pattern.panels])


def validated_pattern(problem: FitProblem, parameters: PatternParameters) -> PatternParameters:
    """The pattern that is draped and compared for some optimised parameters (S4.6, S4.7)."""
    return validated(parameters, problem.tables.symmetry)


def rest_shape(problem: FitProblem, parameters: PatternParameters) -> Float[Array, "P 2"]:
    """Its panel vertices [m]."""
    return rest_positions(validated_pattern(problem, parameters), problem.discretization)


def fitted_pattern(problem: FitProblem, state: DrapedUnknowns) -> Pattern:
    """The problem's pattern with the corners and controls of a state (host)."""
    return with_parameters(problem.pattern, validated_pattern(problem, state.unknowns.pattern))


def _check(
    discretization: Discretization, simulator: Simulator, parameters: Parameters, corners: int
) -> None:
    def mismatch(what: str) -> InputError:
        return InputError(
            f"{what} do not belong together",
            where="make_problem",
            mend="discretize, dress and simulate the same pattern",
        )

    if int(np.max(discretization.edges.vertices)) + 1 != corners:
        raise mismatch("pattern and discretization")
    cloth = simulator.cloth
    if cloth.vertex_count != discretization.vertex_count or not (
        np.array_equal(np.asarray(cloth.faces).T, np.asarray(discretization.faces))
        and np.array_equal(np.asarray(cloth.rest_faces).T, np.asarray(discretization.rest_faces))
    ):
        raise mismatch("discretization and simulator")
    if parameters.rest_positions.shape != np.shape(discretization.meshed_positions):
        raise mismatch("discretization and parameters")
    if parameters.body_vertices.shape[0] != len(simulator.body_areas):
        raise mismatch("simulator and the body of the parameters")
