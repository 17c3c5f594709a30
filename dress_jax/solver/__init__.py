"""Linear solvers behind one interface, and Newton's method."""
