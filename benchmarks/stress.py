"""Stress scenes, run several times in a row: is every state free of intersections, is every run
equal bit by bit?

    python benchmarks/stress.py [--runs 10] [--fine 4] [--only NAME ...] [--json stress.json]

Every state through which the cloth passes counts: each Newton iterate and each motion of a body.
Intersections are counted by the exact test of `geometry.intersection`.
"""

import argparse
import functools
import json
import platform
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

from stress_scenes import SCENES, play  # noqa: E402

from dress_jax.geometry.intersection import count_intersections  # noqa: E402
from dress_jax.io.programs import drop_programs_when_many  # noqa: E402


def clean(positions, faces, body, body_faces) -> bool:
    """Whether the exact test finds nothing."""
    counts = count_intersections(positions, faces, body, body_faces)
    return counts.self == 0 and counts.body == 0


def main() -> None:
    """Print a table, and write it as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--fine", type=int, default=4)
    parser.add_argument("--only", nargs="+", choices=sorted(SCENES), default=list(SCENES))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    print(
        f"{'scene':18s} {'vertices':>8s} {'states':>7s} {'clean':>6s} {'equal':>6s} {'s/run':>7s}"
    )
    for name in options.only:
        drop_programs_when_many()
        make = functools.partial(SCENES[name], options.fine)
        outcomes = [play(make, clean) for _ in range(options.runs)]
        row = {
            "scene": name,
            "vertices": len(make().positions),
            "states": sum(outcome.states for outcome in outcomes),
            "intersecting": sum(outcome.intersecting for outcome in outcomes),
            "moved_m": outcomes[0].moved,
            "equal": len({outcome.digest for outcome in outcomes}) == 1,
            "seconds": [outcome.seconds for outcome in outcomes],
        }
        rows.append(row)
        print(
            f"{name:18s} {row['vertices']:8d} {row['states']:7d} "
            f"{'yes' if not row['intersecting'] else 'NO':>6s} "
            f"{'yes' if row['equal'] else 'NO':>6s} {min(row['seconds']):7.1f}",
            flush=True,
        )
    if options.json is not None:
        report = {"machine": platform.processor() or platform.machine(), "jax": jax.__version__}
        options.json.write_text(json.dumps({**report, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
