"""A dress on a walking person: time, steps and Newton iterations of every frame (S15).

    python benchmarks/motion.py [--frames 100] [--edge-length 0.0197] [--motion walk] [--out DIR]

drapes the dress of `dress-jax demo` on the default body in the A pose and animates it at 30 frames
per second. Wall time is that of the machine as it is; processor time is the process's own, of all
its threads, which other programs on the machine change less.
"""

import argparse
import json
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import jax
import numpy as np

from dress_jax.application.animate import AnimateOptions, Animation, animate
from dress_jax.application.animation_files import save_animation
from dress_jax.application.demo import POSE, demo_patterns
from dress_jax.application.drape import DrapeOptions, drape_pattern, drape_report, save_drape
from dress_jax.application.moving_body import MotionOptions
from dress_jax.application.wearer import find_wearer
from dress_jax.io.results import read_state
from dress_jax.io.timing import stopwatch


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--edge-length", type=float, default=0.0197)
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--steps", type=int, default=1, help="implicit steps of a frame")
    parser.add_argument("--out", type=Path, help="keeps the drape and the animation")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if options.out is not None:
        measure(options.out, options)
        return
    with TemporaryDirectory() as folder:
        measure(Path(folder), options)


def measure(folder: Path, options: argparse.Namespace) -> None:
    """Drape where there is no drape yet, animate, print."""
    drape = folder / "drape"
    if not (drape / "report.json").is_file():
        wearer = find_wearer("default", dressing_pose=POSE)
        cloth = DrapeOptions(edge_length=options.edge_length)
        draped = drape_pattern(demo_patterns()[0], wearer, options=cloth)
        save_drape(drape, draped, drape_report(draped))
    wanted = AnimateOptions(motion=MotionOptions(frames=options.frames), steps=options.steps)
    began = time.perf_counter(), time.process_time()
    with stopwatch() as seconds:
        found = animate(
            read_state(drape / "drape.h5"),
            options.motion,
            folder / "animation",
            options=wanted,
            progress=told,
        )
    wall, processor = time.perf_counter() - began[0], time.process_time() - began[1]
    row = {
        "vertices": found.report["vertices"],
        "frames": found.report["frames"],
        "wall_s": wall,
        "processor_s": processor,
        "compile_s": seconds.compile,
        **summary(found),
    }
    print(json.dumps(row, indent=2))
    if options.out is not None:
        save_animation(folder / "animation", found, found.report | {"benchmark": row})


def told(stage: str, done: int, total: int, *, loss: float | None = None) -> None:
    """Every tenth frame on a line."""
    del loss
    if done % 10 == 0:
        print(f"{stage} {done}/{total} {time.process_time():.0f} s of processor", flush=True)


def summary(found: Animation) -> dict:
    """What the frames cost."""
    report, records = found.report, found.records
    iterations = np.array([record["newton_iterations"] for record in records])
    seconds = np.array([record["seconds"] for record in records])
    return {
        "intersections": report["intersections"],
        "steps": report["steps"],
        "halved_steps": report["halved_steps"],
        "unconverged_steps": report["unconverged_steps"],
        "squeezed_steps": report["squeezed_steps"],
        "newton_per_frame": {"mean": float(iterations.mean()), "largest": int(iterations.max())},
        "seconds_per_frame": {"median": float(np.median(seconds)), "largest": float(seconds.max())},
        "frames_not_free_of_body": report["body"]["frames_not_free"],
        "slip": [(row["panels"], row["median_m"]) for row in report["slip"]],
    }


if __name__ == "__main__":
    main()
