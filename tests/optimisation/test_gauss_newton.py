"""Gauss-Newton: its model against differences, its prior, its steps, and what it recovers."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from fit_scenes import leaves_equal, with_options

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.io.checkpoints import load_checkpoint, save_checkpoint
from dress_jax.optimisation import (
    FitInfo,
    FitMethod,
    FitOptions,
    GaussNewtonOptions,
    StepOutcome,
    blank_state,
    evaluate,
    finished,
    fit,
    init,
    step,
)
from dress_jax.optimisation.draping import fitted_parameters
from dress_jax.optimisation.gauss_newton import method, trial
from dress_jax.optimisation.gauss_newton.model import make_model, make_reference, measure
from dress_jax.optimisation.gauss_newton.normal_equations import damped_step, huber
from dress_jax.optimisation.gauss_newton.prior import edge_strain_matrix
from dress_jax.optimisation.gauss_newton.quadratic_model import Model
from dress_jax.optimisation.gauss_newton.vector import as_vector, felt_directions, from_vector
from dress_jax.optimisation.problem import rest_shape
from dress_jax.sim import static_solve


@pytest.fixture(scope="module")
def problem(fresh):
    return fresh(method=FitMethod.GAUSS_NEWTON, iterations=25)[0]


@pytest.fixture(scope="module")
def start(fresh):
    return fresh()[1]


@pytest.fixture(scope="module")
def state(problem, start):
    return init(problem, start)


def test_recovery(problem, state, truth):
    """In fewer drapes than Adam, and closer."""
    history = []
    end = fit(problem, state, on_iteration=lambda _, info: history.append(info))
    before = evaluate(problem, state, true_pattern=truth[0])
    after = evaluate(problem, end, true_pattern=truth[0])
    assert all(info.intersections == 0 for info in history)
    best = [float(state.best.cost)]
    best += [info.cost for info in history if info.accepted and info.cost < best[-1]]
    assert float(end.best.cost) == min(best)
    assert float(end.best.cost) < 0.02 * float(state.best.cost)
    assert after.iou > 0.98 > before.iou
    assert after.median_length_error < 0.25 * before.median_length_error
    assert finished(problem, end)


def _cost(problem, reference, vector, like, positions):
    """Of the drape of some unknowns, draped until it rests."""
    unknowns = from_vector(vector, like)
    rest = rest_shape(problem, unknowns.pattern)
    parameters = fitted_parameters(problem, rest, unknowns.log_stiffness, unknowns.pin_shift)
    simulator = dataclasses.replace(problem.simulator)
    newton = dataclasses.replace(problem.simulator.newton, tolerance=1e-11)
    simulator = dataclasses.replace(simulator, newton=newton)
    drape = static_solve(simulator, parameters, positions)
    assert drape.report.converged
    return (
        measure(problem, reference, reference.prior, unknowns, drape.positions),
        drape.positions,
        parameters,
    )


@pytest.mark.parametrize("group", ["vertices", "controls", "log_stiffness", "pin_shift"])
def test_gradient_of_the_model_against_differences(problem, state, group):
    """Image outline to pattern, stiffness and pins, through contact."""
    reference, like = make_reference(problem), state.unknowns
    at = as_vector(like)
    positions = state.positions
    for _ in range(8):  # the model is that of a drape at rest
        measured, positions, parameters = _cost(problem, reference, at, like, positions)
    model = make_model(problem, reference, reference.prior, like, positions, measured, parameters)
    zeros = replace(
        like,
        pattern=replace(
            like.pattern,
            vertices=jnp.zeros_like(like.pattern.vertices),
            controls=jnp.zeros_like(like.pattern.controls),
        ),
        log_stiffness=jnp.zeros(2),
        pin_shift=jnp.zeros(3),
    )
    if group in ("vertices", "controls"):
        values = getattr(like.pattern, group)
        ones = jnp.asarray(np.cos(np.arange(values.size)).reshape(values.shape))
        zeros = replace(zeros, pattern=replace(zeros.pattern, **{group: ones}))
    else:
        zeros = replace(zeros, **{group: jnp.ones_like(getattr(like, group))})
    direction = as_vector(zeros)
    size = {"log_stiffness": 1e-4}.get(group, 1e-6)
    ahead, behind = (
        _cost(problem, reference, at + sign * size * direction, like, positions)[0].cost
        for sign in (1.0, -1.0)
    )
    exact = float(model.gradient @ direction)
    assert abs(exact) > 1e-4
    assert (ahead - behind) / (2 * size) == pytest.approx(exact, rel=1e-4)


def test_antisymmetric_changes_are_not_felt(problem, state):
    """The tube's panels mirror themselves, so half of its directions move nothing."""
    like, symmetry = state.unknowns.pattern, problem.tables.symmetry
    basis = felt_directions(like, symmetry, 2)
    free = felt_directions(like, None, 2)
    assert len(free) == len(as_vector(state.unknowns)) and np.array_equal(free, np.eye(len(free)))
    assert len(free) / 2 < len(basis) < 0.7 * len(free)
    np.testing.assert_allclose(basis @ basis.T, np.eye(len(basis)), atol=1e-12)
    direction = np.cos(np.arange(len(free)))
    lost = direction - basis.T @ (basis @ direction)
    assert np.linalg.norm(lost) > 0.3 * np.linalg.norm(direction)
    ahead = from_vector(as_vector(state.unknowns) + 0.1 * lost, state.unknowns)
    np.testing.assert_allclose(
        rest_shape(problem, ahead.pattern), rest_shape(problem, like), atol=1e-6
    )


