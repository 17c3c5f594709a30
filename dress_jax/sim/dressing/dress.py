"""From flat panels to a garment on a body (S8.1-S8.7)."""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from dress_jax.contact.barrier import ContactSettings
from dress_jax.energy.cloth import Cloth, Gravity, make_cloth
from dress_jax.energy.fabric import Fabric, make_parameters
from dress_jax.energy.membrane import MembraneModel
from dress_jax.geometry.contraction import contraction_path
from dress_jax.pattern import Discretization, placed_positions
from dress_jax.sim.dressing.motion import MotionOptions, follow_body
from dress_jax.sim.dressing.placement import free_level, separate_panels
from dress_jax.sim.dressing.sewing import sew
from dress_jax.sim.dressing.waist import waist_loops
from dress_jax.sim.simulator import make_simulator

_LEVELS = 6  # of the contraction path; the last is about a tenth of the body's thickness
_LEAST_LEVEL = 4


@dataclasses.dataclass(frozen=True)
class DressingOptions:
    """How a garment is put on.

    Attributes:
        motion: how the cloth follows the growing body.
        hold_waist: pin the upper loop of components that end below the shoulders.
        linear_solver: a name, see `solver.linear.available_solvers`.
        membrane: membrane energy.
    """

    motion: MotionOptions = dataclasses.field(default_factory=MotionOptions)
    hold_waist: bool = True
    linear_solver: str = "auto"
    membrane: MembraneModel = MembraneModel.ARAP


@dataclasses.dataclass(frozen=True)
class DressedGarment:
    """A welded garment on the full body, not yet draped under gravity.

    Attributes:
        cloth: topology with its pins.
        positions: intersection-free vertices [m], (n, 3).
        pin_targets: where the pins are held [m], (k, 3).
        moved_panels: panels that had to be pushed apart at the start.
        body_level: contraction level at which the panels were placed (0 is the full body).
        seam_gap: largest move of a seam point in the weld [m]; all gaps are zero after it.
    """

    cloth: Cloth
    positions: Float[np.ndarray, "n 3"]
    pin_targets: Float[np.ndarray, "k 3"]
    moved_panels: tuple[str, ...]
    body_level: int
    seam_gap: float


def dress(
    discretization: Discretization,
    rest_positions: Float[np.ndarray, "p 2"],
    body_vertices: Float[np.ndarray, "b 3"],
    body_faces: Int[np.ndarray, "k 3"],
    *,
    fabric: Fabric,
    settings: ContactSettings | None = None,
    options: DressingOptions | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> DressedGarment:
    """Put a garment on a body.

    The body is shrunk toward its skeleton until the panels stand free of it, the panels are sewn
    around it and welded, and the body grows back as a moving boundary. Every state on the way is
    free of intersections.

    Args:
        discretization: of the pattern.
        rest_positions: panel coordinates [m].
        body_vertices, body_faces: the body, in the pose for which the panels are placed [m].
        fabric: used for sewing too.
        settings: lengths of the contact model.
        options: see `DressingOptions`.
        progress: called with the stage's name and the fraction of it that is done.

    Raises:
        InputError: panels that cannot be separated, seams that cannot be closed, or a garment that
            the body cannot grow into; the message names the panels.
    """
    options = DressingOptions() if options is None else options

    def tell(stage: str, done: float) -> None:
        if progress is not None:
            progress(stage, done)

    tell("place", 0.0)
    faces = np.asarray(discretization.faces)
    rest_faces = np.asarray(discretization.rest_faces)
    path = contraction_path(body_vertices, body_faces, levels=_LEVELS)
    placed = np.asarray(placed_positions(jnp.asarray(rest_positions), discretization))
    placement = separate_panels(placed, discretization)
    level = free_level(placement.positions, discretization, path, body_faces, least=_LEAST_LEVEL)

    tell("sew", 0.0)
    panels = make_cloth(
        rest_faces,
        vertex_count=len(placed),
        stitches=np.asarray(discretization.seam_vertices),
        membrane=options.membrane,
    )
    common = {
        "body_vertices": path[level],
        "body_faces": body_faces,
        "settings": settings,
        "linear_solver": options.linear_solver,
    }
    simulator = make_simulator(
        panels, placement.positions, weld_map=np.asarray(discretization.weld_map), **common
    )
    parameters = make_parameters(
        panels, fabric, jnp.asarray(rest_positions), body_vertices=path[level], gravity=Gravity.NONE
    )
    sewn = sew(simulator, parameters, placement.positions, discretization)

    tell("grow", 0.0)
    cloth = make_cloth(
        faces, rest_faces, vertex_count=discretization.vertex_count, membrane=options.membrane
    )
    simulator = make_simulator(cloth, sewn.positions, **common)
    parameters = make_parameters(
        cloth, fabric, jnp.asarray(rest_positions), body_vertices=path[level], gravity=Gravity.NONE
    )
    positions = follow_body(
        simulator,
        parameters,
        sewn.positions,
        path[:level][::-1],
        options=options.motion,
        progress=lambda done: tell("grow", done),
    )
    pins = np.zeros(0, np.int32)
    if options.hold_waist:
        pins = waist_loops(positions, faces, np.asarray(body_vertices))
    cloth = make_cloth(
        faces,
        rest_faces,
        vertex_count=discretization.vertex_count,
        pins=pins,
        membrane=options.membrane,
    )
    return DressedGarment(
        cloth=cloth,
        positions=positions,
        pin_targets=positions[pins],
        moved_panels=placement.moved_panels,
        body_level=level,
        seam_gap=sewn.seam_gap,
    )
