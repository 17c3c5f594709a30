"""Sparse linear solvers behind one interface."""

from dress_jax.solver.linear.choice import available_solvers, make_solver, one_thread
from dress_jax.solver.linear.interface import Factorization, LinearSolveError, LinearSolver

__all__ = [
    "Factorization",
    "LinearSolveError",
    "LinearSolver",
    "available_solvers",
    "make_solver",
    "one_thread",
]
