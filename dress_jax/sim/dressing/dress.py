"""From flat panels to a garment on a body (S8.1-S8.7)."""

import dataclasses
from collections.abc import Callable
from typing import NoReturn

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from dress_jax.contact.barrier import ContactSettings
from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Cloth, Gravity, Parameters, make_cloth
from dress_jax.energy.fabric import Fabrics
from dress_jax.energy.membrane import MembraneModel
from dress_jax.energy.panels import FacePanels
from dress_jax.energy.stretching import mesh_stretches
from dress_jax.pattern import Discretization, placed_positions
from dress_jax.sim.dressing.components import Component, split_components
from dress_jax.sim.dressing.growth import (
    Collider,
    Growth,
    crossed_faces,
    make_collider,
    plan_growth,
)
from dress_jax.sim.dressing.joining import Surface, join
from dress_jax.sim.dressing.motion import MotionOptions, follow_body, settle
from dress_jax.sim.dressing.waist import waist_loops
from dress_jax.sim.simulator import Simulator, make_simulation

_CLEARANCE = 1e-5  # of a joined surface [m]
_FALL_STEPS, _FALL_TIME = 6, 0.15  # with which skirts fall before the arms grow out
# A garment that is about to be pinned where it was put on, and is stretched further than this there
# (99th percentile), first slides to where it fits: until it moves less in so many steps [m], [s].
_TIGHT, _STILL, _SLIDES, _SLIDE_STEPS, _SLIDE_TIME = 0.2, 0.005, 10, 4, 0.2


@dataclasses.dataclass(frozen=True)
class DressingOptions:
    """How a garment is put on.

    Attributes:
        motion: how the cloth follows the growing body.
        hold_waist: pin the upper loop of components that end below the shoulders.
        linear_solver: a name, see `solver.linear.available_solvers`.
        broad_phase: a name, see `make_simulator`.
        membrane: membrane energy.
    """

    motion: MotionOptions = dataclasses.field(default_factory=MotionOptions)
    hold_waist: bool = True
    linear_solver: str = "auto"
    broad_phase: str = "auto"
    membrane: MembraneModel = MembraneModel.ARAP


@dataclasses.dataclass(frozen=True)
class Fitting:
    """How one component was put on.

    Attributes:
        panels: names.
        contraction: of the body on which it was put, from 0 (the full body) to 1 (its skeleton).
        arms_drawn_in: whether the arms grew out again afterwards.
        smoothing_length: with which its panels were joined [m].
    """

    panels: tuple[str, ...]
    contraction: float
    arms_drawn_in: bool
    smoothing_length: float


@dataclasses.dataclass(frozen=True)
class DressedGarment:
    """A welded garment on the full body, not yet draped under gravity.

    Attributes:
        cloth: topology with its pins.
        positions: intersection-free vertices [m], (n, 3).
        pin_targets: where the pins are held [m], (k, 3).
        fittings: how its components were put on, bottom to top.
    """

    cloth: Cloth
    positions: Float[np.ndarray, "n 3"]
    pin_targets: Float[np.ndarray, "k 3"]
    fittings: tuple[Fitting, ...]


