"""Where the time of a Newton iteration goes, on a T-shirt worn by the default body.

    python benchmarks/newton.py [--scene t_shirt stack] [--vertices 1000 2500 10000 40000]
                                [--linear-solver NAME] [--json times.json]

`t_shirt`: each size is dressed and draped once. Then its pattern is changed by 1 %, and the drape
is solved again from where it was. `stack`: two steps of two sheets that fall on each other (the
scene of `benchmarks.peers`), at most 25 iterations each. Every solve runs once to compile, once to
measure. Stages are timed apart, each until its result is there; what they take together is less
than the solve, which is given beside them. `contacts` are the pairs closer than dhat at the end.
Each case has a process of its own, so that peak memory is its own.
The solve ends when no vertex would move by 0.01 mm; `on the way` says after how many iterations and
seconds steps had become shorter than other lengths, on average over the vertices (rms).
"""

import argparse
import collections
import dataclasses
import itertools
import json
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(Path(__file__).parents[1]))  # for `benchmarks.peers`

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from benchmarks.peers.contestants.dress import build  # noqa: E402
from benchmarks.peers.scenes import stack  # noqa: E402
from dress_jax.application.drape import DrapeOptions, DrapeResult, drape_pattern  # noqa: E402
from dress_jax.application.tailor import template_measurements  # noqa: E402
from dress_jax.application.wearer import find_wearer  # noqa: E402
from dress_jax.body.model import named_shape  # noqa: E402
from dress_jax.core.pytree import replace  # noqa: E402
from dress_jax.energy.cloth import Parameters  # noqa: E402
from dress_jax.io.bodies import load_default_body  # noqa: E402
from dress_jax.pattern import Pattern, discretize  # noqa: E402
from dress_jax.pattern.templates import t_shirt  # noqa: E402
from dress_jax.sim import (  # noqa: E402
    Simulator,
    State,
    equilibrium,
    kernels,
    objective,
    static_solve,
    step,
)
from dress_jax.sim.equilibrium import Report  # noqa: E402
from dress_jax.solver import NewtonOptions, newton  # noqa: E402
from dress_jax.solver.linear import make_solver  # noqa: E402

CHANGE = 1.01
STACK_LIMIT = 25  # Newton iterations of a step
MILESTONES = (1e-3, 1e-4, 1e-5)  # rms of a step [m]
STAGES = (
    (objective.StepObjective, "_cover", "broad phase"),
    (kernels, "find_active", "active set"),
    (objective.StepObjective, "_contact_slots", "contact slots"),
    (objective.StepObjective, "factorize", "blocks and assembly"),
    (objective.StepObjective, "step_bound", "step bound"),
    (objective.StepObjective, "value", "energy"),
    (objective.StepObjective, "value_and_gradient", "gradient"),
    (objective.StepObjective, "hessian_product", "Hessian products"),
    (newton, "_direction", "conjugate gradients"),
    (equilibrium, "_count_intersections", "exact test (once a solve)"),
)


class StageClock:
    """Seconds per stage, without those of the stages inside of it."""

    def __init__(self) -> None:
        self.seconds = collections.defaultdict[str, float](float)
        self._inner: list[float] = []

    def timed(self, function: Callable[..., Any], stage: str) -> Callable[..., Any]:
        """The function, timed."""

        def call(*arguments: Any, **options: Any) -> Any:
            start = time.perf_counter()
            self._inner.append(0.0)
            result = jax.block_until_ready(function(*arguments, **options))
            taken = time.perf_counter() - start
            self.seconds[stage] += taken - self._inner.pop()
            if self._inner:
                self._inner[-1] += taken
            return result

        return call


class TimedSolver:
    """A linear solver whose factorizations and solves are timed."""

    def __init__(self, name: str, clock: StageClock):
        solver = make_solver(name)
        self.name, self._clock = solver.name, clock
        self._factorize = clock.timed(solver.factorize, "factorization")

    def factorize(self, upper, positions=None):
        """The factorization, which times its solves."""
        return _TimedFactorization(self._factorize(upper, positions), self._clock)


class _TimedFactorization:
    def __init__(self, factorization, clock: StageClock):
        self.solve = clock.timed(factorization.solve, "back-substitution")


class Milestones:
    """When steps became short."""

    def __init__(self) -> None:
        self.begin(np.zeros((0, 3)))

    def begin(self, positions: np.ndarray) -> None:
        """Of a solve that starts at the positions."""
        self._start, self._before = time.perf_counter(), positions
        self.reached: dict[float, tuple[int, float]] = {}

    def __call__(self, progress: newton.NewtonProgress) -> None:
        step = (progress.positions - self._before) / progress.step_length
        self._before = progress.positions
        rms = float(np.sqrt(np.mean(np.sum(step**2, axis=1))))
        seconds = time.perf_counter() - self._start
        for length in MILESTONES:
            if rms > length:
                self.reached.pop(length, None)
            else:
                self.reached.setdefault(length, (progress.iteration, seconds))


def edge_length(pattern: Pattern, vertices: int) -> float:
    """With which the pattern gets about so many vertices [m]."""
    length = 0.02
    for _ in range(3):
        length *= (discretize(pattern, length).vertex_count / vertices) ** 0.5
    return length


def dressed(vertices: int) -> DrapeResult:
    """The T-shirt, draped."""
    model = load_default_body()
    pattern = t_shirt(template_measurements(model, np.asarray(named_shape(model, "average"))))
    options = DrapeOptions(edge_length=edge_length(pattern, vertices))
    return drape_pattern(pattern, find_wearer("default", pose="a"), options=options)


Solve = Callable[[Simulator], tuple[jax.Array, Report]]


