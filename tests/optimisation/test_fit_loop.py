"""The loop: recovery, exact resume, rejected steps, stages, views."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fit_scenes import leaves_equal, tube_pattern, tube_problem, with_options

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.io.checkpoints import load_checkpoint, save_checkpoint
from dress_jax.optimisation import (
    LearningRates,
    StepOutcome,
    evaluate,
    fit,
    init,
    make_problem,
    step,
)
from dress_jax.optimisation.trial import select_views
from dress_jax.sim import adjoint


def test_recovery(problem, state, truth):
    history = []
    end = fit(problem, state, on_iteration=lambda _, info: history.append(info))
    before = evaluate(problem, state, true_pattern=truth[0])
    after = evaluate(problem, end, true_pattern=truth[0])
    assert len(history) == problem.options.iterations == int(end.iteration)
    assert all(info.accepted and info.intersections == 0 for info in history)
    assert history[-1].loss < 0.3 * history[0].loss
    assert after.iou > max(0.97, before.iou)
    assert after.median_length_error < 0.5 * before.median_length_error
    # Stage one holds the controls, stage two frees them (S9.12).
    assert not np.array_equal(end.unknowns.pattern.controls, state.unknowns.pattern.controls)


def test_stage_one_freezes_controls(problem, state):
    after, info = step(problem, state)
    assert info.accepted
    assert np.array_equal(after.unknowns.pattern.controls, state.unknowns.pattern.controls)
    assert leaves_equal(after.optimizer["controls"], state.optimizer["controls"])
    assert not np.array_equal(after.unknowns.pattern.vertices, state.unknowns.pattern.vertices)
    assert not np.array_equal(after.unknowns.log_stiffness, state.unknowns.log_stiffness)
    assert not np.array_equal(after.unknowns.colors, state.unknowns.colors)


def test_resume_is_exact(fresh, tmp_path):
    """A checkpoint and a new problem, as after a restart, go on bit by bit."""
    options = {"stage_one": 1, "views_per_iteration": 2}
    problem, start = fresh(**options)
    state = init(problem, start)
    for _ in range(2):
        state, _ = step(problem, state)
    save_checkpoint(tmp_path / "fit.h5", state)
    for _ in range(2):
        state, _ = step(problem, state)

    again, _ = fresh(**options)
    resumed, _ = load_checkpoint(tmp_path / "fit.h5", like=state)
    for _ in range(2):
        resumed, _ = step(again, resumed)
    assert leaves_equal(resumed, state)


def _rejected(problem, state, outcome):
    after, info = step(problem, state)
    assert info.outcome is outcome
    assert not info.accepted
    scale = float(state.rate_scale) * problem.options.shrink
    expected = replace(state, iteration=state.iteration + 1, rate_scale=jnp.asarray(scale))
    assert leaves_equal(after, expected)


def _collapsing(problem, state):
    """A step that stretches the panels beyond recognition, the wrong way, and no guard."""
    uphill = replace(state, gradient=jax.tree.map(jnp.negative, state.gradient))
    return with_options(problem, rates=LearningRates(panels=2.0), guarded_area=0.0), uphill


def test_flipped_rest_triangle_rolls_back(problem, state):
    _rejected(*_collapsing(problem, state), StepOutcome.REST_DEGENERATE)


def _hurried(problem):
    newton = dataclasses.replace(problem.simulator.newton, iteration_limit=1, tolerance=1e-12)
    return dataclasses.replace(
        with_options(problem, largest_remaining_step=0.0),
        simulator=dataclasses.replace(problem.simulator, newton=newton),
    )


def test_unfinished_drape_rolls_back(problem, state):
    _rejected(_hurried(problem), state, StepOutcome.SOLVE_FAILED)


def test_failed_adjoint_rolls_back(problem, state, monkeypatch):
    calls = []

    def fail(objective, positions, right, preconditioner):
        calls.append(objective)
        return np.full_like(right, np.nan)

    monkeypatch.setattr(adjoint, "solve_exact", fail)
    _rejected(with_options(problem, polish=1), state, StepOutcome.ADJOINT_FAILED)
    assert len(calls) == 2


def test_wild_gradient_rolls_back(problem, state):
    wild = replace(state, gradient=replace(state.gradient, log_stiffness=jnp.full(2, jnp.nan)))
    _rejected(problem, wild, StepOutcome.NON_FINITE)


def test_rejections_end_a_fit(problem, state):
    stuck, uphill = _collapsing(with_options(problem, smallest_scale=0.3, shrink=0.5), state)
    history = []
    fit(stuck, uphill, on_iteration=lambda _, info: history.append(info))
    assert len(history) == 2


def test_callback_ends_a_fit(problem, state):
    assert int(fit(problem, state, on_iteration=lambda *_: True).iteration) == 1


def test_every_view_has_its_turn(truth):
    observation = truth[1]
    seen = set()
    for turn in range(3):
        views = select_views(observation, 1, 0, turn)
        assert views.view_count == 1
        seen.add(float(views.cameras.rotation[0, 0, 0]))
    assert len(seen) == observation.view_count
    assert select_views(observation, None, 0, 5) is observation


def test_friction_is_refused(problem):
    rough = dataclasses.replace(problem.simulator, friction=True)
    with pytest.raises(InputError, match="friction"):
        make_problem(
            problem.pattern,
            problem.discretization,
            rough,
            problem.parameters,
            problem.observation,
        )


def test_parts_of_another_pattern_are_refused(problem):
    other, _ = tube_problem(tube_pattern(length=0.40), problem.observation)
    with pytest.raises(InputError, match="discretization and simulator"):
        make_problem(
            problem.pattern,
            problem.discretization,
            other.simulator,
            problem.parameters,
            problem.observation,
        )


def test_a_start_without_drape_is_refused(problem, state):
    with pytest.raises(InputError, match="does not drape"):
        init(_hurried(problem), state.positions)
