"""From a pattern and a body to a draped garment (S8, S9.2)."""

import dataclasses
import fnmatch
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from dress_jax.application.progress import Progress, fraction, newton, silent
from dress_jax.application.quality import drape_quality
from dress_jax.application.wearer import Wearer
from dress_jax.contact.barrier import ContactSettings
from dress_jax.core.errors import InputError
from dress_jax.core.precision import require_float64
from dress_jax.core.results import Result
from dress_jax.energy.cloth import Parameters
from dress_jax.energy.fabric import Fabrics, named_fabric
from dress_jax.energy.panels import FacePanels
from dress_jax.io.meshes import GarmentMesh
from dress_jax.io.programs import drop_programs_when_many
from dress_jax.io.results import DrapedState, write_result
from dress_jax.pattern import (
    Discretization,
    Pattern,
    discretize,
    pattern_parameters,
    rest_positions,
)
from dress_jax.render.shading import label_colors, preview
from dress_jax.sim import Simulator, make_simulation, static_solve
from dress_jax.sim.certificate import certify
from dress_jax.sim.dressing import DressedGarment, DressingOptions, dress
from dress_jax.sim.dressing.posing import WaistHold, follow_pose
from dress_jax.sim.equilibrium import Report
from dress_jax.solver import NewtonOptions
from dress_jax.solver.linear import LinearSolveError

EDGE_LENGTH = 0.015
SMALLEST_EDGE_LENGTH, LARGEST_EDGE_LENGTH = 0.002, 0.2
FABRIC = "cotton"


@dataclasses.dataclass(frozen=True)
class DrapeOptions:
    """How a garment is draped.

    Attributes:
        edge_length: wanted edge length of the cloth's triangles [m].
        fabric: a name of `energy.fabric.FABRICS`.
        panel_fabrics: names of panels, `*` and `?` allowed, each with the name of their fabric;
            where several fit a panel, the last of them counts.
        newton: stopping rule of the final drape.
        waist_hold: what keeps the waist in place while the body moves into its pose.
        strain_limit: largest stretch of a triangle in the final drape, above 1; None for no limit.
        friction: whether friction acts in the final drape; the garment then hangs where it was
            put on, instead of sliding until nothing pulls it along.
        dressing: how the garment is put on.
        contact: lengths of the contact model, None for the default.
    """

    edge_length: float = EDGE_LENGTH
    fabric: str = FABRIC
    panel_fabrics: tuple[tuple[str, str], ...] = ()
    newton: NewtonOptions = dataclasses.field(default_factory=NewtonOptions)
    waist_hold: WaistHold = WaistHold.PINS
    strain_limit: float | None = None
    friction: bool = False
    dressing: DressingOptions = dataclasses.field(default_factory=DressingOptions)
    contact: ContactSettings | None = None

    def __post_init__(self) -> None:
        if not SMALLEST_EDGE_LENGTH <= self.edge_length <= LARGEST_EDGE_LENGTH:
            raise InputError(
                f"the edge length is {self.edge_length}",
                where="edge length",
                mend=f"give metres, from {SMALLEST_EDGE_LENGTH} to {LARGEST_EDGE_LENGTH}",
            )
        if self.strain_limit is not None and not self.strain_limit > 1.0:
            raise InputError(
                f"the strain limit is {self.strain_limit}",
                where="strain limit",
                mend="give the largest stretch, such as 1.1 for 10 % of strain",
            )
        for name in (self.fabric, *(fabric for _, fabric in self.panel_fabrics)):
            named_fabric(name)

    def fabrics(self, panel_names: Sequence[str]) -> Fabrics:
        """The fabric of the garment, or where panels have their own, one per panel.

        Raises:
            InputError: a name that fits no panel.
        """
        if not self.panel_fabrics:
            return named_fabric(self.fabric)
        found = dict.fromkeys(panel_names, self.fabric)
        for wanted, fabric in self.panel_fabrics:
            fitting = fnmatch.filter(panel_names, wanted)
            if not fitting:
                raise InputError(
                    f"no panel is called {wanted!r}",
                    where="fabric of a panel",
                    mend=f"panels are {', '.join(sorted(panel_names))}",
                )
            found.update(dict.fromkeys(fitting, fabric))
        return tuple(named_fabric(found[name]) for name in panel_names)


