"""Which solver is used: by name, or the fastest that the platform has."""

import importlib.util

from dress_jax.core.errors import InputError
from dress_jax.solver.linear.interface import LinearSolver


def available_solvers() -> tuple[str, ...]:
    """Names of the solvers that can be made here, fastest first (benchmarks/linear.py)."""
    names = ["superlu", "two-level-cg"]
    if importlib.util.find_spec("pypardiso") is not None:
        names.insert(0, "pardiso")
    return tuple(names)


def make_solver(name: str = "auto") -> LinearSolver:
    """A new solver.

    Args:
        name: one of `available_solvers()`, or "auto" for the first of them. The chosen solver's
            name is part of every solution's statistics.

    Raises:
        InputError: there is no solver of that name here.
    """
    names = available_solvers()
    chosen = names[0] if name == "auto" else name
    if chosen not in names:
        raise InputError(f"unknown linear solver {name!r}", mend=f"choose one of {names}")
    if chosen == "pardiso":
        from dress_jax.solver.linear.pardiso import PardisoSolver

        return PardisoSolver()
    if chosen == "superlu":
        from dress_jax.solver.linear.superlu import SuperluSolver

        return SuperluSolver()
    from dress_jax.solver.linear.two_level import TwoLevelSolver

    return TwoLevelSolver()
