"""Drape every pattern of some folders on a body and say how it went.

    python benchmarks/drape_patterns.py FOLDER... --body BODY.obj --out OUT [--every 5]
    python benchmarks/drape_patterns.py FOLDER... --body default --shape height=1.72,... --out OUT

Writes one row per pattern to OUT/rows (so that an interrupted run goes on where it stopped),
pictures, a table, results.json and a contact sheet. A drape is good where it has no intersection by
our exact test and by ipctk, all seams are closed, every garment hangs where it was put on, and half
of its triangles are strained by less than 5 % and all but a hundredth by less than 30 %.
"""

import argparse
import json
import traceback
from pathlib import Path

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from PIL import Image, ImageDraw  # noqa: E402

from dress_jax.application.drape import (  # noqa: E402
    DrapeOptions,
    DrapeResult,
    drape_pattern,
    draped_state,
    picture,
)
from dress_jax.application.quality import drape_quality  # noqa: E402
from dress_jax.application.wearer import Wearer, static_wearer  # noqa: E402
from dress_jax.core.errors import InputError  # noqa: E402
from dress_jax.energy.fabric import FABRICS  # noqa: E402
from dress_jax.io.bodies import body_from_argument  # noqa: E402
from dress_jax.io.patterns import load_pattern  # noqa: E402
from dress_jax.io.timing import stopwatch  # noqa: E402
from dress_jax.pattern import components  # noqa: E402
from dress_jax.solver import NewtonOptions  # noqa: E402

LARGEST_MEDIAN_STRAIN, LARGEST_STRAIN_P99 = 0.05, 0.3
LARGEST_FALL = 0.1  # of the highest vertex of a garment, from where it was put on [m]
COLUMNS = (
    "name",
    "vertices",
    "good",
    "self",
    "body",
    "ipctk",
    "converged",
    "newton",
    "min_mm",
    "strain_p50",
    "strain_p99",
    "fall_cm",
    "compiling",
    "seconds",
    "error",
)


def oracle_is_clean(x, faces, body, body_faces) -> bool:
    """Whether ipctk finds no intersection of the garment with itself or with the body.

    The body may intersect itself; it is left out as a static obstacle.
    """
    import ipctk

    everything = np.concatenate([x, body])
    triangles = np.concatenate([faces, body_faces + len(x)]).astype(np.int32)
    mesh = ipctk.CollisionMesh(everything, ipctk.edges(triangles), triangles)
    mesh.can_collide = ipctk.make_static_obstacle_filter(len(x))
    return not ipctk.has_intersections(mesh, everything)


def drape(path: Path, wearer: Wearer, options: DrapeOptions, image: Path) -> dict:
    """One row of the table."""
    with stopwatch() as seconds:
        result = drape_pattern(load_pattern(path), wearer, options=options)
    state = draped_state(result)
    quality, report = drape_quality(state), result.report
    garment = state.garment
    Image.fromarray(picture(state)).save(image)
    row = {
        "vertices": quality["vertices"],
        "self": quality["intersections"]["self"],
        "body": quality["intersections"]["body"],
        "ipctk": oracle_is_clean(
            garment.vertices, garment.faces, state.body_vertices, state.body_faces
        ),
        "converged": bool(report.converged),
        "newton": int(report.iterations),
        "min_mm": round(1e3 * quality["min_distance_m"], 3),
        "strain_p50": round(quality["median_strain"], 4),
        "strain_p99": round(quality["strain_p99"], 4),
        "tight": {name: round(by, 2) for name, by in quality["tight_panels"].items()},
        "seam_gap_mm": round(1e3 * quality["max_seam_gap_m"], 3),
        "fall_cm": round(1e2 * largest_fall(result), 1),
        "contraction": max(fitting.contraction for fitting in result.dressed.fittings),
        "arms_drawn_in": any(fitting.arms_drawn_in for fitting in result.dressed.fittings),
        "compiling": round(seconds.compile, 1),
        "seconds": round(seconds.total, 1),
    }
    return row | {"good": is_good(row)}


def is_good(row: dict) -> bool:
    """Whether a drape has all that a garment needs."""
    return (
        row["self"] == row["body"] == 0
        and row["ipctk"]
        and row["seam_gap_mm"] == 0.0
        and row["fall_cm"] <= 1e2 * LARGEST_FALL
        and row["strain_p50"] < LARGEST_MEDIAN_STRAIN
        and row["strain_p99"] < LARGEST_STRAIN_P99
    )


