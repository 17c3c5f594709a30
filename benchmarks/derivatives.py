"""Time of the derivative of a drape beside the drape itself: square cloths over a sphere.

    python benchmarks/derivatives.py [--sides 32 50 100] [--runs 3] [--directions 100]
                                     [--json times.json]

A square of 60 cm, held at two corners, falls onto a sphere and comes to rest in contact. Each size
is solved twice:

    cold    from the flat square
    warm    from that drape, with the rest shape and both stiffnesses increased by 1 %: what an
            iteration of a fit does

The forward time is that of `static_solve` through `jax.vjp`. The backward time is that of pulling a
random cotangent back into every parameter: conjugate gradients with the exact Hessian, in `CG`
iterations that take the time `solve`, and the product with the mixed derivative. `forward mode` is
the sensitivity of the drape to --directions random changes of the rest shape: one factorization of
the exact Hessian, and a mixed derivative and a back-substitution for each. `compile` is what
the first of several equal calls takes longer than the median of the others, which is what the other
columns show; without a compilation, such as in the warm case, it is noise.

The default sizes, 1,024 and 2,500 vertices, take eight minutes on two cores, most of it in the
repeated forward solves; 10,000 vertices (`--sides 100 --runs 1`) are not done in twelve.
An exactly flat start is the worst case of the exact intersection test, which decides pairs in one
plane in rational arithmetic: 5 and 11 s of the cold forward times (20 and 30 ms otherwise).
"""

import argparse
import dataclasses
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import trimesh

from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import STRETCHING_LEAVES
from dress_jax.energy.fabric import named_fabric
from dress_jax.sim import Parameters, Simulator, adjoint, make_cloth, make_simulation
from dress_jax.sim.sensitivity import static_sensitivity
from dress_jax.sim.solve import static_solve

SIZE, RADIUS, GAP = 0.6, 0.15, 0.005  # [m]
CHANGE = 1.01


def scene(side: int) -> tuple[Simulator, Parameters, np.ndarray]:
    """A flat square of `side` vertices a side above a sphere."""
    s = np.linspace(-SIZE / 2, SIZE / 2, side)
    a, b = (part.ravel() for part in np.meshgrid(s, s, indexing="ij"))
    i = np.arange(side * side).reshape(side, side)
    lower = np.stack([i[:-1, :-1], i[1:, :-1], i[1:, 1:]], axis=-1).reshape(-1, 3)
    upper = np.stack([i[:-1, :-1], i[1:, 1:], i[:-1, 1:]], axis=-1).reshape(-1, 3)
    start = np.stack([a, np.full(side * side, RADIUS + GAP), -b], axis=1)
    pins = np.array([0, side - 1])
    cloth = make_cloth(np.concatenate([lower, upper]), pins=pins)
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    simulator, parameters = make_simulation(
        cloth,
        start,
        np.stack([a, b], axis=1),
        fabric=named_fabric("cotton"),
        body_vertices=np.asarray(sphere.vertices),
        body_faces=np.asarray(sphere.faces),
        pin_targets=start[pins],
    )
    return simulator, parameters, start


def timed(function: Callable[[], Any], runs: int) -> tuple[Any, dict[str, float]]:
    """The last result, the median time, and how much longer the first call took [s]."""
    seconds = []
    for _ in range(runs + 1):
        start = time.perf_counter()
        result = jax.block_until_ready(function())
        seconds.append(time.perf_counter() - start)
    run = statistics.median(seconds[1:])
    return result, {"seconds": run, "compile_seconds": max(seconds[0] - run, 0.0)}


class AdjointWatch:
    """Iterations of the last adjoint solve, and seconds of all; the solves report neither."""

    def __init__(self) -> None:
        self.iterations, self.seconds = 0, list[float]()
        self._original = adjoint.conjugate_gradient

    def __enter__(self) -> "AdjointWatch":
        adjoint.conjugate_gradient = self._counted
        return self

    def __exit__(self, *_: object) -> None:
        adjoint.conjugate_gradient = self._original

    def _counted(self, *arguments: Any, **options: Any) -> Any:
        start = time.perf_counter()
        solved = self._original(*arguments, **options)
        self.iterations = solved.iterations
        self.seconds.append(time.perf_counter() - start)
        return solved


