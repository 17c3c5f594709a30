"""Real input: a scene of SewFactory, from its template's default pattern to the true one.

    python -m benchmarks.sewfactory --data DATA --out OUT [--masks scan parser] [--iterations 25]

DATA holds `sewfactory/*` (twelve pictures around a person, the true garment and pattern) and
`patterns/neuraltailor/templates` (the template that the scene's pattern was drawn from). Nothing of
the truth is fitted to but, with `--masks scan`, masks that are drawn from the true garment; with
`--masks parser` the pictures alone are looked at. The body is fitted to the pictures in both cases.
Runs are resumed where OUT holds some. Writes `sewfactory.json` and prints the table of
docs/pipeline.md; the page of each run is in OUT/MASKS/report.

Against the true garment: IoU of the garment's masks over all views, with the masks that were fitted
to and with those of the true garment; distance between the surfaces, symmetric mean, in cm; errors
of the pattern's edge lengths.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import jax
import numpy as np

from dress_jax.application.bundle import Source
from dress_jax.application.bundle_targets import bundle_targets, draw_masks
from dress_jax.application.completion import MaskSource
from dress_jax.application.drape import DrapeOptions
from dress_jax.application.found_body import load_wearer, moved_bundle
from dress_jax.application.reconstruct import BUNDLE, ReconstructOptions, reconstruct
from dress_jax.cli.show import stages, table
from dress_jax.core.errors import InputError
from dress_jax.io.capture.bundles import load_bundle
from dress_jax.io.documents import read_json
from dress_jax.io.results import DrapedState, read_state
from dress_jax.loss.metrics import iou
from dress_jax.optimisation.observation import observe

TEMPLATES = "patterns/neuraltailor/templates"


def template_of(scene: Path, templates: Path) -> Path:
    """The template's default pattern, by the name that the scene's begins with.

    Raises:
        InputError: there is none.
    """
    kind = scene.name.rsplit("_", 1)[0]
    found = sorted(templates.rglob(f"{kind}.json"))
    if not found:
        raise InputError(f"holds no template '{kind}'", where=str(templates))
    return found[0]


def true_iou(folder: Path, state: DrapedState) -> float:
    """IoU of a drape's masks with those of the true garment, over all views of a run."""
    _, offset = load_wearer(folder / "body")
    bundle = moved_bundle(load_bundle(folder / "bundle" / BUNDLE), offset)
    truth = bundle_targets(draw_masks(bundle)).observation
    drawn = observe(
        truth.cameras,
        state.garment.vertices,
        state.garment.faces,
        body_vertices=state.body_vertices,
        body_faces=state.body_faces,
    )
    return float(iou(np.asarray(drawn.mask), np.asarray(truth.mask)))


def measure(scene: Path, folder: Path, options: ReconstructOptions) -> dict[str, Any]:
    """Reconstruct a scene, and one row of the table."""
    with stages() as progress:
        outcomes = reconstruct(scene, folder, options=options, progress=progress)
    fit = read_json(folder / "fit" / "report.json", what="a report")
    drapes = [read_state(folder / name / "drape.h5") for name in ("drape", "fit")]
    return {
        "scene": scene.name,
        "pose": options.reader["pose"],
        "masks": None if options.masks is None else options.masks.value,
        "edge_length_m": options.drape.edge_length,
        "iou": [fit["iou"]["start"], fit["iou"]["end"]],
        "true_iou": [true_iou(folder, state) for state in drapes],
        "chamfer_cm": [fit["chamfer_cm"]["start"], fit["chamfer_cm"]["end"]],
        "median_error": [fit["edge_length_error"][k]["median"] for k in ("start", "end")],
        "largest_error": [fit["edge_length_error"][k]["max"] for k in ("start", "end")],
        "iterations": fit["iterations"],
        "rejected": fit["rejected"],
        "crossings": sum(fit["intersections"].values()),
        "vertices": fit["vertices"],
        "sound": all(outcome.result.good for outcome in outcomes),
        "seconds": {outcome.name: outcome.seconds for outcome in outcomes},
    }


def line(row: dict[str, Any]) -> tuple[str, ...]:
    """A row of the printed table."""

    def change(key: str, digits: int, scale: float = 1.0) -> str:
        start, end = (scale * value for value in row[key])
        return f"{start:.{digits}f} to {end:.{digits}f}"

    return (
        f"{row['pose']}, {row['masks']}",
        change("iou", 3),
        change("true_iou", 3),
        change("chamfer_cm", 2),
        change("median_error", 1, 100.0),
        change("largest_error", 1, 100.0),
        f"{row['iterations']}, {row['rejected']}",
        str(row["crossings"]),
        f"{sum(row['seconds'].values()):.0f}",
    )


HEADER = (
    "pose, masks",
    "IoU, fitted masks",
    "IoU, true masks",
    "Chamfer [cm]",
    "edges off, median [%]",
    "largest [%]",
    "steps, rejected",
    "crossings",
    "seconds",
)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="sewfactory/ patterns/")
    parser.add_argument("--out", type=Path, required=True, help="folder for runs and JSON")
    parser.add_argument("--masks", nargs="+", default=["scan"], choices=["scan", "parser"])
    parser.add_argument("--pose", default="static", help="static, or such as 0000")
    parser.add_argument("--edge-length", type=float, default=0.02, help="of the cloth [m]")
    parser.add_argument("--iterations", type=int, default=25)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    rows = []
    for scene in sorted(p for p in (arguments.data / "sewfactory").iterdir() if p.is_dir()):
        truths = sorted((scene / "static").glob("*_specification.json"))
        for masks in arguments.masks:
            options = ReconstructOptions(
                source=Source.SEWFACTORY,
                reader={"pose": arguments.pose},
                masks=MaskSource(masks),
                pattern=template_of(scene, arguments.data / TEMPLATES),
                truth=truths[0],
                drape=DrapeOptions(edge_length=arguments.edge_length),
                iterations=arguments.iterations,
            )
            folder = arguments.out / scene.name / f"{arguments.pose}-{masks}"
            rows.append(measure(scene, folder, options))
            table("SewFactory", [line(row) for row in rows], header=HEADER)
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "sewfactory.json").write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
