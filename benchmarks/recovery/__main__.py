"""Recover real patterns from pictures of their own drapes, beginning with wrong ones.

    python -m benchmarks.recovery --data DATA --out OUT [--patterns tshirt ...] [--bodies drafted]
                                  [--starts 10% ...] [--views clean eroded noisy few]
                                  [--variants whole no-guidance adam ...]

A pattern of GarmentCode is draped with cotton on a body and photographed from 20 sides; a fit then
begins with a pattern of other lengths and a fabric of other stiffness. Every fit runs in a process
of its own and leaves its row, its pattern and its pictures in OUT, so an interrupted run goes on
where it stopped. Held-out IoU counts ten views between those of the fit; Chamfer is the two-way
mean distance of points to triangles; `true` is either of the true pattern and fabric on the mesh of
the fit, draped as a fit drapes, which says how far a fit can come; `in` is the share of true edge
lengths within the intervals of the report. Variants leave out a part of the method, or are Adam
with or without a term. DATA is a folder with `patterns/garmentcode` and `bodies/mean_all.obj`.
"""

import argparse
import dataclasses
import json
import subprocess
import sys
from pathlib import Path

from benchmarks.recovery.cases import BODIES, PATTERNS, STARTS, VIEWS, Case, cases
from benchmarks.recovery.table import HEAD, line, write_table
from benchmarks.recovery.variants import VARIANTS, WHOLE

_LONGEST = 7200.0
"""Seconds after which a fit is stopped and counts as an error."""


def attempt(case: Case, options: argparse.Namespace) -> dict:
    """The row of a case: from its file, or made now."""
    path = options.out / "rows" / f"{case.name}.json"
    if not path.is_file():
        command = [sys.executable, "-m", "benchmarks.recovery.attempt"]
        command += [case.pattern, case.body, case.start, case.view, case.variant]
        for name in ("data", "out", "edge_length", "iterations"):
            command += [f"--{name.replace('_', '-')}", str(getattr(options, name))]
        try:
            ended = subprocess.run(command, timeout=_LONGEST, check=False)
            fault = f"CRASH: exit code {ended.returncode}"
        except subprocess.TimeoutExpired:
            fault = f"stopped after {_LONGEST:.0f} s"
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            row = {"name": case.name, **dataclasses.asdict(case), "error": fault}
            path.write_text(json.dumps(row))
    return json.loads(path.read_text())


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--patterns", nargs="+", choices=PATTERNS, default=PATTERNS)
    parser.add_argument("--bodies", nargs="+", choices=tuple(BODIES), default=tuple(BODIES))
    parser.add_argument("--starts", nargs="+", choices=tuple(STARTS), default=tuple(STARTS))
    parser.add_argument("--views", nargs="+", choices=tuple(VIEWS), default=("clean",))
    parser.add_argument("--variants", nargs="+", choices=tuple(VARIANTS), default=(WHOLE,))
    parser.add_argument("--edge-length", type=float, default=0.02)
    parser.add_argument("--iterations", type=int, default=60)
    options = parser.parse_args()
    rows = []
    print(HEAD, flush=True)
    for case in cases(
        tuple(options.patterns),
        tuple(options.bodies),
        tuple(options.starts),
        tuple(options.views),
        tuple(options.variants),
    ):
        rows.append(attempt(case, options))
        print(line(rows[-1]), flush=True)
        text = write_table(rows, options.out)
    print(text)


if __name__ == "__main__":
    main()
