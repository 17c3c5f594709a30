"""Which solver is used: by name, or the fastest that the platform has."""

import contextlib
import importlib.util

import jax

from dress_jax.core.errors import InputError
from dress_jax.solver.linear.interface import LinearSolver


def available_solvers() -> tuple[str, ...]:
    """Names of the solvers that can be made here, fastest first (benchmarks/linear.py)."""
    names = ["superlu", "two-level-cg"]
    if importlib.util.find_spec("pypardiso") is not None:
        names.insert(0, "pardiso")
    return tuple(names)


def one_thread() -> contextlib.AbstractContextManager[None]:
    """Within it, direct solvers compute in the calling thread alone.

    For several solves at once: each with threads of its own, they would wait for each other.
    """
    if importlib.util.find_spec("pypardiso") is None:
        return contextlib.nullcontext()
    from dress_jax.solver.linear.pardiso import one_mkl_thread

    return one_mkl_thread()


def make_solver(name: str = "auto") -> LinearSolver:
    """A new solver.

    Args:
        name: one of `available_solvers()`, or "auto": the first of them where jax computes on the
            processor, and conjugate gradients, which stay where the arrays are, everywhere else.
            The chosen solver's name is part of every solution's statistics.

    Raises:
        InputError: there is no solver of that name here.
    """
    names = available_solvers()
    chosen = name
    if name == "auto":
        chosen = names[0] if jax.default_backend() == "cpu" else "two-level-cg"
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
