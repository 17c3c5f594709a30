import numpy as np
import pytest
from solver_scenes import BrokenFactorization, DenseFactorization, positive_definite

from dress_jax.core.results import Result
from dress_jax.solver import NewtonOptions, minimize
from dress_jax.solver.linear import LinearSolveError

VERTICES = 4
A = positive_definite(VERTICES, seed=0)
TARGET = np.random.default_rng(1).normal(size=(VERTICES, 3))
FAR = NewtonOptions(tolerance=1e-9, longest_step=np.inf)


class Quadratic:
    """1/2 (x - t)^T A (x - t), with a wall at a part of the way to t; counts factorizations."""

    def __init__(self, *, bound: float = 1.0):
        self.bound, self.factorizations = bound, 0

    def value(self, positions):
        offset = (positions - TARGET).ravel()
        return 0.5 * float(offset @ A @ offset)

    def value_and_gradient(self, positions):
        gradient = A @ (positions - TARGET).ravel()
        return self.value(positions), gradient.reshape(positions.shape)

    def factorize(self, positions, *, exact=False):
        self.factorizations += 1
        return DenseFactorization(A)

    def hessian_product(self, positions, direction):
        return (A @ direction.ravel()).reshape(direction.shape)

    def step_bound(self, positions, displacement):
        reach = self.bound * np.linalg.norm(TARGET - positions)
        return min(1.0, reach / np.linalg.norm(displacement))


class Spheres:
    """Vertices pulled to the unit sphere and along a force: not convex.

    1/4 sum (|x|^2 - 1)^2 - f . x; the projected Hessian leaves out the negative part.
    """

    force = 0.05 * np.random.default_rng(2).normal(size=(VERTICES, 3))

    def value(self, positions):
        return self.value_and_gradient(positions)[0]

    def value_and_gradient(self, positions):
        excess = np.sum(positions**2, axis=1) - 1.0
        value = 0.25 * float(np.sum(excess**2)) - float(np.vdot(self.force, positions))
        return value, excess[:, None] * positions - self.force

    def _blocks(self, positions, *, project):
        excess = np.sum(positions**2, axis=1) - 1.0
        excess = np.maximum(excess, 0.05) if project else excess
        outer = 2.0 * positions[:, :, None] * positions[:, None, :]
        return outer + excess[:, None, None] * np.eye(3)

    def factorize(self, positions, *, exact=False):
        matrix = np.zeros((VERTICES, 3, VERTICES, 3))
        for k, block in enumerate(self._blocks(positions, project=not exact)):
            matrix[k, :, k] = block
        matrix = matrix.reshape(3 * VERTICES, -1)
        if np.linalg.eigvalsh(matrix).min() <= 0.0:
            raise LinearSolveError("indefinite")
        return DenseFactorization(matrix)

    def hessian_product(self, positions, direction):
        return np.einsum("nij,nj->ni", self._blocks(positions, project=False), direction)

    def step_bound(self, positions, displacement):
        return 1.0


START = np.zeros((VERTICES, 3))
SPREAD = np.random.default_rng(3).normal(size=(VERTICES, 3))


def _run(objective, start, options):
    """The solution and everything that was reported on the way."""
    steps = []
    return minimize(objective, start, options, progress=steps.append), steps


def test_one_iteration_on_a_quadratic():
    objective = Quadratic()
    solution, steps = _run(objective, START, FAR)
    assert solution.result is Result.CONVERGED and solution.iterations == 1
    # The second factorization finds that nothing is left to do.
    assert objective.factorizations == 2
    np.testing.assert_allclose(solution.positions, TARGET, atol=1e-12)
    assert solution.residual < 1e-10 and solution.energy == pytest.approx(0.0, abs=1e-20)
    assert solution.factorization is not None
    assert [step.step_length for step in steps] == [1.0]


def test_start_at_the_solution():
    solution, steps = _run(Quadratic(), TARGET, FAR)
    assert solution.result is Result.CONVERGED and solution.iterations == 0 and not steps
    np.testing.assert_array_equal(solution.positions, TARGET)


