"""Design rules in a fit: constrained steps, proposals that are mended, and what comes out."""

import dataclasses

import numpy as np
import pytest
from fit_scenes import with_options

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.optimisation import FitMethod, StepOutcome, fit, init, step
from dress_jax.optimisation.draping import initial_unknowns
from dress_jax.optimisation.gauss_newton.constraints import Constraints, constrained_step
from dress_jax.optimisation.gauss_newton.quadratic_model import Model
from dress_jax.optimisation.rules import broken_rules, follow_rules
from dress_jax.pattern import edge_lengths
from dress_jax.pattern.rules import (
    MinimumLength,
    equal_lengths,
    fixed_edge,
    minimum_length,
    minimum_width,
    right_angle,
)


def quadratic_model(seed=0, count=6):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(count, count))
    return Model(rng.normal(size=count), root @ root.T + np.eye(count)), rng


def test_a_step_under_equalities_is_the_lagrangian_one():
    model, rng = quadratic_model()
    jacobian, gap = rng.normal(size=(2, 6)), rng.normal(size=2)
    jacobian, gap = np.vstack([jacobian, jacobian[:1]]), np.append(gap, gap[0])  # said twice
    step = constrained_step(model, Constraints(gap, jacobian, np.zeros(3, bool)))
    np.testing.assert_allclose(jacobian @ step, -gap, atol=1e-12)
    slope = model.gradient + model.matrix @ step
    force = np.linalg.lstsq(jacobian.T, slope)[0]
    np.testing.assert_allclose(jacobian.T @ force, slope, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_step_under_bounds_is_the_best_there_is(seed):
    """Against every choice of active bounds."""
    model, rng = quadratic_model(seed)
    jacobian, gap = rng.normal(size=(4, 6)), rng.uniform(-0.2, 0.4, size=4)
    bounds = np.array([True, True, True, False])
    step = constrained_step(model, Constraints(gap, jacobian, bounds))

    def value(d):
        return model.gradient @ d + 0.5 * d @ model.matrix @ d

    best = np.inf
    for choice in range(8):
        active = np.array([choice & 1, choice & 2, choice & 4, 1], bool)
        own = Constraints(gap[active], jacobian[active], np.zeros(active.sum(), bool))
        d = constrained_step(model, own)
        if np.all((gap + jacobian @ d)[bounds] >= -1e-9):
            best = min(best, value(d))
    assert np.all((gap + jacobian @ step)[bounds] >= -1e-8)
    assert value(step) == pytest.approx(best, rel=1e-9)


@pytest.fixture(scope="module")
def ruled(problem):
    """The tube whose hem keeps its length, whose sides are equal and meet the top squarely."""
    pattern = problem.pattern
    rules = (
        fixed_edge(pattern, "front", 2),
        equal_lengths(pattern, [("front", 1), ("back", 1)]),
        right_angle(pattern, "front", 2),
        minimum_width(pattern, "front", 0.1),
    )
    return dataclasses.replace(problem, rules=rules)


def test_the_first_pattern_is_moved_to_its_rules(ruled):
    unknowns = initial_unknowns(ruled)
    assert not broken_rules(ruled, unknowns.pattern)
    start = initial_unknowns(dataclasses.replace(ruled, rules=()))
    assert set(broken_rules(ruled, start.pattern)) == {ruled.rules[2].name}
    move = np.abs(np.asarray(unknowns.pattern.vertices - start.pattern.vertices))
    assert 1e-4 < move.max() < 0.02  # the sides lean by 1.2 degrees
    assert follow_rules(ruled, unknowns) is unknowns


def test_rules_that_contradict_each_other(ruled):
    short, length = ruled.rules[0], 0.45  # a top of 0.415 m cannot be longer and stay
    both = (short, minimum_length(ruled.pattern, "front", 2, length))
    with pytest.raises(InputError, match=r"cannot be made to follow .*edge 2 of 'front'"):
        initial_unknowns(dataclasses.replace(ruled, rules=both))


def test_a_proposal_is_mended(ruled):
    unknowns = initial_unknowns(ruled)
    rng = np.random.default_rng(1)
    pattern = unknowns.pattern
    wild = replace(
        pattern,
        vertices=pattern.vertices + 0.01 * rng.normal(size=pattern.vertices.shape),
        controls=pattern.controls + 0.02 * rng.normal(size=pattern.controls.shape),
    )
    assert broken_rules(ruled, wild)
    mended = follow_rules(ruled, replace(unknowns, pattern=wild))
    assert not broken_rules(ruled, mended.pattern)
    assert float(np.abs(mended.pattern.vertices - wild.vertices).max()) < 0.05


def test_a_proposal_that_cannot_be_mended_is_rejected(ruled):
    """As it would be with a bound that no pattern keeps, from the second step on."""
    problem = with_options(ruled, method=FitMethod.GAUSS_NEWTON)
    state = init_once(problem)
    never = MinimumLength("a top beyond reach", 2, 1e6)
    broken = dataclasses.replace(problem, rules=(*problem.rules, never))
    after, info = step(broken, state)
    assert info.outcome is StepOutcome.RULE_BROKEN and not info.accepted
    assert np.array_equal(after.positions, state.positions)


_STATES = {}


def init_once(problem):
    """Drapes are slow; one state serves the tests of a method."""
    method = problem.options.method
    if method not in _STATES:
        _STATES[method] = init(problem, _STATES["start"])
    return _STATES[method]


@pytest.fixture(autouse=True)
def _start(fresh):
    _STATES.setdefault("start", fresh()[1])


@pytest.mark.parametrize(
    "method", [FitMethod.GAUSS_NEWTON, pytest.param(FitMethod.ADAM, marks=pytest.mark.slow)]
)
def test_a_fit_keeps_its_rules(ruled, method):
    """Pictures ask for a wider top; the rule keeps it, and the rest comes as close as it may."""
    iterations = {FitMethod.GAUSS_NEWTON: 6, FitMethod.ADAM: 3}[method]
    problem = with_options(ruled, method=method, iterations=iterations, stage_one=1)
    state = init_once(problem)
    end = fit(problem, state)
    edges = problem.tables.edges
    before, after = (np.asarray(edge_lengths(s.unknowns.pattern, edges)) for s in (state, end))
    assert np.abs(after - before).max() > 2e-3
    assert not broken_rules(problem, end.unknowns.pattern)
    np.testing.assert_allclose(after[2], before[2], atol=1e-5)
