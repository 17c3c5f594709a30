"""The simulator: a cloth, what it collides with, and the settings of a solve.

A host object without parameters: positions, stiffnesses and the body's vertices are arguments of
every solve, so that all of them can be differentiated.
"""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from dress_jax.contact.barrier import ContactSettings, contact_settings
from dress_jax.contact.broad_phase import make_collision_mesh
from dress_jax.contact.pair_finders import PairFinder, make_pair_finder
from dress_jax.contact.scales import contact_scales
from dress_jax.core.errors import InputError
from dress_jax.core.native import processors
from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Cloth, Gravity, Parameters
from dress_jax.energy.fabric import Fabrics, make_parameters
from dress_jax.energy.gathers import gathered_corners
from dress_jax.energy.panels import FacePanels
from dress_jax.energy.rest import vertex_areas
from dress_jax.sim.clean_state import CleanState
from dress_jax.sim.last_end import LastEnd
from dress_jax.sim.matrices import ElasticSlots
from dress_jax.sim.padding import Padding, make_padding
from dress_jax.sim.sparsity import elastic_slots
from dress_jax.solver.block_matrix import BlockPattern
from dress_jax.solver.linear import LinearSolver, make_solver
from dress_jax.solver.newton import NewtonOptions, NewtonProgress

_REACH_SHARE = 0.5  # dhat over the median edge of the rest shape, at most


@dataclasses.dataclass(eq=False)
class Simulator:
    """What stays the same from solve to solve; made by `make_simulator`.

    Attributes:
        cloth: topology of the garment.
        body_faces: triangles of the body, (k, 3).
        body_areas: area that each body vertex stands for in contact [m^2], (b,).
        settings: lengths of the contact model.
        contact_scales: factors of dhat and thickness at each vertex of cloth and body, in (0, 1];
            constants of the mesh that carry no derivative, (n + b,).
        newton: stopping rule.
        friction: whether friction acts (off in an optimisation, S9.9).
        linear_solver: factorizes the projected Hessians.
        padding: the cloth as compiled programs see it.
        pattern, slots: sparsity of the current matrices; grows with self-contact.
        broad_phase: finds pairs that can come close.
        weld_map: vertices that are one, or about to become one, share a number.
        progress: called after every Newton iteration.
        observer: called with the positions of cloth and body [m] after every Newton iteration and
            after every motion of the body: with every state through which the cloth passes.
        panels: of the triangles, for messages; None where they are not known.
        clean_state: the last state that the exact intersection test found clean.
        last_end: the last step's end, for its derivatives.
        workers: threads that solve the lanes of a batch (`sim.lanes`).
        twins: simulators of these threads.
    """

    cloth: Cloth
    body_faces: Int[np.ndarray, "k 3"]
    body_areas: Float[Array, " b"]
    settings: ContactSettings
    contact_scales: Float[np.ndarray, " nb"]
    newton: NewtonOptions
    friction: bool
    linear_solver: LinearSolver
    padding: Padding
    pattern: BlockPattern
    slots: ElasticSlots
    broad_phase: PairFinder
    weld_map: Int[np.ndarray, " n"] | None = None
    progress: Callable[[NewtonProgress], None] | None = None
    observer: Callable[[Float[np.ndarray, "n 3"], Float[np.ndarray, "b 3"]], None] | None = None
    panels: FacePanels | None = None
    clean_state: CleanState = dataclasses.field(default_factory=CleanState)
    last_end: LastEnd = dataclasses.field(default_factory=LastEnd)
    workers: int = dataclasses.field(default_factory=processors)
    twins: list["Simulator"] = dataclasses.field(default_factory=list, init=False, repr=False)

    @property
    def vertex_count(self) -> int:
        """Number of cloth vertices."""
        return self.cloth.vertex_count