def test_step_bound_is_respected():
    """No accepted fraction exceeds the bound, and each step shortens the way by it."""
    solution, steps = _run(Quadratic(bound=0.25), START, FAR)
    assert solution.result is Result.CONVERGED
    np.testing.assert_allclose([step.bound for step in steps], 0.25, rtol=1e-12)
    assert all(step.step_length <= 0.25 * (1.0 + 1e-12) for step in steps)
    expected = 0.75**solution.iterations * np.linalg.norm(TARGET, axis=1).max()
    assert np.linalg.norm(solution.positions - TARGET, axis=1).max() == pytest.approx(
        expected, rel=1e-3
    )


def test_the_line_search_starts_at_the_bound():
    """The energy is asked nowhere beyond what the bound has cleared."""

    class Fenced(Quadratic):
        def step_bound(self, positions, displacement):
            self.cleared = positions + 0.3 * displacement
            self.origin = positions
            return 0.3

        def value(self, positions):
            if hasattr(self, "cleared"):
                reach = np.linalg.norm(self.cleared - self.origin)
                assert np.linalg.norm(positions - self.origin) <= reach * (1.0 + 1e-12)
            return super().value(positions)

        def value_and_gradient(self, positions):
            gradient = super().value_and_gradient(positions)[1]
            return Quadratic.value(self, positions), gradient

    assert _run(Fenced(), START, FAR)[0].result is Result.CONVERGED


class Stiff(Quadratic):
    """Its projected Hessian is twice as stiff as the true one."""

    def factorize(self, positions, *, exact=False):
        return DenseFactorization(A if exact else 2.0 * A)


def test_twice_a_short_step_is_taken():
    options = NewtonOptions(tolerance=1e-9, longest_step=np.inf, exact_below=0.0)
    solution, steps = _run(Stiff(bound=np.inf), START, options)
    assert solution.result is Result.CONVERGED and solution.iterations == 1
    assert steps[0].step_length == steps[0].bound == 2.0


def test_twice_a_step_is_not_looked_at_beyond_the_bound():
    options = NewtonOptions(tolerance=1e-9, longest_step=np.inf, exact_below=0.0)
    _, steps = _run(Stiff(bound=0.6), START, options)
    assert steps[0].step_length == steps[0].bound == pytest.approx(1.2, rel=1e-12)


def test_no_vertex_moves_further_than_the_longest_step():
    options = NewtonOptions(tolerance=1e-9, longest_step=0.1)
    solution, steps = _run(Quadratic(), START, options)
    assert solution.result is Result.CONVERGED and len(steps) > 3
    states = np.array([START, *(step.positions for step in steps)])
    moved = np.linalg.norm(np.diff(states, axis=0), axis=2)
    assert moved.max() <= 0.1 * (1.0 + 1e-12)


@pytest.mark.parametrize("exact_below", [0.0, 0.3])
def test_energy_decreases_monotonically(exact_below):
    options = NewtonOptions(tolerance=1e-10, exact_below=exact_below, iteration_limit=2000)
    solution, steps = _run(Spheres(), SPREAD, options)
    assert solution.result is Result.CONVERGED
    energies = [Spheres().value(SPREAD), *(step.energy for step in steps)]
    # The line search allows for rounding: 64 times the last place of the energy.
    assert np.all(np.diff(energies) <= 64 * np.finfo(float).eps * np.abs(energies[:-1]))
    # The tolerance times the largest stiffness, about 3 N/m.
    assert solution.residual < 1e-9
    assert solution.energy == steps[-1].energy
    assert [step.iteration for step in steps] == list(range(1, len(steps) + 1))


def test_exact_hessian_speeds_up_the_end():
    """The projected Hessian alone converges linearly, and slowly.

    The exact one gains more than a digit an iteration: its inner solve stops at 3e-2.
    """
    options = {"tolerance": 1e-10, "iteration_limit": 2000}
    slow, slow_steps = _run(Spheres(), SPREAD, NewtonOptions(exact_below=0.0, **options))
    fast, steps = _run(Spheres(), SPREAD, NewtonOptions(exact_below=0.3, **options))
    assert slow.result is fast.result is Result.CONVERGED
    assert fast.iterations < slow.iterations and steps[-1].exact
    np.testing.assert_allclose(fast.energy, slow.energy, rtol=1e-12)
    assert not any(step.exact for step in slow_steps)
    assert slow.step_size > 0.1 * slow_steps[-1].step_size
    assert fast.step_size < 0.1 * steps[-1].step_size


