"""Conjugate gradients with a two-level preconditioner: no factorization outside of JAX.

The preconditioner is additive Schwarz: the inverses of overlapping dense diagonal blocks (patches),
plus a coarse correction by the rigid motions of aggregates of nodes. Both are cut from the graph of
the matrix where it is coupled weakly, so that a stiff contact lies inside of them. A solve is one
program with one loop; the host's part depends on the sparsity alone and is kept.

Additive Schwarz with overlap and a coarse space: Smith, Bjorstad and Gropp, Domain Decomposition
(1996), chapters 1 and 2; rigid motions as coarse space: Vanek, Mandel and Brezina, Algebraic
multigrid by smoothed aggregation for second and fourth order elliptic problems (1996).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Bool, Float, Int

from dress_jax.core.pytree import pytree
from dress_jax.solver.linear.dense import definite_inverse
from dress_jax.solver.linear.interface import LinearSolveError
from dress_jax.solver.linear.layout import Layout, make_layout, padded_data

_RELATIVE_TOLERANCE = 1e-10
_ITERATION_LIMIT = 5_000
# Relative residual that will do where rounding keeps the iterations from the tolerance: a Newton
# step is off by no more than that, and derivatives check their own.
_SUFFICIENT = 1e-8
# Squared residuals of two beginnings: above this share the rest is rounding.
_DRIFT = 0.25
# Right-hand sides that are solved together: matrices are read once for all of them.
_TOGETHER = 8
# Of its diagonal, added to the coarse matrix: modes of collinear nodes depend on each other.
_COARSE_SHIFT = 1e-12

Vector = Float[Array, "3 n"]


@pytree
class TwoLevelSystem:
    """A matrix and its preconditioner.

    Attributes:
        rows: blocks of the product, component (i, j) in entry 3 i + j.
        patches: inverses of the patches' matrices.
        coarse: inverse of the coarse matrix.
        offsets: of the nodes from the centres of their aggregates, in units of their size.
    """

    rows: Float[Array, "9 width rows"]
    patches: Float[Array, "patches q q"]
    coarse: Float[Array, "modes modes"]
    offsets: Vector


class Solved(NamedTuple):
    """Where conjugate gradients ended.

    Attributes:
        solution: x.
        converged: whether |b - A x| <= tolerance |b|, or as small as rounding lets it become and
            sufficient.
        iterations: number of products with A.
        curvature: the last p^T A p; where it is not positive, the matrix is not positive definite.
    """

    solution: Vector
    converged: Bool[Array, ""]
    iterations: Int[Array, ""]
    curvature: Float[Array, ""]


# Set-up


@jax.jit
def prepare(
    data: Float[Array, " capacity"], positions: Vector, layout: Layout
) -> tuple[TwoLevelSystem, Bool[Array, ""]]:
    """The system of a matrix, and whether all dense factorizations went well.

    Args:
        data: see `layout.padded_data`.
        positions: of the nodes; zero where they are not known.
        layout: of the matrix.
    """
    upper = data[layout.entries]
    transposed = upper[:, np.array([0, 3, 6, 1, 4, 7, 2, 5, 8])]
    blocks = jnp.concatenate([upper, transposed])
    rows = jnp.moveaxis(blocks[layout.row_blocks], -1, 0)

    patches, size = layout.patch_nodes.shape
    dense = blocks[layout.patch_blocks].reshape(patches, size, size, 3, 3)
    dense = dense.transpose(0, 3, 1, 4, 2).reshape(patches, 3 * size, 3 * size)
    inverses, sound = definite_inverse(dense)

    offsets = _offsets(positions, layout)
    coarse, coarse_sound = definite_inverse(_coarse_matrix(upper, offsets, layout)[None])
    return TwoLevelSystem(rows, inverses, coarse[0], offsets), sound & coarse_sound


def _offsets(positions: Vector, layout: Layout) -> Vector:
    inside = layout.members < positions.shape[1]
    count = jnp.maximum(jnp.sum(inside, axis=1), 1)
    centres = jnp.sum(_at(positions, layout.members), axis=2) / count[None, :]
    offsets = positions - _at(centres, layout.aggregate)
    squared = jnp.sum(_at(offsets, layout.members) ** 2, axis=(0, 2)) / count
    radius = jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0))
    return offsets / jnp.pad(radius, (0, 1), constant_values=1.0)[None, layout.aggregate]


def _at(values: Float[Array, "c n"], nodes: Int[Array, "*k"]) -> Float[Array, "c *k"]:
    """Values of nodes; zero of the one after the last."""
    return jnp.pad(values, ((0, 0), (0, 1)))[:, nodes]


def _coarse_matrix(
    upper: Float[Array, "blocks 9"], offsets: Vector, layout: Layout
) -> Float[Array, "modes modes"]:
    """P^T A P with six modes of each aggregate, (I, [e_k x y]) at a node with offset y."""
    x, y, z = offsets
    zero = jnp.zeros_like(x)
    turns = jnp.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=1).reshape(-1, 3, 3)
    moves = jnp.broadcast_to(jnp.eye(3), turns.shape)
    modes = jnp.concatenate([moves, turns], axis=2)
    # Of the two triangles one, with half of the diagonal: their sum with its transpose is all.
    scaled = (layout.share[:, None] * upper).reshape(-1, 3, 3)
    right = jnp.einsum("kij,kjm->kim", scaled, modes[layout.cols])
    parts = jnp.einsum("kil,kim->klm", modes[layout.rows], right)
    count = layout.members.shape[0]
    pair = layout.aggregate[layout.rows] * count + layout.aggregate[layout.cols]
    total = jnp.zeros((count * count, 36)).at[pair].add(parts.reshape(-1, 36))
    matrix = total.reshape(count, count, 6, 6).transpose(0, 2, 1, 3).reshape(6 * count, 6 * count)
    matrix = matrix + matrix.T
    diagonal = jnp.diag(matrix)
    # Rotations of a node alone, and aggregates that are padding, have no stiffness at all.
    missing = jnp.where(diagonal == 0.0, 1.0, 0.0)
    return matrix + jnp.diag(missing + _COARSE_SHIFT * diagonal)


# Solve


def product(system: TwoLevelSystem, layout: Layout, x: Vector) -> Vector:
    """A x."""
    n = x.shape[1]
    near = x[:, layout.row_nodes]
    parts = [[system.rows[3 * i + j] * near[j] for j in range(3)] for i in range(3)]
    y = jnp.stack([jnp.sum(a + b + c, axis=0) for a, b, c in parts])
    return y[:, :n].at[:, layout.continued].add(y[:, n:])


def precondition(system: TwoLevelSystem, layout: Layout, r: Vector) -> Vector:
    """The sum of both levels' corrections."""
    return _patch_correction(system, layout, r) + _coarse_correction(system, layout, r)