def body_vertex_areas(
    vertices: Float[np.ndarray, "b 3"], faces: Int[np.ndarray, "k 3"]
) -> Float[Array, " b"]:
    """A third of the area of the triangles around each body vertex [m^2]."""
    corners = np.asarray(vertices, np.float64)[np.asarray(faces)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = 0.5 * np.linalg.norm(normals, axis=1)
    columns = jnp.asarray(np.asarray(faces).T, jnp.int32).reshape(3, -1)
    return vertex_areas(jnp.asarray(areas), columns, len(vertices))


def make_simulator(
    cloth: Cloth,
    positions: Float[np.ndarray, "n 3"],
    *,
    body_vertices: Float[np.ndarray, "b 3"] | None = None,
    body_faces: Int[np.ndarray, "k 3"] | None = None,
    settings: ContactSettings | None = None,
    contact_scales: Float[np.ndarray, " n"] | None = None,
    newton: NewtonOptions | None = None,
    friction: bool = False,
    linear_solver: str = "auto",
    broad_phase: str = "auto",
    weld_map: Int[np.ndarray, " n"] | None = None,
    panels: FacePanels | None = None,
) -> Simulator:
    """Prepare a simulator for one cloth and one body topology.

    Args:
        cloth: topology of the garment.
        positions: typical positions [m], (n, 3); they shape the box trees, not the results.
        body_vertices, body_faces: the body; its vertices here give the contact areas only.
        settings: lengths of the contact model; default dhat 3 mm, thickness 0.3 mm.
        contact_scales: factors of these lengths at each cloth vertex, for example those of
            `contact.scales`; default 1, like those of the body.
        newton: stopping rule.
        friction: whether friction acts.
        linear_solver: a name, see `solver.linear.available_solvers`.
        broad_phase: "trees" on the host, "device" in compiled code, or "auto", which takes what is
            faster where jax computes; the pairs are the same.
        weld_map: vertices with the same number are, or are about to become, one vertex; primitives
            that share one do not collide. Default: none do.
        panels: of the triangles, for messages.

    Raises:
        InputError: arrays that do not fit each other.
    """
    n = cloth.vertex_count
    positions = np.asarray(positions, np.float64)
    if positions.shape != (n, 3):
        raise InputError(f"positions have shape {positions.shape}, the cloth has {n} vertices")
    if (body_vertices is None) != (body_faces is None):
        raise InputError("body_vertices and body_faces must come together")
    body = np.zeros((0, 3)) if body_vertices is None else np.asarray(body_vertices, np.float64)
    triangles = np.zeros((0, 3), np.int32) if body_faces is None else np.asarray(body_faces)
    weld = None
    if weld_map is not None:
        weld_map = np.asarray(weld_map)
        weld = np.concatenate([weld_map, weld_map.max() + 1 + np.arange(len(body))])
    mesh = make_collision_mesh(np.asarray(cloth.faces).T, n, triangles, len(body), weld_ids=weld)
    count = cloth.faces.shape[1]
    if panels is not None and len(panels.face_panel) != count:
        raise InputError(
            f"panels of {len(panels.face_panel)} triangles, the cloth has {count} triangles"
        )
    padding = make_padding(cloth, len(body))
    pattern, slots = elastic_slots(cloth.vertex_count, padding.cloth)
    scales = np.ones(n) if contact_scales is None else np.asarray(contact_scales, np.float64)
    if scales.shape != (n,) or not np.all((scales > 0.0) & (scales <= 1.0)):
        raise InputError(
            f"contact_scales of shape {scales.shape} or out of range",
            mend=f"give {n} factors above 0 and at most 1, one per vertex",
        )
    return Simulator(
        cloth=cloth,
        body_faces=np.asarray(triangles, np.int32),
        body_areas=body_vertex_areas(body, triangles),
        settings=contact_settings() if settings is None else settings,
        contact_scales=np.concatenate([scales, np.ones(len(body))]),
        newton=NewtonOptions() if newton is None else newton,
        friction=friction,
        linear_solver=make_solver(linear_solver),
        padding=padding,
        pattern=pattern,
        slots=slots,
        broad_phase=make_pair_finder(broad_phase, mesh, np.concatenate([positions, body])),
        weld_map=weld_map,
        panels=panels,
    )


def make_simulation(
    cloth: Cloth,
    positions: Float[np.ndarray, "n 3"],
    rest_positions: Float[np.ndarray, "p 2"],
    *,
    fabric: Fabrics,
    panels: FacePanels | None = None,
    body_vertices: Float[np.ndarray, "b 3"],
    body_faces: Int[np.ndarray, "k 3"],
    pin_targets: Float[np.ndarray, "k 3"] | None = None,
    gravity: Gravity = Gravity.DOWN,
    strain_limit: float | None = None,
    friction: bool = False,
    settings: ContactSettings | None = None,
    newton: NewtonOptions | None = None,
    linear_solver: str = "auto",
    broad_phase: str = "auto",
) -> tuple[Simulator, Parameters]:
    """A simulator, and parameters for the same cloth and body.

    The contact model's lengths are reduced where the rest shape has triangles too small for them
    (`contact.scales`); without wishes also as a whole, to half of its median edge.

    Args:
        cloth: topology of the garment.
        positions: typical positions [m], (n, 3).
        rest_positions: panel coordinates [m], (p, 2).
        fabric: of the whole garment, or one per panel.
        panels: of the triangles; needed where there is a fabric per panel, and named in messages.
        body_vertices, body_faces: the body [m].
        pin_targets: where pins are held [m].
        gravity: direction and strength.
        strain_limit: largest stretch of a triangle, see `make_parameters`; None for no limit.
        friction: whether friction acts, with the fabric's coefficient.
        settings, newton, linear_solver, broad_phase: see `make_simulator`.

    Raises:
        InputError: arrays that do not fit each other.
    """
    rest_faces = np.asarray(cloth.rest_faces).T
    if settings is None:
        settings = _fine_enough(np.asarray(rest_positions)[rest_faces])
    simulator = make_simulator(
        cloth,
        positions,
        body_vertices=body_vertices,
        body_faces=body_faces,
        settings=settings,
        contact_scales=contact_scales(
            gathered_corners(rest_positions, rest_faces, cloth.gathers),
            np.asarray(cloth.faces).T,
            cloth.vertex_count,
            settings,
        ),
        newton=newton,
        friction=friction,
        linear_solver=linear_solver,
        broad_phase=broad_phase,
        panels=panels,
    )
    parameters = make_parameters(
        cloth,
        fabric,
        jnp.asarray(rest_positions),
        face_panel=None if panels is None else panels.face_panel,
        body_vertices=jnp.asarray(body_vertices),
        pin_targets=None if pin_targets is None else jnp.asarray(pin_targets),
        gravity=gravity,
        strain_limit=strain_limit,
    )
    return simulator, parameters


def _fine_enough(corners: Float[np.ndarray, "f 3 2"]) -> ContactSettings:
    """Lengths that fit the mesh: dhat is at most half of the median edge.

    Primitives that are no neighbours are about an edge apart, and a barrier between them would turn
    a fine cloth into a board.

    Args:
        corners: of the rest triangles [m].
    """
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    settings = contact_settings()
    share = min(1.0, _REACH_SHARE * float(np.median(edges)) / float(settings.dhat))
    return replace(settings, dhat=share * settings.dhat, thickness=share * settings.thickness)