def measure(
    simulator: Simulator, parameters: Parameters, solve: Solve, solver: str, start: np.ndarray
) -> tuple[jax.Array, dict[str, Any]]:
    """Where a solve ends, and its times; the second of two runs.

    Args:
        simulator, parameters: of the solve.
        solve: takes a simulator, and gives positions and report.
        solver: name of the linear solver.
        start: where the solve starts [m].
    """
    clock, milestones = StageClock(), Milestones()
    replaced = [(owner, name, getattr(owner, name)) for owner, name, _ in STAGES]
    for owner, name, stage in STAGES:
        setattr(owner, name, clock.timed(getattr(owner, name), stage))
    timed = dataclasses.replace(
        simulator, linear_solver=TimedSolver(solver, clock), progress=milestones
    )
    seconds = []
    try:
        for _ in range(2):
            clock.seconds.clear()
            milestones.begin(start)
            begin = time.perf_counter()
            positions, report = solve(dataclasses.replace(timed))
            seconds.append(time.perf_counter() - begin)
    finally:
        for owner, name, original in replaced:
            setattr(owner, name, original)
    iterations = max(int(report.iterations), 1)
    return positions, {
        "vertices": len(positions),
        "contacts": contacts(simulator, parameters, positions),
        "converged": report.converged,
        "newton_iterations": int(report.iterations),
        "solve_seconds": seconds[1],
        "first_seconds": seconds[0] - seconds[1],
        "on_the_way": {f"{1e3 * rms:g} mm": when for rms, when in milestones.reached.items()},
        "iteration_ms": 1e3 * seconds[1] / iterations,
        "stages_ms": {stage: 1e3 * s / iterations for stage, s in clock.seconds.items()},
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


def t_shirt_rows(vertices: int, solver: str) -> Iterator[dict[str, Any]]:
    """The drape of a pattern that has grown, from the one before."""
    start = time.perf_counter()
    draped = dressed(vertices)
    put_on = time.perf_counter() - start
    parameters = draped.parameters
    changed = replace(parameters, rest_positions=CHANGE * parameters.rest_positions)

    def solve(own: Simulator) -> tuple[jax.Array, Report]:
        drape = static_solve(own, changed, jnp.asarray(draped.positions))
        return drape.positions, drape.report

    simulator = dataclasses.replace(draped.simulator, newton=NewtonOptions())
    _, row = measure(simulator, changed, solve, solver, draped.positions)
    yield {"scene": "t_shirt", "dress_and_drape_seconds": put_on, **row}


def stack_rows(vertices: int, solver: str) -> Iterator[dict[str, Any]]:
    """Two steps of two sheets that fall on each other."""
    scene = stack(vertices, steps=2)
    simulator, parameters = build(scene)
    simulator.newton = dataclasses.replace(simulator.newton, iteration_limit=STACK_LIMIT)
    state = State(jnp.asarray(scene.start), jnp.zeros(scene.start.shape))
    for number in range(scene.steps):

        def solve(own: Simulator, state: State = state) -> tuple[jax.Array, Report]:
            after, report = step(own, state, parameters, time_step=scene.time_step)
            return after.positions, report

        positions, row = measure(simulator, parameters, solve, solver, np.asarray(state.positions))
        yield {"scene": f"stack, step {number + 1}", **row}
        state = State(positions, (positions - state.positions) / scene.time_step)


ROWS = {"t_shirt": t_shirt_rows, "stack": stack_rows}


def contacts(simulator, parameters, positions) -> int:
    """Number of pairs closer than dhat."""
    found = objective.resting_objective(simulator, parameters, positions)
    return sum(int(pairs.count) for pairs in found.contacts(np.asarray(positions)))


def show(row: dict[str, Any]) -> None:
    """One row, with its stages."""
    print(
        f"\n{row['scene']}: {row['vertices']} vertices, {row['contacts']} contacts: "
        f"{row['newton_iterations']} Newton iterations in {row['solve_seconds']:.2f} s"
        f"{'' if row['converged'] else ' (not converged)'}, "
        f"{row['iteration_ms']:.0f} ms each; the first {row['first_seconds']:.1f} s more; "
        f"peak memory {row['peak_memory_mb']:.0f} MB"
    )
    for length, (iteration, seconds) in row["on_the_way"].items():
        print(f"    steps of {length} (rms) after {iteration} iterations, {seconds:.2f} s")
    for stage, ms in sorted(row["stages_ms"].items(), key=lambda item: -item[1]):
        print(f"    {stage:28s} {ms:8.1f} ms an iteration", flush=True)


def in_a_process(name: str, vertices: int, solver: str) -> list[dict[str, Any]]:
    """The rows of one case, from a process of its own: peak memory is that of a process."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rows.json"
        case = ["--scene", name, "--vertices", str(vertices), "--linear-solver", solver]
        subprocess.run([sys.executable, __file__, *case, "--json", str(file)], check=True)
        return json.loads(file.read_text())["rows"]


def main() -> None:
    """Print a table, and write it as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vertices", type=int, nargs="+", default=[2500, 10000])
    parser.add_argument("--scene", choices=ROWS, nargs="+", default=list(ROWS))
    parser.add_argument("--linear-solver", default="auto")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    cases = list(itertools.product(options.scene, options.vertices))
    for name, vertices in cases:
        if len(cases) > 1:
            rows += in_a_process(name, vertices, options.linear_solver)
            continue
        for row in ROWS[name](vertices, options.linear_solver):
            rows.append(row)
            show(row)
    report = {"machine": platform.processor() or platform.machine(), "jax": jax.__version__}
    if options.json is not None:
        options.json.write_text(json.dumps({**report, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