def largest_fall(result: DrapeResult) -> float:
    """How far the highest vertex of any garment is below that of the same garment, put on [m]."""
    made = result.discretization
    label = components(made)[np.asarray(made.face_panel)]
    faces = np.asarray(made.faces)
    before, after = result.dressed.positions[:, 1], result.positions[:, 1]
    garments = [np.unique(faces[label == number]) for number in range(int(label.max()) + 1)]
    return max(float(before[own].max() - after[own].max()) for own in garments)


def contact_sheet(rows: list[dict], folder: Path) -> None:
    """All pictures with their names, two in a row."""
    tiles = []
    for row in rows:
        picture = folder / "pictures" / f"{row['name']}.png"
        tile = Image.new("RGB", (768, 276), "white")
        if picture.is_file():
            tile.paste(Image.open(picture).resize((768, 256)), (0, 20))
        ImageDraw.Draw(tile).text((6, 4), f"{row['name']}  {row.get('error', '')}"[:110], "black")
        tiles.append(tile)
    sheet = Image.new("RGB", (1536, 276 * ((len(tiles) + 1) // 2)), "white")
    for number, tile in enumerate(tiles):
        sheet.paste(tile, (768 * (number % 2), 276 * (number // 2)))
    sheet.save(folder / "contact_sheet.png")


def write_table(rows: list[dict], folder: Path) -> None:
    """The table, results.json and the contact sheet, of the rows so far."""
    table = [" ".join(f"{column:>10}" for column in COLUMNS)]
    table += [" ".join(f"{row.get(column, '')!s:>10}" for column in COLUMNS) for row in rows]
    good = sum(bool(row.get("good")) for row in rows)
    free = sum(row.get("self") == row.get("body") == 0 and row["ipctk"] for row in rows)
    refused = sum("error" in row for row in rows)
    tight = sum(bool(row.get("tight")) and not row["good"] for row in rows)
    table.append(
        f"{good} of {len(rows)} are good, {free} free of intersections; of those that are not "
        f"good, {tight} have panels too small for the body, {refused} ended with an error"
    )
    (folder / "table.txt").write_text("\n".join(table) + "\n")
    (folder / "results.json").write_text(json.dumps(rows, indent=1))
    contact_sheet(rows, folder)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("patterns", type=Path, nargs="+")
    parser.add_argument("--body", required=True, help="a mesh, or default, in the A pose")
    parser.add_argument(
        "--shape", default="average", help="of the default body, as dress-jax drape"
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--edge-length", type=float, default=0.02)
    parser.add_argument("--fabric", choices=sorted(FABRICS), default="cotton")
    parser.add_argument("--only", default="", help="part of the names to run")
    parser.add_argument("--every", type=int, default=1, help="run every k-th pattern only")
    options = parser.parse_args()
    rigged = options.body == "default"
    body = body_from_argument(options.body, pose="a" if rigged else "t", shape=options.shape)
    floor = body.vertices[:, 1].min() if rigged else 0.0
    wearer = static_wearer(body.vertices - [0.0, floor, 0.0], body.faces)
    draping = DrapeOptions(
        edge_length=options.edge_length,
        fabric=options.fabric,
        newton=NewtonOptions(tolerance=1e-4, iteration_limit=200),
    )
    paths = [
        path
        for folder in options.patterns
        for path in sorted(folder.glob("*_specification.json"))
        if options.only in path.name
    ][:: options.every]
    if not paths:
        parser.error(f"no *{options.only}*_specification.json in {options.patterns}")
    for folder in ("rows", "pictures"):
        (options.out / folder).mkdir(parents=True, exist_ok=True)
    rows = []
    for path in paths:
        name = path.name.removesuffix("_specification.json")
        record = options.out / "rows" / f"{name}.json"
        if not record.is_file():
            row: dict = {"name": name}
            try:
                row |= drape(path, wearer, draping, options.out / "pictures" / f"{name}.png")
            except InputError as error:
                row["error"] = str(error)
            except Exception as error:
                row["error"] = f"{type(error).__name__}: {error}"
                traceback.print_exc()
            record.write_text(json.dumps(row, indent=1))
            print("  ".join(f"{key}={row[key]}" for key in COLUMNS if key in row), flush=True)
        rows.append(json.loads(record.read_text()))
        write_table(rows, options.out)
    print((options.out / "table.txt").read_text())


if __name__ == "__main__":
    main()
