"""How a computation ended: one enumeration, carried in the solution, for every solver."""

import enum


class Result(enum.IntEnum):
    """Outcome of a solve; `message` says it in words that a user can act on."""

    CONVERGED = 0
    ITERATION_LIMIT = 1
    LINE_SEARCH_STALLED = 2
    LINEAR_SOLVE_FAILED = 3
    NON_FINITE = 4
    START_INTERSECTS = 5
    INDEFINITE_HESSIAN = 6

    @property
    def message(self) -> str:
        """What happened and what to do about it."""
        return _MESSAGES[self]


_MESSAGES = {
    Result.CONVERGED: "converged",
    Result.ITERATION_LIMIT: "the iteration limit was reached before the step size fell below the "
    "tolerance; allow more iterations or loosen the tolerance",
    Result.LINE_SEARCH_STALLED: "no step along the search direction lowers the energy any more; "
    "the tolerance may be below what double precision can reach here",
    Result.LINEAR_SOLVE_FAILED: "the linear system could not be solved; check for zero mass, "
    "zero-area rest triangles and non-finite parameters",
    Result.NON_FINITE: "a non-finite number appeared; check the parameters",
    Result.START_INTERSECTS: "the start state has intersections, which a barrier cannot undo",
    Result.INDEFINITE_HESSIAN: "the Hessian at the solution has a direction of negative curvature, "
    "so the state is not a stable equilibrium and has no derivative",
}