def test_negative_curvature_is_followed_downhill():
    """Near the middle of the sphere, a maximum, the projected Hessian creeps."""
    start = 1e-3 * SPREAD
    options = {"tolerance": 1e-10, "longest_step": 0.5, "iteration_limit": 2000}
    slow, _ = _run(Spheres(), start, NewtonOptions(exact_below=0.0, **options))
    fast, steps = _run(Spheres(), start, NewtonOptions(exact_below=0.5, **options))
    assert slow.result is fast.result is Result.CONVERGED
    assert not steps[0].exact and steps[-1].exact
    energies = np.array([Spheres().value(start), *(step.energy for step in steps)])
    assert np.all(np.diff(energies) <= 64 * np.finfo(float).eps * np.abs(energies[:-1]))
    # It leaves the maximum in a few steps, and ends in a minimum.
    assert energies[min(10, len(steps))] < 0.5 * energies[0]
    assert fast.iterations < 0.5 * slow.iterations
    blocks = Spheres()._blocks(fast.positions, project=False)
    assert np.linalg.eigvalsh(blocks).min() > 0.0


def test_iteration_limit():
    options = NewtonOptions(tolerance=1e-9, longest_step=0.01, iteration_limit=5)
    solution, steps = _run(Quadratic(), START, options)
    assert solution.result is Result.ITERATION_LIMIT and solution.iterations == len(steps) == 5
    assert solution.energy == steps[-1].energy < Quadratic().value(START)


def test_line_search_stalled():
    class Liar(Quadratic):
        """Its gradient points downhill."""

        def value_and_gradient(self, positions):
            value, gradient = super().value_and_gradient(positions)
            return value, -gradient

    solution, steps = _run(Liar(), START, FAR)
    assert solution.result is Result.LINE_SEARCH_STALLED and not steps
    np.testing.assert_array_equal(solution.positions, START)


@pytest.mark.parametrize("uses", [0, 1, 2])
def test_linear_solve_failed(uses):
    """In the first solve, or later inside the exact refinement."""

    class Broken(Quadratic):
        def factorize(self, positions, *, exact=False):
            return BrokenFactorization(2.0 * A, uses)

    options = NewtonOptions(tolerance=1e-9, longest_step=np.inf, exact_below=np.inf)
    solution, _ = _run(Broken(), START, options)
    assert solution.result is Result.LINEAR_SOLVE_FAILED


def test_factorization_failed():
    class Broken(Quadratic):
        def factorize(self, positions, *, exact=False):
            raise LinearSolveError("never")

    solution, _ = _run(Broken(), START, FAR)
    assert solution.result is Result.LINEAR_SOLVE_FAILED and solution.factorization is None


@pytest.mark.parametrize("where", ["value", "gradient", "direction"])
def test_non_finite(where):
    class Broken(Quadratic):
        def value_and_gradient(self, positions):
            value, gradient = super().value_and_gradient(positions)
            if where == "value":
                return np.inf, gradient
            return value, gradient * (np.nan if where == "gradient" else 1.0)

        def factorize(self, positions, *, exact=False):
            factor = np.nan if where == "direction" else 1.0
            return DenseFactorization(factor * A)

    solution, _ = _run(Broken(), START, FAR)
    assert solution.result is Result.NON_FINITE
    np.testing.assert_array_equal(solution.positions, START)


def test_non_finite_trial_energies_shorten_the_step():
    """A barrier is infinite beyond its wall; the search comes back from there."""

    class Wall(Quadratic):
        def value(self, positions):
            far = np.linalg.norm(positions - TARGET) > np.linalg.norm(START - TARGET)
            return np.inf if far else super().value(positions)

        def factorize(self, positions, *, exact=False):
            return DenseFactorization(0.2 * A)  # five times too far

    options = NewtonOptions(tolerance=1e-6, longest_step=np.inf, exact_below=0.0)
    solution, steps = _run(Wall(), START, options)
    assert steps[0].step_length < 1.0 and np.isfinite(solution.energy)
    assert solution.result is Result.CONVERGED


@pytest.mark.parametrize("result", list(Result))
def test_every_result_has_a_message(result):
    assert result.message
