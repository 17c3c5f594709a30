"""Parse and mesh a folder of pattern files; print a table and write it as JSON.

python benchmarks/patterns.py FOLDER [--edge-length 0.015] [--output patterns.json]
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np

from dress_jax.core.errors import InputError
from dress_jax.geometry.triangulation import triangle_angles
from dress_jax.pattern import Discretization, discretize, parse_specification


def measure(document: dict, source: str, edge_length: float) -> dict:
    """One row of the table: sizes, quality and seconds, or the error in one line."""
    row: dict = {"name": source}
    start = time.perf_counter()
    try:
        pattern = parse_specification(document, source=source)
        row["panels"], row["seams"] = len(pattern.panels), len(pattern.stitches)
        parsed = time.perf_counter()
        mesh = discretize(pattern, edge_length)
    except InputError as error:
        return row | {"error": str(error)}
    return (
        row
        | {"parse_seconds": parsed - start, "mesh_seconds": time.perf_counter() - parsed}
        | mesh_figures(mesh)
    )


def mesh_figures(mesh: Discretization) -> dict:
    """Sizes, smallest angle and the state of the sewn surface."""
    directed = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, uses = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)
    _, same = np.unique(directed, axis=0, return_counts=True)
    angles = np.degrees(triangle_angles(mesh.meshed_positions, mesh.rest_faces))
    corners = mesh.meshed_positions[mesh.rest_faces]
    lengths = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    return {
        "panel_vertices": len(mesh.weld_map),
        "vertices": mesh.vertex_count,
        "faces": len(mesh.faces),
        "min_angle": float(angles.min()),
        "angle_percentile_1": float(np.percentile(angles.min(axis=1), 1)),
        "min_edge": float(lengths.min()),
        "max_edge": float(lengths.max()),
        "max_faces_per_edge": int(uses.max()),
        "edges_traversed_twice_one_way": int(np.sum(same > 1)),
        "harmonic_error": harmonic_error(mesh),
        "harmonic_megabytes": sum(weights.nbytes for weights in mesh.harmonic) / 1e6,
    }


def harmonic_error(mesh: Discretization) -> float:
    """Largest distance [m] between meshed inner vertices and H times the outline."""
    worst = 0.0
    for panel, weights in enumerate(mesh.harmonic):
        points = mesh.meshed_positions[mesh.panel_offset[panel] : mesh.panel_offset[panel + 1]]
        if len(weights):
            outline, inner = points[: weights.shape[1]], points[weights.shape[1] :]
            worst = max(worst, float(np.abs(weights @ outline - inner).max()))
    return worst


def line(row: dict) -> str:
    """One line of the printed table."""
    name = row["name"][-44:]
    if "error" in row:
        return f"{name:44} {row['error']}"
    return (
        f"{name:44} {row['panels']:6} {row['seams']:5} {row['vertices']:8} {row['faces']:8} "
        f"{row['min_angle']:9.2f} {row['parse_seconds'] + row['mesh_seconds']:7.2f}"
    )


def main() -> None:
    """Run over every file of a folder that holds a pattern."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--edge-length", type=float, default=0.015, help="metres")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    print(f"{'name':44} panels seams vertices    faces min angle seconds")
    rows = []
    for path in sorted(options.folder.rglob("*.json")):
        try:
            document = json.loads(path.read_text())
        except json.JSONDecodeError as error:
            print(f"{path.name[-44:]:44} not JSON: {error}")
            continue
        if not isinstance(document, dict) or "pattern" not in document:
            continue
        name = str(path.relative_to(options.folder))
        rows.append(measure(document, name, options.edge_length))
        print(line(rows[-1]), flush=True)
    good = [row for row in rows if "error" not in row]
    summary = {
        "edge_length": options.edge_length,
        "patterns": len(rows),
        "errors": len(rows) - len(good),
        "panels": sum(row["panels"] for row in good),
        "panel_vertices": sum(row["panel_vertices"] for row in good),
        "faces": sum(row["faces"] for row in good),
        "seconds": sum(row["parse_seconds"] + row["mesh_seconds"] for row in good),
        "median_vertices": float(np.median([row["vertices"] for row in good])),
        "median_min_angle": float(np.median([row["min_angle"] for row in good])),
        "smallest_min_angle": min(row["min_angle"] for row in good),
        "median_angle_percentile_1": float(np.median([r["angle_percentile_1"] for r in good])),
        "min_edge": min(row["min_edge"] for row in good),
        "max_edge": max(row["max_edge"] for row in good),
        "worst_harmonic_error": max(row["harmonic_error"] for row in good),
        "max_faces_per_edge": max(row["max_faces_per_edge"] for row in good),
        "edges_traversed_twice_one_way": sum(r["edges_traversed_twice_one_way"] for r in good),
    }
    print(json.dumps(summary, indent=2))
    if options.output:
        options.output.write_text(json.dumps({"summary": summary, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
