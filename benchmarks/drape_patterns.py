"""Drape every pattern of a folder on a body and say how it went.

    python benchmarks/drape_patterns.py PATTERNS --body BODY.obj --out OUT

Writes one row per pattern to OUT/rows (so that an interrupted run goes on where it stopped), the
drapes, a table, results.json and a contact sheet of pictures.
"""

import argparse
import json
import time
import traceback
from pathlib import Path

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from PIL import Image, ImageDraw  # noqa: E402

from dress_jax.core.errors import InputError  # noqa: E402
from dress_jax.energy.fabric import FABRICS  # noqa: E402
from dress_jax.energy.membrane import principal_stretches  # noqa: E402
from dress_jax.energy.rest import rest_triangles  # noqa: E402
from dress_jax.io.body_meshes import load_body_mesh  # noqa: E402
from dress_jax.io.patterns import load_pattern  # noqa: E402
from dress_jax.io.programs import drop_programs_when_many  # noqa: E402
from dress_jax.pattern import discretize, pattern_parameters, rest_positions  # noqa: E402
from dress_jax.render.shading import label_colors, preview  # noqa: E402
from dress_jax.sim import make_simulation, static_solve  # noqa: E402
from dress_jax.sim.dressing import dress  # noqa: E402
from dress_jax.solver import NewtonOptions  # noqa: E402

COLUMNS = (
    "name",
    "vertices",
    "self",
    "body",
    "ipctk",
    "converged",
    "newton",
    "min_mm",
    "strain_p50",
    "strain_p99",
    "seconds_dress",
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


def drape(path: Path, body, body_faces, edge_length: float, fabric, picture: Path) -> dict:
    """One row of the table."""
    started = time.perf_counter()
    d = discretize(load_pattern(path), edge_length)
    rest = np.asarray(rest_positions(pattern_parameters(load_pattern(path)), d))
    garment = dress(d, rest, body, body_faces, fabric=fabric)
    dressed = time.perf_counter() - started
    simulator, parameters = make_simulation(
        garment.cloth,
        garment.positions,
        rest,
        fabric=fabric,
        body_vertices=body,
        body_faces=body_faces,
        pin_targets=garment.pin_targets,
        newton=NewtonOptions(tolerance=1e-4, iteration_limit=200),
    )
    result = static_solve(simulator, parameters, garment.positions)
    x, faces = np.asarray(result.positions), np.asarray(d.faces)
    long, short = principal_stretches(
        x, garment.cloth.faces, rest_triangles(rest, garment.cloth.rest_faces)
    )
    strain = np.maximum(np.abs(np.asarray(long) - 1), np.abs(np.asarray(short) - 1))
    pixels = preview((x, faces, label_colors(np.asarray(d.face_panel))), (body, body_faces))
    Image.fromarray(pixels).save(picture)
    report = result.report
    return {
        "vertices": len(x),
        "self": int(report.self_intersections),
        "body": int(report.body_intersections),
        "ipctk": oracle_is_clean(x, faces, body, body_faces),
        "converged": bool(report.converged),
        "newton": int(report.iterations),
        "min_mm": round(1e3 * float(report.smallest_distance), 3),
        "strain_p50": round(float(np.median(strain)), 4),
        "strain_p99": round(float(np.percentile(strain, 99)), 4),
        "contraction": max(fitting.contraction for fitting in garment.fittings),
        "arms_drawn_in": any(fitting.arms_drawn_in for fitting in garment.fittings),
        "seconds_dress": round(dressed, 1),
        "seconds": round(time.perf_counter() - started, 1),
    }


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


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("patterns", type=Path)
    parser.add_argument("--body", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--edge-length", type=float, default=0.02)
    parser.add_argument("--fabric", choices=sorted(FABRICS), default="cotton")
    parser.add_argument("--only", default="", help="part of the names to run")
    options = parser.parse_args()
    body, body_faces = load_body_mesh(options.body)
    fabric = FABRICS[options.fabric]
    rows = []
    paths = sorted(options.patterns.glob("*_specification.json"))
    paths = [path for path in paths if options.only in path.name]
    if not paths:
        parser.error(f"no *{options.only}*_specification.json in {options.patterns}")
    for folder in ("rows", "pictures"):
        (options.out / folder).mkdir(parents=True, exist_ok=True)
    for path in paths:
        name = path.name.removesuffix("_specification.json")
        record = options.out / "rows" / f"{name}.json"
        if not record.is_file():
            drop_programs_when_many()
            row: dict = {"name": name}
            try:
                picture = options.out / "pictures" / f"{name}.png"
                row |= drape(path, body, body_faces, options.edge_length, fabric, picture)
            except InputError as error:
                row["error"] = str(error)
            except Exception as error:
                row["error"] = f"{type(error).__name__}: {error}"
                traceback.print_exc()
            record.write_text(json.dumps(row, indent=1))
            print("  ".join(f"{key}={row[key]}" for key in COLUMNS if key in row), flush=True)
        rows.append(json.loads(record.read_text()))
    table = [" ".join(f"{column:>12}" for column in COLUMNS)]
    table += [" ".join(f"{row.get(column, '')!s:>12}" for column in COLUMNS) for row in rows]
    clean = sum(row.get("self") == 0 and row.get("body") == 0 and row["ipctk"] for row in rows)
    table.append(f"{clean} of {len(rows)} are free of intersections")
    (options.out / "table.txt").write_text("\n".join(table) + "\n")
    (options.out / "results.json").write_text(json.dumps(rows, indent=1))
    contact_sheet(rows, options.out)
    print("\n".join(table))


if __name__ == "__main__":
    main()
