"""Linear solvers behind one interface, and Newton's method."""

from dress_jax.solver.newton import NewtonOptions, NewtonProgress, NewtonSolution, minimize

__all__ = ["NewtonOptions", "NewtonProgress", "NewtonSolution", "minimize"]
