"""The commands `check` and `gradcheck`, which examine a result. Heavy imports wait."""

from pathlib import Path
from typing import Annotated

import typer

from dress_jax.cli.outcome import ExitCode, command
from dress_jax.cli.show import stages, table, wrote

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Folder that `drape` wrote.")]


@command
def check(folder: Folder) -> ExitCode:
    """Recount intersections and seams of a result exactly, by other code than the solver's."""
    from dress_jax.application.check import check_result

    counts = check_result(folder)
    rows = [
        ("vertices / faces", *(f"{c.vertices} / {c.faces}" for c in counts)),
        ("intersections with itself", *(c.self_intersections for c in counts)),
        ("intersections with the body", *(c.body_intersections for c in counts)),
        ("smallest distance [mm]", *(1e3 * c.min_distance for c in counts)),
        ("seams", *(c.seams for c in counts)),
        ("open seams", *(c.open_seams for c in counts)),
        ("largest seam gap [mm]", *(1e3 * c.seam_gap for c in counts)),
        ("boundary loops", *(c.boundary_loops for c in counts)),
        ("intersection-free", *(c.intersection_free for c in counts)),
    ]
    table(str(folder), rows, header=("", *(c.source for c in counts)))
    return ExitCode.DONE if all(c.good for c in counts) else ExitCode.NOT_SOUND


@command
def gradcheck(
    folder: Folder,
    tolerance: Annotated[
        float, typer.Option(min=0.0, help="Largest relative error of a derivative.")
    ] = 1e-5,
    seed: Annotated[int, typer.Option(min=0, help="Of the directions and weights.")] = 0,
) -> ExitCode:
    """Compare the drape's derivatives with finite differences; writes DIR/gradcheck.json."""
    import dataclasses

    from dress_jax.application.gradcheck import check_gradients
    from dress_jax.io.report import write_report
    from dress_jax.io.results import read_result

    state, _ = read_result(folder)
    with stages() as progress:
        report = check_gradients(state, seed=seed, progress=progress)
    rows = [
        (
            row.name,
            f"{row.reverse:.3e}",
            f"{row.disagreement:.0e}",
            f"{row.difference:.3e}",
            f"{row.uncertainty:.0e}",
            f"{row.error:.0e}",
            row.error <= tolerance,
        )
        for row in report.rows
    ]
    header = ("", "adjoint", "forward", "differences", "unsure")
    table(str(folder), rows, header=(*header, "error", "agrees"))
    found = report.certificate
    table(
        "the drape",
        {
            "converged": report.converged,
            "smallest distance / reach of contact [mm]": f"{1e3 * report.smallest_distance:.3f} / "
            f"{1e3 * report.dhat:.3f}",
            "largest force left [N]": found.residual,
            "smallest eigenvalue [1/s^2]": found.smallest_eigenvalue,
        },
    )
    written = folder / "gradcheck.json"
    content = dataclasses.asdict(report) | {"tolerance": tolerance, "seed": seed}
    write_report(written, content | {"good": report.good(tolerance)}, nonfinite_to_null=True)
    wrote(written)
    return ExitCode.DONE if report.good(tolerance) else ExitCode.NOT_SOUND