def measure(
    simulator: Simulator, parameters: Parameters, start: np.ndarray, runs: int, directions: int
) -> tuple[jax.Array, dict[str, Any]]:
    """The drape, and one row of the table."""

    def forward():
        # A copy: every run begins with the sparsity of the cloth alone.
        own = dataclasses.replace(simulator)

        def solve(parameters):
            drape = static_solve(own, parameters, start)
            return drape.positions, drape.report

        positions, pull, report = jax.vjp(solve, parameters, has_aux=True)
        return positions, jax.tree_util.Partial(pull), report

    (positions, pull, report), forward_times = timed(forward, runs)
    cotangent = jnp.asarray(np.random.default_rng(0).normal(size=positions.shape))
    with AdjointWatch() as watch:
        (gradient,), backward_times = timed(lambda: pull(cotangent), runs)
    shape = (directions, *parameters.rest_positions.shape)
    along = {"rest_positions": jnp.asarray(np.random.default_rng(1).normal(size=shape))}

    def sensitivity():
        own = dataclasses.replace(simulator)
        return static_sensitivity(own, parameters, np.asarray(positions), along)

    _, sensitivity_times = timed(sensitivity, runs)
    reach = float(simulator.settings.dhat + simulator.settings.thickness)
    return positions, {
        "vertices": len(start),
        "converged": report.converged,
        "in_contact": float(report.smallest_distance) < reach,
        "newton_iterations": int(report.iterations),
        "forward": forward_times,
        "backward": backward_times,
        "adjoint_iterations": watch.iterations,
        "adjoint_solve_seconds": statistics.median(watch.seconds[1:]),
        "finite": bool(all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient))),
        "ratio": backward_times["seconds"] / forward_times["seconds"],
        "sensitivity": sensitivity_times,
        "sensitivity_ratio": sensitivity_times["seconds"] / forward_times["seconds"],
    }


def cases(side: int, runs: int, directions: int) -> dict[str, dict[str, Any]]:
    """Cold and warm."""
    simulator, parameters, start = scene(side)
    drape, cold = measure(simulator, parameters, start, runs, directions)
    changed = replace(
        parameters,
        rest_positions=CHANGE * parameters.rest_positions,
        **{name: CHANGE * getattr(parameters, name) for name in STRETCHING_LEAVES},
        bending_stiffness=CHANGE * parameters.bending_stiffness,
    )
    _, warm = measure(simulator, changed, np.asarray(drape), runs, directions)
    return {"cold": cold, "warm": warm}


def main() -> None:
    """Print a table, and write it as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sides", type=int, nargs="+", default=[32, 50])
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--directions", type=int, default=100)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    report = {"device": jax.devices()[0].platform, "jax": jax.__version__, "sides": {}}
    print(
        f"{'vertices':>8} {'start':>5} {'Newton':>7} {'forward':>9} {'compile':>8} "
        f"{'CG':>4} {'backward':>9} {'solve':>8} {'compile':>8} {'ratio':>6} "
        f"{'forward mode':>13} {'compile':>8} {'ratio':>6}"
    )
    for side in options.sides:
        rows = cases(side, options.runs, options.directions)
        report["sides"][str(side)] = rows
        for start, row in rows.items():
            forward, backward = row["forward"], row["backward"]
            faults = ("" if row["converged"] else "  not converged") + (
                "" if row["finite"] else "  the gradient is NaN"
            )
            print(
                f"{row['vertices']:8d} {start:>5} {row['newton_iterations']:7d} "
                f"{forward['seconds']:8.2f}s {forward['compile_seconds']:7.1f}s "
                f"{row['adjoint_iterations']:4d} {backward['seconds']:8.3f}s "
                f"{row['adjoint_solve_seconds']:7.3f}s {backward['compile_seconds']:7.1f}s "
                f"{100 * row['ratio']:5.1f}% {row['sensitivity']['seconds']:12.3f}s "
                f"{row['sensitivity']['compile_seconds']:7.1f}s "
                f"{100 * row['sensitivity_ratio']:5.1f}%{faults}",
                flush=True,
            )
    text = json.dumps(report, indent=1)
    if options.json is None:
        print(text)
    else:
        options.json.write_text(text + "\n")


if __name__ == "__main__":
    main()
