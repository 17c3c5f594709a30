"""Proposals that would flip rest triangles: S12."""

import jax.numpy as jnp
import numpy as np
import pytest
from fit_scenes import leaves_equal, with_options

from dress_jax.core.pytree import replace
from dress_jax.optimisation import FitMethod, StepOutcome, init, step
from dress_jax.optimisation.draping import relative_areas, smallest_relative_area
from dress_jax.optimisation.first_order import propose
from dress_jax.optimisation.flip_guard import (
    _area_slopes,
    _as_vector,
    _rest_and_jacobian,
    guard_flips,
)
from dress_jax.optimisation.problem import rest_shape
from tests.central_differences import central_difference


def smallest(problem, unknowns):
    return smallest_relative_area(problem, np.asarray(rest_shape(problem, unknowns.pattern)))


def proposal(state, *, control=(0.0, 0.0), corner=(0.0, 0.0)):
    """The initial unknowns with the hem's control and the upper corners of the front moved."""
    pattern = state.unknowns.pattern
    return replace(
        state.unknowns,
        pattern=replace(
            pattern,
            controls=pattern.controls.at[0].add(jnp.asarray(control)),
            vertices=pattern.vertices.at[2:4].add(jnp.asarray(corner)[None]),
        ),
    )


def test_what_is_sound_is_not_touched(problem, state):
    kept = guard_flips(problem, state.unknowns)
    assert kept.unknowns is state.unknowns and not kept.acted and kept.largest_move == 0.0


@pytest.mark.parametrize(
    "change",
    [
        {"control": (0.0, 1.5)},  # the hem bulges through the waist
        {"corner": (0.0, -0.21)},  # a narrow strip
        {"corner": (0.0, -0.24)},  # the waist passes the hem
    ],
)
def test_flips_are_undone(problem, state, change):
    bad = proposal(state, **change)
    bound = problem.options.guarded_area
    assert smallest(problem, bad) < bound
    mended = guard_flips(problem, bad)
    assert mended.acted
    assert smallest(problem, mended.unknowns) >= bound
    # Closer to the proposal than what it came from is.
    proposed, start, end = (
        np.asarray(rest_shape(problem, u.pattern)) for u in (bad, state.unknowns, mended.unknowns)
    )
    assert np.linalg.norm(end - proposed) < 0.9 * np.linalg.norm(start - proposed)
    np.testing.assert_allclose(
        mended.largest_move, np.linalg.norm(end - proposed, axis=1).max(), rtol=1e-12
    )
    # No area is lifted further than it must: the bound is active.
    assert relative_areas(problem, end).min() < 1.2 * bound
    assert leaves_equal(mended.unknowns.colors, bad.colors)


def test_slopes_of_areas_against_differences(problem, state):
    pattern = proposal(state, control=(0.1, 0.2), corner=(0.01, -0.02)).pattern
    data = (pattern, problem.tables.symmetry, problem.discretization)
    at = _as_vector(pattern)
    rest, jacobian = (np.asarray(part) for part in _rest_and_jacobian(at, *data))
    every = np.arange(len(np.asarray(problem.discretization.rest_faces)))
    slopes = _area_slopes(problem, rest, jacobian, every)
    rng = np.random.default_rng(6)
    way, weights = rng.normal(size=len(at)), rng.normal(size=len(every))

    def value(length):
        moved, _ = _rest_and_jacobian(at + length * way, *data)
        return weights @ relative_areas(problem, np.asarray(moved))

    slope = float(weights @ (slopes @ way))
    assert abs(slope) > 1e-2
    assert central_difference(value, 1e-5) == pytest.approx(slope, rel=1e-8)


def test_the_guard_can_be_left_out(problem, state):
    bad = proposal(state, control=(0.0, 1.5))
    assert guard_flips(with_options(problem, guarded_area=0.0), bad).unknowns is bad


def test_numbers_that_are_not_finite_are_left_to_the_step(problem, state):
    bad = proposal(state, control=(0.0, np.nan))
    assert not guard_flips(problem, bad).acted


def test_a_step_that_would_flip_is_mended_and_drapes(fresh, monkeypatch):
    """The same update without the guard is rejected."""
    problem, start = fresh(method=FitMethod.ADAM, iterations=4)
    state = init(problem, start)

    def through_the_waist(unknowns, gradient, optimizer, *rest):
        _, moments = propose(unknowns, gradient, optimizer, *rest)
        return proposal(state, control=(0.0, 0.8)), moments

    monkeypatch.setattr("dress_jax.optimisation.first_order.propose", through_the_waist)
    _, info = step(with_options(problem, guarded_area=0.0), state)
    assert info.outcome is StepOutcome.REST_DEGENERATE
    following, info = step(problem, state)
    assert info.accepted and info.intersections == 0
    assert smallest(problem, following.unknowns) >= problem.options.guarded_area