def _patch_correction(system: TwoLevelSystem, layout: Layout, r: Vector) -> Vector:
    patches, size = layout.patch_nodes.shape
    local = _at(r, layout.patch_nodes).transpose(1, 0, 2).reshape(patches, 3 * size, 1)
    solved = jnp.matmul(system.patches, local).reshape(patches, 3, size)
    flat = solved.transpose(1, 0, 2).reshape(3, patches * size)
    return jnp.sum(_at(flat, layout.places), axis=1)


def _coarse_correction(system: TwoLevelSystem, layout: Layout, r: Vector) -> Vector:
    forces = jnp.concatenate([r, jnp.cross(system.offsets, r, axis=0)])
    sums = jnp.sum(_at(forces, layout.members), axis=2)
    motion = jnp.matmul(system.coarse, sums.T.reshape(-1)).reshape(-1, 6).T
    move = _at(motion, layout.aggregate)
    return move[:3] + jnp.cross(move[3:], system.offsets, axis=0)


@jax.jit
def solve(system: TwoLevelSystem, layout: Layout, b: Vector, tolerance: Float[Array, ""]) -> Solved:
    """Preconditioned conjugate gradients from zero.

    They update the residual, which drifts away from b - A x by rounding where the matrix is stiff;
    so they begin anew with what is left, until that is small itself or cannot be made smaller.
    """
    limit = tolerance**2 * jnp.vdot(b, b)

    def unfinished(carry):
        _, r, best, iterations, curvature = carry
        squared = jnp.vdot(r, r)
        going = (iterations < _ITERATION_LIMIT) & (curvature > 0.0)
        return (squared > limit) & (squared < _DRIFT * best) & going

    def improve(carry):
        x, r, _, before, _ = carry
        change, iterations, curvature = _conjugate_gradient(
            system, layout, r, limit, _ITERATION_LIMIT - before
        )
        x = x + change
        return x, b - product(system, layout, x), jnp.vdot(r, r), before + iterations, curvature

    start = (jnp.zeros_like(b), b, jnp.asarray(jnp.inf), jnp.asarray(0), jnp.asarray(1.0))
    x, r, _, iterations, curvature = jax.lax.while_loop(unfinished, improve, start)
    # A right-hand side that is not a number leaves the loop at once.
    small = jnp.isfinite(limit)
    small &= jnp.vdot(r, r) <= jnp.maximum(limit, _SUFFICIENT**2 * jnp.vdot(b, b))
    converged = (iterations < _ITERATION_LIMIT) & (curvature > 0.0) & small
    return Solved(x, converged, iterations, curvature)


def _conjugate_gradient(
    system: TwoLevelSystem,
    layout: Layout,
    b: Vector,
    limit: Float[Array, ""],
    iteration_limit: Int[Array, ""],
) -> tuple[Vector, Int[Array, ""], Float[Array, ""]]:
    """Solution, iterations and last curvature; ends where the squared residual is at the limit."""

    def unfinished(carry):
        _, r, _, _, iteration, curvature = carry
        return (jnp.vdot(r, r) > limit) & (iteration < iteration_limit) & (curvature > 0.0)

    def iterate(carry):
        x, r, p, rz, iteration, _ = carry
        q = product(system, layout, p)
        curvature = jnp.vdot(p, q)
        step = rz / curvature
        x, r = x + step * p, r - step * q
        z = precondition(system, layout, r)
        new = jnp.vdot(r, z)
        return x, r, z + (new / rz) * p, new, iteration + 1, curvature

    z = precondition(system, layout, b)
    start = (jnp.zeros_like(b), b, z, jnp.vdot(b, z), jnp.asarray(0), jnp.asarray(1.0))
    x, _, _, _, iterations, curvature = jax.lax.while_loop(unfinished, iterate, start)
    return x, iterations, curvature


