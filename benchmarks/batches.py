"""How many drapes a second: several designs, bodies and fabrics at once.

    python benchmarks/batches.py [--vertices 2500] [--sizes 1 2 4 8] [--json times.json]

A T-shirt is dressed and draped once. Then each batch holds changes of it, by up to 1 % in its
pattern, its density and its body's girth, and is solved by `jax.vmap`, with the gradient of a loss
in all of them. Beside it the same drapes one after the other, in the same process; each way runs
once to compile and to grow its sparsity, and once to measure.
"""

import argparse
import dataclasses
import json
import platform
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from newton import dressed  # noqa: E402

from dress_jax.core.pytree import replace  # noqa: E402
from dress_jax.core.results import Result  # noqa: E402
from dress_jax.sim import static_solve  # noqa: E402
from dress_jax.solver import NewtonOptions  # noqa: E402

LARGEST_CHANGE = 0.01


def designs(size: int) -> jax.Array:
    """Factors of rest shape, density and girth of the body, (size, 3)."""
    changes = LARGEST_CHANGE * np.random.default_rng(0).uniform(-1.0, 1.0, (size, 3))
    # The body gets a little thinner only, which leaves the start free of intersections.
    changes[:, 2] = -0.2 * np.abs(changes[:, 2])
    return jnp.asarray(1.0 + changes)


def seconds(run: Callable[[], Any]) -> tuple[float, Any]:
    """Time of the second of two runs, and its result."""
    jax.block_until_ready(run())
    start = time.perf_counter()
    result = jax.block_until_ready(run())
    return time.perf_counter() - start, result


def measure(draped, size: int) -> dict[str, Any]:
    """One batch, both ways."""
    parameters, start = draped.parameters, jnp.asarray(draped.positions)
    axis = jnp.asarray([1.0, 0.0, 1.0])

    def loss(simulator, factors):
        girth = factors[2] * axis + (1.0 - axis)
        changed = replace(
            parameters,
            rest_positions=factors[0] * parameters.rest_positions,
            density=factors[1] * parameters.density,
            body_vertices=girth * parameters.body_vertices,
        )
        drape = static_solve(simulator, changed, start)
        return jnp.mean(drape.positions[:, 1]), drape.report

    batch = designs(size)
    simulator = dataclasses.replace(draped.simulator, newton=NewtonOptions())
    together = jax.vmap(lambda f: jax.value_and_grad(lambda g: loss(simulator, g), has_aux=True)(f))
    batched, ((_, report), slopes) = seconds(lambda: together(batch))
    alone = dataclasses.replace(draped.simulator, newton=NewtonOptions())

    def one_by_one():
        return [
            jax.value_and_grad(lambda g: loss(alone, g), has_aux=True)(factors) for factors in batch
        ]

    single, results = seconds(one_by_one)
    return {
        "size": size,
        "workers": simulator.workers,
        "vertices": len(draped.positions),
        "converged": int(jnp.sum(report.result == Result.CONVERGED)),
        "intersections": int(jnp.sum(report.self_intersections + report.body_intersections)),
        "iterations": [int(k) for k in report.iterations],
        "vmap_seconds": batched,
        "loop_seconds": single,
        "designs_per_second": size / batched,
        "throughput_ratio": single / batched,
        "largest_difference_of_gradients": float(
            max(
                jnp.max(jnp.abs(slope - other[1])) / jnp.max(jnp.abs(other[1]))
                for slope, other in zip(slopes, results, strict=True)
            )
        ),
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


def main() -> None:
    """Print a table, and write it as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vertices", type=int, default=2500)
    parser.add_argument("--sizes", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    draped = dressed(options.vertices)
    rows = []
    print(f"{len(draped.positions)} vertices, {draped.simulator.workers} workers")
    print(f"{'batch':>5} {'vmap, s':>8} {'loop, s':>8} {'ratio':>6} {'drapes/s':>9} {'MB':>6}")
    for size in options.sizes:
        row = measure(draped, size)
        rows.append(row)
        print(
            f"{size:5d} {row['vmap_seconds']:8.2f} {row['loop_seconds']:8.2f} "
            f"{row['throughput_ratio']:6.2f} {row['designs_per_second']:9.3f} "
            f"{row['peak_memory_mb']:6.0f}  iterations {row['iterations']}, "
            f"{row['intersections']} intersections",
            flush=True,
        )
    if options.json is not None:
        report = {"machine": platform.processor() or platform.machine(), "jax": jax.__version__}
        options.json.write_text(json.dumps({**report, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
