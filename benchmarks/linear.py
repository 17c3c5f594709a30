"""The linear solvers on Hessians of a cloth that is falling over a sphere.

    python benchmarks/linear.py [--sides 50 100] [--json times.json]

Each Hessian is that of Newton's method, projected, after some iterations of a drape of
`benchmarks/derivatives.py`. `first` is the first factorization, with the analysis of the sparsity,
`factor` one with values alone changed, `solve` one back-substitution, and `residual` what is left
of the right-hand side, relative to it. An iterative solver says how many iterations a solve took,
and one that gives up says why.
"""

import argparse
import dataclasses
import json
import statistics
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import scipy.sparse
from derivatives import scene

from dress_jax.sim import static_solve
from dress_jax.solver import NewtonOptions
from dress_jax.solver.linear import LinearSolveError, available_solvers, make_solver

ITERATIONS = 12
RUNS = 5


class Recorder:
    """A linear solver that keeps the last matrix it was given."""

    name = "recorder"

    def __init__(self) -> None:
        self._solver = make_solver("auto")
        self.upper = scipy.sparse.csr_matrix((0, 0))
        self.positions = np.zeros((0, 3))

    def factorize(self, upper, positions=None):
        """The factorization."""
        self.upper, self.positions = upper.copy(), positions
        return self._solver.factorize(upper, positions)


def hessian(side: int) -> tuple[scipy.sparse.csr_matrix, np.ndarray]:
    """The upper triangle of a projected Hessian, and where it was taken [m]."""
    simulator, parameters, start = scene(side)
    recorder = Recorder()
    options = NewtonOptions(iteration_limit=ITERATIONS)
    static_solve(
        dataclasses.replace(simulator, linear_solver=recorder, newton=options), parameters, start
    )
    return recorder.upper, recorder.positions


def measure(name: str, upper: scipy.sparse.csr_matrix, positions: np.ndarray) -> dict[str, Any]:
    """Times of one solver [s]."""
    full = upper + scipy.sparse.triu(upper, 1).T
    b = np.random.default_rng(0).normal(size=full.shape[0])
    solver = make_solver(name)
    factor, solve = [], []
    try:
        for run in range(RUNS + 1):
            changed = scipy.sparse.csr_matrix(
                (upper.data * (1.0 + 0.01 * run), upper.indices, upper.indptr), shape=upper.shape
            )
            start = time.perf_counter()
            factorization = solver.factorize(changed, positions)
            factor.append(time.perf_counter() - start)
            start = time.perf_counter()
            x = factorization.solve(b)
            solve.append(time.perf_counter() - start)
    except LinearSolveError as error:
        return {"solver": name, "failed": str(error)}
    iterations = getattr(factorization, "iterations", None)
    residual = np.linalg.norm((1.0 + 0.01 * RUNS) * (full @ x) - b) / np.linalg.norm(b)
    return {
        "solver": name,
        "first_seconds": factor[0],
        "factor_seconds": statistics.median(factor[1:]),
        "solve_seconds": statistics.median(solve[1:]),
        "residual": float(residual),
        **({} if iterations is None else {"iterations": iterations}),
    }


def main() -> None:
    """Print a table, and write it as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sides", type=int, nargs="+", default=[50, 100])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    report = []
    print(f"{'unknowns':>9} {'entries':>9} {'solver':>16} {'first':>9} {'factor':>9} {'solve':>9}")
    for side in options.sides:
        upper, positions = hessian(side)
        for name in available_solvers():
            row = {
                "unknowns": upper.shape[0],
                "entries": upper.nnz,
                **measure(name, upper, positions),
            }
            report.append(row)
            times = "  ".join(
                f"{1e3 * row[key]:7.1f}"
                for key in ("first_seconds", "factor_seconds", "solve_seconds")
                if key in row
            )
            ending = row.get("failed") or f"{times} ms, residual {row['residual']:.1e}"
            if "iterations" in row:
                ending += f", {row['iterations']} iterations"
            print(f"{row['unknowns']:9d} {row['entries']:9d} {name:>16}  {ending}", flush=True)
    if options.json is not None:
        options.json.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