@jax.jit
def solve_together(
    system: TwoLevelSystem, layout: Layout, b: Float[Array, "k 3 n"], tolerance: Float[Array, ""]
) -> Solved:
    """As `solve`, for several right-hand sides."""
    return jax.vmap(lambda column: solve(system, layout, column, tolerance))(b)


class TwoLevelFactorization:
    """A matrix that is ready to be solved.

    Attributes:
        iterations: of the last solve; of several right-hand sides, the most.
    """

    def __init__(self, system: TwoLevelSystem, layout: Layout, size: int, tolerance: float):
        self._system, self._layout, self._size = system, layout, size
        self._tolerance = jnp.asarray(tolerance)
        self.iterations = 0

    def solve(self, right_hand_side: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """A^-1 b, see `interface.Factorization`.

        Raises:
            LinearSolveError: the iterations met negative curvature, or do not converge.
        """
        b = np.asarray(right_hand_side, np.float64)
        if b.ndim == 2:
            x = np.empty_like(b)
            for first in range(0, b.shape[1], _TOGETHER):
                x[:, first : first + _TOGETHER] = self._solve_some(b[:, first : first + _TOGETHER])
            return x
        solved = solve(self._system, self._layout, self._padded(b[:, None])[0], self._tolerance)
        return self._checked(solved)

    def _solve_some(self, b: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        columns = np.pad(b, ((0, 0), (0, _TOGETHER - b.shape[1])))
        padded = self._padded(columns)
        x = self._checked(solve_together(self._system, self._layout, padded, self._tolerance))
        return x[: b.shape[1]].T

    def _padded(self, b: Float[np.ndarray, "n k"]) -> Float[Array, "k 3 padded"]:
        rest = self._system.offsets.shape[1] - self._size
        components = b.T.reshape(b.shape[1], self._size, 3).transpose(0, 2, 1)
        return jnp.asarray(np.pad(components, ((0, 0), (0, 0), (0, rest))))

    def _checked(self, solved: Solved) -> Float[np.ndarray, "*k n"]:
        self.iterations = int(np.max(solved.iterations))
        if not np.all(solved.converged):
            cause = "negative curvature"
            if np.all(np.asarray(solved.curvature) > 0.0):
                cause = "no convergence"
            raise LinearSolveError(f"conjugate gradients met {cause} in {self.iterations} steps")
        x = np.swapaxes(np.asarray(solved.solution)[..., : self._size], -1, -2)
        return x.reshape(*x.shape[:-2], 3 * self._size)


class TwoLevelSolver:
    """Conjugate gradients in JAX, preconditioned on two levels."""

    name = "two-level-cg"

    def __init__(self, tolerance: float = _RELATIVE_TOLERANCE) -> None:
        self._tolerance = tolerance
        self._sparsity: tuple[np.ndarray, np.ndarray] | None = None
        self._layout: Layout | None = None

    def factorize(
        self,
        upper: scipy.sparse.csr_matrix,
        positions: Float[np.ndarray, "nodes 3"] | None = None,
    ) -> TwoLevelFactorization:
        """See `interface.LinearSolver`.

        Raises:
            LinearSolveError: an entry is not finite, or a patch or the coarse matrix is not
                positive definite. The rest of an indefinite matrix shows in the solve.
            ValueError: the unknowns are not three of each node.
        """
        if not np.all(np.isfinite(upper.data)):
            raise LinearSolveError("the matrix has entries that are not finite")
        unknowns = len(upper.indptr) - 1
        if unknowns % 3:
            raise ValueError(f"{unknowns} unknowns are not three unknowns of each node")
        layout = self._layout_of(upper)
        size, padded = unknowns // 3, layout.aggregate.shape[0]
        components = np.zeros((3, padded))  # without positions, aggregates only move
        if positions is not None:
            components[:, :size] = np.asarray(positions).T
        data = jnp.asarray(padded_data(upper.data))
        system, sound = prepare(data, jnp.asarray(components), layout)
        if not bool(sound):
            raise LinearSolveError("a block of the preconditioner is not positive definite")
        return TwoLevelFactorization(system, layout, size, self._tolerance)

    def _layout_of(self, upper: scipy.sparse.csr_matrix) -> Layout:
        known = self._sparsity
        if (
            self._layout is None
            or known is None
            or not np.array_equal(known[0], upper.indptr)
            or not np.array_equal(known[1], upper.indices)
        ):
            self._layout = make_layout(upper)
            self._sparsity = (upper.indptr, upper.indices)
        return self._layout