def dress(
    discretization: Discretization,
    rest_positions: Float[np.ndarray, "p 2"],
    body_vertices: Float[np.ndarray, "b 3"],
    body_faces: Int[np.ndarray, "k 3"],
    *,
    fabric: Fabrics,
    placed: Float[np.ndarray, "p 3"] | None = None,
    settings: ContactSettings | None = None,
    options: DressingOptions | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> DressedGarment:
    """Put a garment, or an outfit of several, on a body.

    Each component's panels are joined around a body that has shrunk toward its skeleton; then the
    body grows back as a moving boundary. Components are put on from the lowest to the highest, each
    over those before it. Every state on the way is free of intersections.

    Args:
        discretization: of the pattern.
        rest_positions: panel coordinates [m].
        body_vertices, body_faces: the body, in the pose for which the panels are placed [m].
        fabric: of the whole garment, or one per panel; used for dressing too.
        placed: where the panel vertices stand [m]; default: as the pattern file places them.
        settings: lengths of the contact model.
        options: see `DressingOptions`.
        progress: called with the stage's name and the fraction of it that is done.

    Raises:
        InputError: panels that cannot be joined without crossing, or a garment that the body cannot
            grow into; the message names the panels.
    """
    options = DressingOptions() if options is None else options
    rest_faces = np.asarray(discretization.rest_faces)

    def tell(stage: str, done: float) -> None:
        if progress is not None:
            progress(stage, done)

    tell("join", 0.0)
    rest_positions = np.asarray(rest_positions, np.float64)
    if placed is None:
        placed = np.asarray(placed_positions(jnp.asarray(rest_positions), discretization))
    collider = make_collider(body_vertices, body_faces)
    parts = split_components(discretization, rest_positions, placed)
    positions = np.zeros((discretization.vertex_count, 3))
    fittings = []
    for number, component in enumerate(parts):
        core = collider.thinned(1.0, arms=1.0, arm_length=0.0), collider.faces
        joined = join(component.surface, clearance=_CLEARANCE, core=core)
        if not joined.free:
            _refuse(
                component,
                joined.crossed,
                discretization,
                "the panels cross each other once they are sewn as placed",
            )
        growth = plan_growth(collider, joined.positions, component.surface.faces)
        if growth is None:
            hit = crossed_faces(joined.positions, component.surface.faces, collider)
            _refuse(component, hit, discretization, "the body runs through the panels as placed")
        tell("grow", number / len(parts))
        positions[component.vertices] = _grow(
            component,
            joined.positions,
            collider,
            growth,
            fabric,
            discretization.panel_names,
            settings,
            options,
            lambda done, number=number: tell("grow", (number + done) / len(parts)),
        )
        collider = collider.wearing(positions[component.vertices], component.surface.faces)
        fittings.append(
            Fitting(
                component.panels,
                growth.contraction,
                growth.arms_drawn_in,
                joined.smoothing_length,
            )
        )
    faces = np.asarray(discretization.faces)
    pins = np.zeros(0, np.int32)
    if options.hold_waist:
        pins = waist_loops(positions, faces, np.asarray(body_vertices))
    cloth = make_cloth(
        faces,
        rest_faces,
        rest_positions=rest_positions,
        vertex_count=discretization.vertex_count,
        pins=pins,
        membrane=options.membrane,
        panels=FacePanels(discretization.panel_names, np.asarray(discretization.face_panel)),
    )
    return DressedGarment(cloth, positions, positions[pins], tuple(fittings))


def _grow(
    component: Component,
    positions: np.ndarray,
    collider: Collider,
    growth: Growth,
    fabric: Fabrics,
    panel_names: tuple[str, ...],
    settings: ContactSettings | None,
    options: DressingOptions,
    progress: Callable[[float], None],
) -> np.ndarray:
    """Vertices of the component after the collider has grown to its full shape."""
    surface = component.surface
    panels = FacePanels(panel_names, component.face_panel)

    def prepared(x: np.ndarray, body: np.ndarray, pins: np.ndarray, gravity: Gravity):
        # Without gathers: the panels unfold from the joined surface all at once, and drawn-up
        # seams have tangled there. The drape draws them up.
        cloth = make_cloth(
            surface.faces,
            surface.rest_faces,
            vertex_count=surface.vertex_count,
            pins=pins,
            membrane=options.membrane,
            panels=panels,
        )
        simulator, parameters = make_simulation(
            cloth,
            x,
            surface.rest_positions,
            fabric=fabric,
            panels=panels,
            body_vertices=collider.vertices,
            body_faces=collider.faces,
            pin_targets=x[pins],
            gravity=gravity,
            settings=settings,
            linear_solver=options.linear_solver,
            broad_phase=options.broad_phase,
        )
        return simulator, replace(parameters, body_vertices=jnp.asarray(body))

    share = len(growth.frames) / (len(growth.frames) + len(growth.arm_frames))
    scene = prepared(positions, growth.frames[0], np.zeros(0, np.int32), Gravity.NONE)
    positions = follow_body(
        *scene,
        positions,
        growth.frames,
        options=options.motion,
        progress=lambda done: progress(share * done),
    )
    if growth.arms_drawn_in:
        # Wide skirts hang out of the arms' way first.
        pins = waist_loops(positions, surface.faces, collider.body)
        scene = prepared(positions, growth.frames[-1], pins, Gravity.DOWN)
        positions = settle(*scene, positions, steps=_FALL_STEPS, time_step=_FALL_TIME)
        positions = follow_body(
            *scene,
            positions,
            growth.arm_frames,
            options=options.motion,
            progress=lambda done: progress(share + (1.0 - share) * done),
        )
    if options.hold_waist and len(waist_loops(positions, surface.faces, collider.body)):
        loose = prepared(positions, collider.vertices, np.zeros(0, np.int32), Gravity.NONE)
        positions = _slid_into_place(surface, *loose, positions)
    return positions


def _slid_into_place(
    surface: Surface, simulator: Simulator, parameters: Parameters, positions: np.ndarray
) -> np.ndarray:
    """Vertices of a tight garment after it has slid to where it is less stretched, [m]."""
    for _ in range(_SLIDES):
        stretches = mesh_stretches(
            positions, surface.faces, surface.rest_positions, surface.rest_faces
        )
        if np.quantile(stretches[0], 0.99) <= 1.0 + _TIGHT:
            return positions
        before = positions
        positions = settle(
            simulator, parameters, positions, steps=_SLIDE_STEPS, time_step=_SLIDE_TIME
        )
        if np.max(np.linalg.norm(positions - before, axis=1)) < _STILL:
            return positions
    return positions


def _refuse(
    component: Component, faces: np.ndarray, discretization: Discretization, what: str
) -> NoReturn:
    names = [discretization.panel_names[panel] for panel in np.unique(component.face_panel[faces])]
    raise InputError(
        what,
        where=f"panels {names}",
        mend="check that pattern and body stand in the same frame (metres, feet at y = 0, front "
        "towards +z), and the stitches, translations and rotations of these panels",
    )
