"""dress_jax beside its peers, on the same scenes with the same stopping rule.

    python -m benchmarks.peers [--vertices 2500 10000] [--only NAME ...] [--scenes NAME ...]
                               [--steps 2] [--seconds 20] [--json peers.json]

Scenes: `drop` (a sheet falls onto a sphere, steps of 20 ms), `stack` (two sheets fall over a
table), `drape` (a settled sheet whose rest shape grew by 1 %, static) and `settle` (a flat sheet to
its static drape, for dress_jax and Newton physics). Every contestant runs in a process of its own.

`ratio` is a time over that of dress_jax: of an iteration, and in total where both converged.
`cpu s` are the seconds of all threads, which other programs on the machine disturb less; `MB` is
the peak memory of the process so far. `energy` is the potential energy of the end state by
dress_jax's own functions, `mm` its smallest distance, `crossings` its exact intersections within
the cloth and with the body. `gradient` is the backward pass of the static solve, `forward` its
share of the solve. After --seconds no iteration of a scene begins. Compilation is not counted.
See docs/benchmarks.md.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers.contest import SCENES, make_scene
from benchmarks.peers.contestants import NAMES
from benchmarks.peers.report import OWN, head, line, machine, versions

# Compilation, the adjoint and an iteration that is under way come on top of a scene's seconds.
_GRACE = 240.0  # [s]
_TIMES = 6.0  # a scene may be run twice, the first time with several times its seconds
_SETTLES = (OWN, "newton-style3d", "newton-vbd")


def contest(name: str, vertices: int, options: argparse.Namespace) -> tuple[list[dict], set[str]]:
    """Rows of one contestant, and the packages that it used."""
    wanted = [s for s in options.scenes if s != "settle" or name in _SETTLES]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        command = [sys.executable, "-m", "benchmarks.peers.contest", name, str(folder)]
        command += ["--vertices", str(vertices), "--steps", str(options.steps)]
        command += ["--seconds", str(options.seconds), "--scenes", *wanted]
        fault = ""
        try:
            limit = _GRACE + _TIMES * options.seconds * len(wanted)
            ended = subprocess.run(command, capture_output=True, text=True, timeout=limit)
            if ended.returncode:
                told = ended.stderr.strip().splitlines() or [f"exit code {ended.returncode}"]
                fault = f"failed: {told[-1]}"
        except subprocess.TimeoutExpired:
            fault = f"stopped after {limit:.0f} s"
        return _read(folder, name, vertices, wanted, fault, options)


def _read(folder, name, vertices, wanted, fault, options) -> tuple[list[dict], set[str]]:
    from benchmarks.peers.judge import judge

    about_file = folder / "contestant.json"
    about = json.loads(about_file.read_text()) if about_file.exists() else {}
    if "missing" in about:
        fault = f"not run: {about['missing']} (pip install 'dress-jax[peers]')"
    rows = []
    for scene_name in wanted:
        row: dict[str, Any] = {"vertices": vertices, "scene": scene_name, "contestant": name}
        written = folder / f"{scene_name}.json"
        if written.exists():
            scene = make_scene(scene_name, vertices, options.steps)
            with np.load(folder / f"{scene_name}.npz") as kept:
                measured = judge(scene, kept["positions"])
            row |= json.loads(written.read_text()) | measured | {"solver": about["solver"]}
            rows.append(row)
        elif fault:
            rows.append(row | {"fault": fault})
            if "missing" in about:
                break
    return rows, set(about.get("packages", ()))


def main() -> None:
    """Print a table, and write it as JSON."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.peers",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--vertices", type=int, nargs="+", default=[2500, 10000])
    parser.add_argument("--only", nargs="+", choices=NAMES, default=list(NAMES))
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--steps", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    packages: set[str] = set()
    where = machine()
    print(f"{where['processor']}, {where['cores']} cores, load {where['load']}")
    for vertices in options.vertices:
        print(head(vertices), flush=True)
        for name in options.only:
            found, used = contest(name, vertices, options)
            packages |= used
            rows += found
            for row in found:
                print(line(row, _own(rows, row)), flush=True)
    found = versions(packages)
    print("\n" + ", ".join(f"{package} {version}" for package, version in found.items()))
    if options.json is not None:
        report = {"machine": where, "versions": found, "steps": options.steps, "rows": rows}
        options.json.write_text(json.dumps(report, indent=1) + "\n")


def _own(rows: list[dict[str, Any]], row: dict[str, Any]) -> dict[str, Any] | None:
    """The row of dress_jax on the same scene."""
    for other in rows:
        if other["contestant"] == OWN and all(other[k] == row[k] for k in ("scene", "vertices")):
            return other
    return None


if __name__ == "__main__":
    main()
