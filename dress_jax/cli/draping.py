"""The commands `drape` and `render`. Heavy imports wait until a command runs."""

import dataclasses
import enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dress_jax.cli.outcome import ExitCode, command
from dress_jax.cli.show import stages, table, wrote

if TYPE_CHECKING:
    from dress_jax.application.drape import DrapeOptions

PatternFile = Annotated[Path, typer.Argument(help="Pattern specification (JSON).")]
Body = Annotated[
    str, typer.Option(help="'default', an SMPL-X .npz file, or a static mesh in metres.")
]
Pose = Annotated[
    str | None,
    typer.Option(help="Pose to end in: t, a, relaxed, arms_up, or an .npz file. Rigged bodies."),
]
DressingPose = Annotated[
    str | None,
    typer.Option(help="Pose for which the panels are placed; t unless given. Rigged bodies."),
]
Shape = Annotated[
    str,
    typer.Option(
        help="Shape of the body: female, male_tall ..., or measures in metres, any of "
        "height=1.72,bust=0.95,waist=0.78,hips=1.0."
    ),
]
EdgeLength = Annotated[float, typer.Option(help="Edge length of the cloth's triangles [m].")]
FabricName = Annotated[
    str, typer.Option(help="cotton, denim, jersey, silk, wool, or another of docs/fabrics.md.")
]
FabricOf = Annotated[
    list[str] | None,
    typer.Option(
        metavar="PANEL=FABRIC",
        help="Another fabric for a panel, such as sleeve_left=silk or 'sleeve*=silk'; repeatable.",
    ),
]


class Membrane(enum.Enum):
    """How cloth stretches; values as in `energy.MembraneModel`, which is slow to import."""

    ARAP = "arap"
    NEO_HOOKEAN = "neo-hookean"
    ORTHOTROPIC = "orthotropic"


class Waist(enum.Enum):
    """What holds the waist on the way into a pose; values as in `sim.dressing.posing`."""

    PINS = "pins"
    SHRINK = "shrink"


WaistName = Annotated[
    Waist,
    typer.Option(
        help="What holds a skirt or trousers on the way into a pose: the waist rides on the body, "
        "or its rest shape is shrunk and friction holds it."
    ),
]
MembraneName = Annotated[
    Membrane, typer.Option(help="orthotropic tells warp (the panels' y) from weft.")
]
StrainLimit = Annotated[
    float | None,
    typer.Option(help="Largest stretch of a triangle, such as 1.1; none unless given."),
]
Friction = Annotated[
    bool, typer.Option(help="Friction in the final drape, with the fabric's coefficient.")
]
NewtonLimit = Annotated[int, typer.Option(min=1, help="Newton steps of a drape at most.")]
Out = Annotated[Path, typer.Option(help="Folder for the results; made where it is missing.")]


@command
def drape(
    pattern: PatternFile,
    out: Out,
    body: Body = "default",
    pose: Pose = None,
    dressing_pose: DressingPose = None,
    shape: Shape = "average",
    edge_length: EdgeLength = 0.015,
    fabric: FabricName = "cotton",
    fabric_of: FabricOf = None,
    membrane: MembraneName = Membrane.ARAP,
    waist: WaistName = Waist.PINS,
    strain_limit: StrainLimit = None,
    friction: Friction = False,
    newton_limit: NewtonLimit = 300,
) -> ExitCode:
    """Put a garment on a body and let it hang: meshes, pictures and a report."""
    from dress_jax.application.drape import (
        drape_pattern,
        drape_report,
        save_drape,
    )
    from dress_jax.application.wearer import find_wearer
    from dress_jax.io.patterns import load_pattern
    from dress_jax.io.results import prepare_folder
    from dress_jax.io.timing import stopwatch
    from dress_jax.sim.dressing.posing import WaistHold

    options = dataclasses.replace(
        drape_options(edge_length, fabric, fabric_of, membrane, newton_limit),
        waist_hold=WaistHold(waist.value),
        strain_limit=strain_limit,
        friction=friction,
    )
    document = load_pattern(pattern)
    prepare_folder(out)
    wearer = find_wearer(body, pose=pose, shape=shape, dressing_pose=dressing_pose)
    with stopwatch() as seconds, stages() as progress:
        result = drape_pattern(document, wearer, options=options, progress=progress)
    report = drape_report(result)
    report["seconds"] = {"compile": seconds.compile, "run": seconds.run}
    save_drape(out, result, report)
    table(pattern.stem, _summary(report))
    wrote(out)
    return ExitCode.DONE if result.good else ExitCode.NOT_SOUND


@command
def render(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that `drape` wrote.")],
    out: Annotated[Path, typer.Option(help="Folder for the target views.")],
    views: Annotated[int, typer.Option(min=1, max=360, help="Cameras around the body.")] = 20,
    size: Annotated[int, typer.Option(min=16, max=4096, help="Height and width [px].")] = 512,
) -> ExitCode:
    """Draw masks, normals and colours of a result from all around, as targets for `fit`."""
    from dress_jax.application.targets import draw_targets, write_targets
    from dress_jax.io.results import prepare_folder, read_result

    state, _ = read_result(folder)
    prepare_folder(out)
    with stages() as progress:
        targets = draw_targets(state, views=views, size=size, progress=progress)
    write_targets(out, targets, state.garment)
    wrote(out)
    return ExitCode.DONE


def drape_options(
    edge_length: float,
    fabric: str,
    fabric_of: list[str] | None,
    membrane: Membrane,
    newton_limit: int,
) -> "DrapeOptions":
    """What the options of `drape` and `fit` say about the cloth.

    Raises:
        InputError: a fabric of a panel without an equals sign, or values out of range.
    """
    from dress_jax.application.drape import DrapeOptions
    from dress_jax.core.errors import InputError
    from dress_jax.energy.membrane import MembraneModel
    from dress_jax.sim.dressing import DressingOptions
    from dress_jax.solver import NewtonOptions

    pairs = [text.partition("=") for text in fabric_of or ()]
    for panel, equals, name in pairs:
        if not (panel and equals and name):
            raise InputError(
                f"{panel + equals + name!r} names no panel and fabric",
                where="--fabric-of",
                mend="write PANEL=FABRIC, such as sleeve_left=silk",
            )
    return DrapeOptions(
        edge_length=edge_length,
        fabric=fabric,
        panel_fabrics=tuple((panel, name) for panel, _, name in pairs),
        newton=NewtonOptions(iteration_limit=newton_limit),
        dressing=DressingOptions(membrane=MembraneModel(membrane.value)),
    )


def _tight(panels: dict[str, float]) -> dict[str, str]:
    if not panels:
        return {}
    named = sorted(panels.items(), key=lambda item: -item[1])
    return {"too small here": ", ".join(f"{name} ({by - 1.0:.0%})" for name, by in named)}


def _summary(report: dict[str, Any]) -> dict[str, Any]:
    crossings, seconds = report["intersections"], report["seconds"]
    return {
        "vertices / faces": f"{report['vertices']} / {report['faces']}",
        "panels / seams": f"{report['panels']} / {report['seams']}",
        "intersections": f"{crossings['self']} self, {crossings['body']} body",
        "smallest distance [mm]": 1e3 * report["min_distance_m"],
        "converged": "yes" if report["converged"] else f"no: {report['result']}",
        "Newton steps": report["newton_iterations"],
        **_tight(report["tight_panels"]),
        "largest / median strain": f"{report['max_strain']:.1%} / {report['median_strain']:.1%}",
        "seconds": f"{seconds['compile']:.1f} compiling, {seconds['run']:.1f} running",
    }
