"""One contestant in its own process: solves scenes and leaves what it reached in a folder."""

import argparse
import dataclasses
import json
import resource
from pathlib import Path

import numpy as np

from benchmarks.peers import contestants, scenes

SCENES = ("drop", "stack", "drape", "settle")


def make_scene(name: str, vertices: int, steps: int) -> scenes.Scene:
    """A scene of `SCENES`; static ones have no steps."""
    if name in ("drop", "stack"):
        return getattr(scenes, name)(vertices, steps=steps)
    return getattr(scenes, name)(vertices)


def _peak_memory() -> float:
    """Of this process [MB]."""
    status = Path("/proc/self/status")
    if status.exists():
        # The counter of getrusage begins with what the parent held.
        lines = status.read_text().splitlines()
        return next(int(s.split()[1]) for s in lines if s.startswith("VmHWM")) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0**2  # macOS: bytes


def main() -> None:
    """Write SCENE.json and SCENE.npz for every scene, and contestant.json first."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=contestants.NAMES)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--vertices", type=int, required=True)
    parser.add_argument("--steps", type=int, required=True)
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, required=True)
    options = parser.parse_args()
    about = options.folder / "contestant.json"
    try:
        contestant = contestants.make(options.name)
    except ImportError as error:
        about.write_text(json.dumps({"missing": str(error)}))
        return
    for name in options.scenes:
        scene = make_scene(name, options.vertices, options.steps)
        run = contestant.run(scene, options.seconds)
        if run is None:
            continue
        about.write_text(json.dumps({"packages": contestant.packages, "solver": contestant.solver}))
        np.savez(options.folder / f"{name}.npz", positions=run.positions)
        numbers = {k: v for k, v in dataclasses.asdict(run).items() if k != "positions"}
        numbers["peak_memory_mb"] = _peak_memory()
        (options.folder / f"{name}.json").write_text(json.dumps(numbers))


if __name__ == "__main__":
    main()
