"""Sparse Cholesky from oneMKL (x86 only): the fastest measured choice on CPU."""

import contextlib
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pypardiso
import scipy.sparse
from jaxtyping import Float
from pypardiso.pardiso_wrapper import PyPardisoError

from dress_jax.solver.linear.interface import LinearSolveError

_SYMMETRIC_POSITIVE_DEFINITE = 2
_ANALYZE, _FACTORIZE, _SOLVE, _RELEASE = 11, 22, 33, -1


@contextlib.contextmanager
def one_mkl_thread() -> Iterator[None]:
    """Calls of the library from this thread compute in this thread alone."""
    library: Any = pypardiso.PyPardisoSolver(mtype=_SYMMETRIC_POSITIVE_DEFINITE).libmkl
    before = library.MKL_Set_Num_Threads_Local(1)
    try:
        yield
    finally:
        library.MKL_Set_Num_Threads_Local(before)


class _PardisoFactorization:
    """A numeric factorization; refactorizes itself if the solver has moved on."""

    def __init__(self, owner: "PardisoSolver", matrix: scipy.sparse.csr_matrix):
        self._owner = owner
        self._matrix = matrix

    def solve(self, right_hand_side: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        if self._owner.current is not self._matrix:
            self._owner.load(self._matrix)
        b = np.asfortranarray(right_hand_side, np.float64)
        return self._owner.call(_SOLVE, self._matrix, b)


class PardisoSolver:
    """One Pardiso handle; the symbolic analysis is kept while the pattern stays the same."""

    name = "pardiso"

    def __init__(self) -> None:
        self.current: scipy.sparse.csr_matrix | None = None
        self._analyzed: tuple[np.ndarray, np.ndarray] | None = None
        # Made once: the constructor searches the file system for the library.
        self._handle = pypardiso.PyPardisoSolver(mtype=_SYMMETRIC_POSITIVE_DEFINITE)
        self._handle.set_iparm(1, 1)  # all parameters given, none taken as default
        self._handle.set_iparm(2, 2)  # nested dissection ordering
        self._handle.set_iparm(8, 0)  # refinement doubles the time of a solve and gains no digit
        self._handle.set_iparm(10, 8)
        self._handle.set_iparm(34, 2)  # conditional reproducibility, two threads
        self._handle.set_iparm(24, 1)  # two-level parallel factorization

    def call(self, phase: int, matrix: scipy.sparse.csr_matrix, b: np.ndarray) -> np.ndarray:
        """Run one phase."""
        self._handle.set_phase(phase)
        try:
            return self._handle._call_pardiso(matrix, b)
        except PyPardisoError as error:
            # After an error the handle's memory is undefined, so the next call starts afresh.
            self.release()
            raise LinearSolveError(
                f"the sparse Cholesky factorization failed (Pardiso error {error.value})"
            ) from error

    def load(self, matrix: scipy.sparse.csr_matrix) -> None:
        """Make `matrix` the factorized one."""
        b = np.zeros(len(matrix.indptr) - 1)
        known = self._analyzed
        if (
            known is None
            or not np.array_equal(known[0], matrix.indptr)
            or not np.array_equal(known[1], matrix.indices)
        ):
            if known is not None:
                self.release()
            self.call(_ANALYZE, matrix, b)
            self._analyzed = (matrix.indptr, matrix.indices)
        self.current = None
        self.call(_FACTORIZE, matrix, b)
        self.current = matrix

    def release(self) -> None:
        """Free the library's memory and start afresh."""
        empty = scipy.sparse.csr_matrix((0, 0))
        self._handle.set_phase(_RELEASE)
        with contextlib.suppress(PyPardisoError):  # nothing was allocated yet
            self._handle._call_pardiso(empty, np.zeros(0))
        self._handle.pt[:] = 0
        self.current, self._analyzed = None, None

    def factorize(
        self,
        upper: scipy.sparse.csr_matrix,
        positions: Float[np.ndarray, "nodes 3"] | None = None,
    ) -> _PardisoFactorization:
        if not np.all(np.isfinite(upper.data)):
            raise LinearSolveError("the matrix has entries that are not finite")
        self.load(upper)
        return _PardisoFactorization(self, upper)

    def __del__(self) -> None:
        if getattr(self, "_analyzed", None) is not None and not sys.is_finalizing():
            self.release()
