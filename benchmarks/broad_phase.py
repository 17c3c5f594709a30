"""The broad phases beside each other, on cloth lying closely above a body.

    python benchmarks/broad_phase.py [--sides 50 100] [--radius 1 5] [--json times.json]

`build` makes the trees and `first` is the first search, with its compilation. `wall` is the median
time of a search that ends with padded lists as compiled code wants them, `fastest` the shortest
one, and `cpu` the least that all threads needed together. Both broad phases search in turns, and
their lists are compared; they have to be the same. On a graphics processor, the times of the trees
include what they send there and back.
"""

import argparse
import functools
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
RUNS = 15
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


def timed(function: Callable[[], Candidates]) -> tuple[float, float]:
    """Seconds on the wall, and of all threads, of one call until its results are there."""
    start, cpu_start = time.perf_counter(), time.process_time()
    jax.block_until_ready(function())
    return time.perf_counter() - start, time.process_time() - cpu_start


def measure(side: int, radius: float) -> list[dict[str, Any]]:
    """Times of each broad phase [s].

    Raises:
        RuntimeError: they do not find the same pairs.
    """
    mesh, start, end = scene(side)
    rows, searches = [], []
    for name in FINDERS:
        began = time.perf_counter()
        finder = make_pair_finder(name, mesh, start)
        built = time.perf_counter() - began
        search = functools.partial(finder.find, start, end, radius, body_moved=False)
        first, _ = timed(search)
        rows.append({"finder": name, "build_seconds": built, "first_seconds": first})
        searches.append(search)
    times = [[timed(search) for search in searches] for _ in range(RUNS)]
    lists = [search() for search in searches]
    if not all(map(np.array_equal, *map(jax.tree.leaves, lists))):
        raise RuntimeError("the lists differ")
    for k, row in enumerate(rows):
        wall, cpu = zip(*(run[k] for run in times), strict=True)
        row |= {
            "wall_seconds": statistics.median(wall),
            "fastest_seconds": min(wall),
            "cpu_seconds": min(cpu),
            "cloth_vertices": mesh.n_cloth,
            "body_vertices": mesh.n - mesh.n_cloth,
            "radius": radius,
            "vertex_face": int(lists[k].vertex_face_count),
            "edge_edge": int(lists[k].edge_edge_count),
            "device": jax.devices()[0].device_kind,
        }
    return rows


def main() -> None:
    """Print a table, and write it as JSON."""
    parser = argparse.ArgumentParser(description="Times of both broad phases.")
    parser.add_argument("--sides", type=int, nargs="+", default=[50, 100])
    parser.add_argument("--radius", type=float, nargs="+", default=[1.0, 5.0], help="[mm]")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    report = []
    print(f"jax computes on {jax.devices()[0].device_kind}; milliseconds")
    print(
        f"{'cloth':>6} {'body':>6} {'radius':>7} {'vertex-face':>11} {'edge-edge':>9} {'':>7} "
        f"{'build':>7} {'first':>7} {'wall':>7} {'fastest':>7} {'cpu':>7}"
    )
    for side in options.sides:
        for radius in options.radius:
            for row in measure(side, 1e-3 * radius):
                report.append(row)
                times = " ".join(
                    f"{1e3 * row[f'{key}_seconds']:7.1f}"
                    for key in ("build", "first", "wall", "fastest", "cpu")
                )
                print(
                    f"{row['cloth_vertices']:6d} {row['body_vertices']:6d} {radius:5.1f}mm "
                    f"{row['vertex_face']:11d} {row['edge_edge']:9d} {row['finder']:>7} {times}",
                    flush=True,
                )
    if options.json is not None:
        options.json.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