@dataclasses.dataclass(frozen=True)
class DrapeResult:
    """A draped garment, and what is needed to drape it again.

    Attributes:
        pattern, discretization, wearer, options: what was draped.
        dressed: the garment after dressing; `positions` below are later ones.
        simulator, parameters: of the final solve.
        positions: the drape [m], shape (n, 3).
        report: how the solve went.
    """

    pattern: Pattern
    discretization: Discretization
    wearer: Wearer
    options: DrapeOptions
    dressed: DressedGarment
    simulator: Simulator
    parameters: Parameters
    positions: Float[np.ndarray, "n 3"]
    report: Report

    @property
    def good(self) -> bool:
        """Converged and free of intersections."""
        return self.report.converged and self.report.intersection_free


def drape_pattern(
    pattern: Pattern,
    wearer: Wearer,
    *,
    options: DrapeOptions | None = None,
    progress: Progress = silent,
) -> DrapeResult:
    """Put a garment on a body, follow the body into its pose, and let it hang under gravity.

    Args:
        pattern: the pattern, its panels placed around the body's dressing pose.
        wearer: the body.
        options: see `DrapeOptions`.
        progress: told about every stage.

    Returns:
        The drape. A solve that stopped early is told by its report, not raised.

    Raises:
        InputError: the pattern cannot be meshed, or put on this body.
        RuntimeError: 64-bit arrays are off.
    """
    require_float64("drape_pattern")
    options = DrapeOptions() if options is None else options
    drop_programs_when_many()
    progress("mesh", 0, 1)
    discretization = discretize(pattern, options.edge_length)
    rest = np.asarray(rest_positions(pattern_parameters(pattern), discretization))
    progress("mesh", 1, 1)
    dressed = put_on(discretization, rest, wearer, options, progress=progress)
    panels = FacePanels(discretization.panel_names, np.asarray(discretization.face_panel))
    simulator, parameters = make_simulation(
        dressed.cloth,
        dressed.positions,
        rest,
        fabric=options.fabrics(discretization.panel_names),
        panels=panels,
        body_vertices=wearer.vertices,
        body_faces=wearer.faces,
        pin_targets=dressed.pin_targets,
        strain_limit=options.strain_limit,
        friction=options.friction,
        settings=options.contact,
        newton=options.newton,
        linear_solver=options.dressing.linear_solver,
        broad_phase=options.dressing.broad_phase,
    )
    simulator.progress = newton(progress, "drape", options.newton.iteration_limit)
    drape = static_solve(simulator, parameters, jnp.asarray(dressed.positions))
    simulator.progress = None
    return DrapeResult(
        pattern=pattern,
        discretization=discretization,
        wearer=wearer,
        options=options,
        dressed=dressed,
        simulator=simulator,
        parameters=parameters,
        positions=np.asarray(drape.positions),
        report=drape.report,
    )


def put_on(
    discretization: Discretization,
    rest: Float[np.ndarray, "p 2"],
    wearer: Wearer,
    options: DrapeOptions,
    *,
    progress: Progress = silent,
) -> DressedGarment:
    """Dress the body and follow it into its pose; the garment does not hang yet.

    Args:
        discretization: of the pattern, its panels placed around the body's dressing pose.
        rest: panel coordinates [m].
        wearer: the body.
        options: see `DrapeOptions`.
        progress: told about every stage.

    Raises:
        InputError: the garment cannot be put on this body.
    """
    fabric = options.fabrics(discretization.panel_names)
    dressed = dress(
        discretization,
        rest,
        wearer.start,
        wearer.faces,
        fabric=fabric,
        settings=options.contact,
        options=options.dressing,
        progress=lambda stage, done: fraction(progress, stage, done),
    )
    if not len(wearer.way):
        return dressed
    dressed = follow_pose(
        dressed,
        rest,
        wearer.start,
        wearer.faces,
        wearer.way,
        fabric=fabric,
        panels=FacePanels(discretization.panel_names, np.asarray(discretization.face_panel)),
        hold=options.waist_hold,
        settings=options.contact,
        options=options.dressing,
        progress=lambda done: fraction(progress, "pose", done),
    )
    fraction(progress, "pose", 1.0)
    return dressed


