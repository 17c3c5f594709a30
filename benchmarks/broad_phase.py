"""The broad phases beside each other, on cloth lying closely above a body.

    python benchmarks/broad_phase.py [--sides 50 100] [--radius 1 5] [--json times.json]

`build` makes the trees, `pairs` is the time of the padded lists as compiled code
wants them, boxes and sorting included, and `first` that of the first call, with its compilation.
The lists of both are compared; they have to be the same. On a graphics processor, the times of the
trees include what they send there and back.
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from contact import hill

from dress_jax.contact.broad_phase import CollisionMesh, make_collision_mesh
from dress_jax.contact.candidates import Candidates
from dress_jax.contact.pair_finders import make_pair_finder

BODY_SIDE = 110
RUNS = 9
FINDERS = ("trees", "device")


def scene(side: int) -> tuple[CollisionMesh, np.ndarray, np.ndarray]:
    """Cloth and body, and where their vertices are at both ends of a step [m]."""
    rng = np.random.default_rng(0)
    cloth, cloth_faces = hill(side)
    body, body_faces = hill(BODY_SIDE)
    cloth += np.array([0.0, 0.004, 0.0]) + 5e-4 * rng.normal(size=cloth.shape)
    start = np.concatenate([cloth, body])
    end = start.copy()
    end[: len(cloth)] += 1e-3 * rng.normal(size=cloth.shape)
    return make_collision_mesh(cloth_faces, len(cloth), body_faces, len(body)), start, end


def seconds(function: Callable[[], Any]) -> float:
    """Of one call, until its results are there."""
    start = time.perf_counter()
    jax.block_until_ready(jax.tree.leaves(function()))
    return time.perf_counter() - start


def measure(name: str, side: int, radius: float) -> tuple[dict[str, Any], Candidates]:
    """Times of one broad phase [s], and what it finds."""
    mesh, start, end = scene(side)
    began = time.perf_counter()
    finder = make_pair_finder(name, mesh, start)
    planted = time.perf_counter() - began

    def find() -> Candidates:
        return finder.find(start, end, radius, body_moved=False)

    first = seconds(find)
    times = [seconds(find) for _ in range(RUNS)]
    found = find()
    row = {
        "finder": name,
        "cloth_vertices": mesh.n_cloth,
        "body_vertices": mesh.n - mesh.n_cloth,
        "radius": radius,
        "vertex_face": int(found.vertex_face_count),
        "edge_edge": int(found.edge_edge_count),
        "build_seconds": planted,
        "first_seconds": first,
        "pairs_seconds": statistics.median(times),
        "fastest_seconds": min(times),
    }
    return row, found


def main() -> None:
    """Print a table, and write it as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sides", type=int, nargs="+", default=[50, 100])
    parser.add_argument("--radius", type=float, nargs="+", default=[1.0, 5.0], help="[mm]")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    report = []
    print(f"jax computes on {jax.devices()[0].device_kind}; milliseconds")
    print(
        f"{'cloth':>6} {'body':>6} {'radius':>7} {'vertex-face':>11} {'edge-edge':>9} "
        f"{'':>7} {'build':>7} {'first':>8} {'pairs':>7} {'fastest':>7}"
    )
    for side in options.sides:
        for radius in options.radius:
            lists = []
            for name in FINDERS:
                row, found = measure(name, side, 1e-3 * radius)
                report.append({"device": jax.devices()[0].device_kind, **row})
                lists.append(found)
                print(
                    f"{row['cloth_vertices']:6d} {row['body_vertices']:6d} {radius:5.1f}mm "
                    f"{row['vertex_face']:11d} {row['edge_edge']:9d} {name:>7} "
                    f"{1e3 * row['build_seconds']:7.0f} {1e3 * row['first_seconds']:8.0f} "
                    f"{1e3 * row['pairs_seconds']:7.1f} {1e3 * row['fastest_seconds']:7.1f}",
                    flush=True,
                )
            if not all(map(np.array_equal, *map(jax.tree.leaves, lists))):
                raise SystemExit("the lists differ")
    if options.json is not None:
        options.json.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