def test_matrix_of_the_model_is_positive_semidefinite(state):
    matrix = np.asarray(state.best.matrix)
    assert np.array_equal(matrix.shape, 2 * [len(as_vector(state.unknowns))])
    assert np.abs(matrix - matrix.T).max() <= 1e-12 * np.abs(matrix).max()
    assert np.linalg.eigvalsh(matrix).min() >= -1e-9 * np.abs(matrix).max()


def test_vectors_and_unknowns_convert_exactly(state):
    vector = as_vector(state.unknowns)
    assert leaves_equal(from_vector(vector, state.unknowns), state.unknowns)


def test_resume_is_exact(problem, start, state, tmp_path):
    """A checkpoint and a blank state of the same structure go on bit by bit."""
    middle, _ = step(problem, state)
    save_checkpoint(tmp_path / "fit.h5", middle)
    resumed, _ = load_checkpoint(tmp_path / "fit.h5", like=blank_state(problem))
    again = dataclasses.replace(problem)
    one, two = step(problem, middle)[0], step(again, resumed)[0]
    assert leaves_equal(one, two)


def test_rejected_steps_raise_the_damping(problem, state, monkeypatch):
    uphill = replace(state, current=replace(state.current, gradient=-state.current.gradient))
    tight = dataclasses.replace(GaussNewtonOptions(), excursion_height=1.0 + 1e-9)
    after, info = step(with_options(problem, gauss_newton=tight), uphill)
    assert info.outcome is StepOutcome.WORSE
    assert leaves_equal(after.current, state.best)
    assert float(after.damping) == pytest.approx(5.0 * float(state.damping))


def test_excursions_end_at_the_best(problem, state):
    """Steps above the best cost are kept for a while; the fit returns the best all the same."""
    options = dataclasses.replace(
        GaussNewtonOptions(), longest_excursion=1, excursion_height=100.0, longest_step=0.02
    )
    wandering = with_options(problem, gauss_newton=options)
    uphill = replace(state, current=replace(state.current, gradient=-state.current.gradient))
    first, info = step(wandering, uphill)
    assert info.accepted and info.cost > float(state.best.cost)
    assert leaves_equal(first.best, state.best) and int(first.excursion) == 1
    assert first.unknowns is first.best.unknowns
    worse = replace(first.current, gradient=-first.current.gradient)
    second, info = step(wandering, replace(first, current=worse))
    assert info.outcome is StepOutcome.WORSE
    assert leaves_equal(second.current, state.best)


def test_a_fit_rests_when_its_best_hardly_falls(problem, state, monkeypatch):
    """Many new bests by chance, each hardly better than the last, are no progress."""
    options = dataclasses.replace(
        GaussNewtonOptions(), idle_decrease=0.02, idle_steps=3, recenterings=0
    )
    resting = with_options(problem, gauss_newton=options, iterations=100)

    def of_cost(cost):
        return replace(state.best, cost=jnp.asarray(cost))

    costs = iter([0.99, 0.985, 0.97, 1.2, 0.965, 0.964])

    def tried(*_, iteration, **__):
        cost = next(costs)
        return trial.Trial(FitInfo(iteration, StepOutcome.ACCEPTED, cost=cost), of_cost(cost))

    monkeypatch.setattr(method, "try_step", tried)
    state = replace(
        state,
        best=of_cost(1.0),
        current=of_cost(1.0),
        reference=jnp.asarray(1.0),
        idle=jnp.asarray(0),
    )
    idle = []
    while not finished(resting, state):
        state, _ = step(resting, state)
        idle.append(int(state.idle))
    assert idle == [1, 2, 0, 1, 2, 3]
    assert float(state.best.cost) == 0.964