def draped_state(result: DrapeResult) -> DrapedState:
    """What a result folder keeps of a drape."""
    return garment_state(
        result.discretization,
        np.asarray(result.parameters.rest_positions),
        result.positions,
        result.dressed,
        result.wearer,
        result.options,
        source=result.pattern.source,
    )


def garment_state(
    made: Discretization,
    rest: Float[np.ndarray, "p 2"],
    positions: Float[np.ndarray, "n 3"],
    dressed: DressedGarment,
    wearer: Wearer,
    options: DrapeOptions,
    *,
    source: str,
) -> DrapedState:
    """A garment on its wearer with everything that it was made with; `source` is the pattern's."""
    return DrapedState(
        garment=GarmentMesh(
            vertices=positions,
            faces=np.asarray(made.faces),
            rest_positions=rest,
            rest_faces=np.asarray(made.rest_faces),
            panels=made.panel_names,
            face_panels=np.asarray(made.face_panel),
        ),
        weld_map=np.asarray(made.weld_map),
        seam_vertices=np.asarray(made.seam_vertices),
        seam_offset=np.asarray(made.seam_offset),
        pins=np.asarray(dressed.cloth.pins),
        pin_targets=np.asarray(dressed.pin_targets),
        body_vertices=wearer.vertices,
        body_faces=wearer.faces,
        settings={
            **wearer.settings,
            "edge_length": options.edge_length,
            "fabric": options.fabric,
            "panel_fabrics": [list(pair) for pair in options.panel_fabrics],
            "membrane": options.dressing.membrane.value,
            "waist_hold": options.waist_hold.value,
            "strain_limit": options.strain_limit,
            "friction": options.friction,
            "pattern": source,
        },
    )


def drape_report(result: DrapeResult) -> dict[str, Any]:
    """Numbers of a drape, ready for `report.json`."""
    report = result.report
    return {
        **drape_quality(draped_state(result)),
        "converged": report.converged,
        "result": Result(int(report.result)).message,
        "residual": float(report.residual),
        "certificate": certificate_of(result.simulator, result.parameters, result.positions),
        "newton_iterations": int(report.iterations),
        "energy": float(report.energy),
        "fittings": [dataclasses.asdict(fitting) for fitting in result.dressed.fittings],
        "pins": len(result.dressed.pin_targets),
        "settings": dict(draped_state(result).settings),
    }


def certificate_of(
    simulator: Simulator, parameters: Parameters, positions: Float[np.ndarray, "n 3"]
) -> dict[str, Any]:
    """Whether a drape is an equilibrium and stable, or why that is not known, for a report."""
    try:
        found = certify(simulator, parameters, positions)
    except LinearSolveError as error:
        return {"unknown": str(error)}
    return {**dataclasses.asdict(found), "stable": found.stable}


def picture(state: DrapedState, *, size: int = 512) -> np.ndarray:
    """Front, side and back of a draped garment, panels in different colours, 8 bits."""
    return preview(
        (state.garment.vertices, state.garment.faces, label_colors(state.garment.face_panels)),
        (state.body_vertices, state.body_faces),
        size=size,
    )


def save_drape(folder: str | Path, result: DrapeResult, report: dict[str, Any]) -> None:
    """Write a result folder (`io.results`).

    Args:
        folder: where to.
        result: the drape.
        report: from `drape_report`, with whatever else belongs into the file.

    Raises:
        InputError: the folder cannot be written to.
    """
    state = draped_state(result)
    write_result(folder, state, pattern=result.pattern, preview=picture(state), report=report)