def test_degenerate_rest_shapes_are_refused(problem, state):
    options = dataclasses.replace(GaussNewtonOptions(), longest_step=10.0)
    gradient = np.zeros(len(state.current.gradient))
    gradient[: state.unknowns.pattern.vertices.size : 2] = -1e3 * np.arange(8)
    wild = replace(
        state,
        current=replace(
            state.current, gradient=jnp.asarray(gradient), matrix=jnp.eye(len(gradient))
        ),
    )
    after, info = step(with_options(problem, gauss_newton=options), wild)
    assert info.outcome is StepOutcome.REST_DEGENERATE
    assert leaves_equal(after.best, state.best)


def test_a_drape_without_a_derivative_is_refused(problem, state, monkeypatch):
    from dress_jax.solver.linear import LinearSolveError

    calls = []

    def fail(*arguments):
        calls.append(arguments)
        raise LinearSolveError("not positive definite")

    monkeypatch.setattr(trial, "make_model", fail)
    after, info = step(with_options(problem, polish=1), state)
    assert info.outcome is StepOutcome.ADJOINT_FAILED
    assert len(calls) == 2
    assert leaves_equal(after.best, state.best)


def test_steps_are_damped_and_bounded():
    model = Model(np.array([1.0, -4.0]), np.diag([1.0, 100.0]))
    step, promised = damped_step(model, 0.0, np.full(2, 10.0))
    np.testing.assert_allclose(step, [-1.0, 0.04])
    assert promised == pytest.approx(0.5 * (1.0 + 16.0 / 100.0))
    damped, less = damped_step(model, 1.0, np.full(2, 10.0))
    np.testing.assert_allclose(damped, 0.5 * step)
    assert 0.0 < less < promised
    bounded, _ = damped_step(model, 0.0, np.array([0.1, 10.0]))
    np.testing.assert_allclose(bounded, 0.1 * step)


def test_huber_matches_its_factor():
    residual = np.array([-5.0, -0.5, 0.0, 1.0, 3.0])
    value, factor = huber(residual, 1.0)
    ahead, _ = huber(residual + 1e-6, 1.0)
    behind, _ = huber(residual - 1e-6, 1.0)
    np.testing.assert_allclose((ahead - behind) / 2e-6, factor * residual, atol=1e-6)
    np.testing.assert_allclose(value, [4.5, 0.125, 0.0, 0.5, 2.5])


def test_the_prior_ties_short_edges_and_forgives_linear_maps():
    corners = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 0.02), (1.0, 1.0), (0.0, 1.0)])
    edges = np.stack([np.arange(5), np.roll(np.arange(5), -1)], axis=1)
    matrix = edge_strain_matrix(corners, edges, np.zeros(5, int), shape_scale=0.3, size_scale=1e6)

    def cost(displacement):
        return float(displacement @ matrix @ displacement)

    assert cost(np.ones(5)) == pytest.approx(0.0, abs=1e-12)
    assert cost(0.2 * corners[:, 0] - 0.1 * corners[:, 1]) == pytest.approx(0.0, abs=1e-9)
    short, long = (0.01 * (np.arange(5) == corner) for corner in (2, 4))
    assert cost(short) > 30.0 * cost(long) > 0.0
    sized = edge_strain_matrix(corners, edges, np.zeros(5, int), shape_scale=1e6, size_scale=2.0)
    grown = 0.2 * corners[:, 0]
    assert float(grown @ sized @ grown) == pytest.approx(
        np.mean(([0.2, 0, 0, -0.2, 0]) ** np.array(2)) / 4.0
    )


@pytest.mark.parametrize(
    ("changes", "match"),
    [({"robust": 0.0}, "robust"), ({"raise_damping": 0.5}, "above 1")],
)
def test_options_are_checked(changes, match):
    with pytest.raises(InputError, match=match):
        GaussNewtonOptions(**changes)


def test_views_per_iteration_belong_to_adam():
    with pytest.raises(InputError, match="Adam"):
        FitOptions(views_per_iteration=2)
    assert FitOptions(views_per_iteration=2, method=FitMethod.ADAM).views_per_iteration == 2
