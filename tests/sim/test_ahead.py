"""Programs of a solve are compiled before it, all at once, and once only."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.energy.fabric import make_parameters
from dress_jax.sim import ahead, static_solve
from dress_jax.sim.objective import resting_objective
from tests.sim.scenes import SOFT, draped_sheet


@pytest.fixture
def scene(monkeypatch):
    monkeypatch.setattr(ahead, "_known", set())
    cloth, simulator, rest, start, body = draped_sheet()
    simulator = dataclasses.replace(simulator, workers=2)
    parameters = make_parameters(
        cloth, SOFT, rest, body_vertices=body, pin_targets=start[np.asarray(cloth.pins)]
    )
    return simulator, parameters, start


def _tasks_run(monkeypatch) -> list[bool]:
    run, original = [], ahead._tasks

    def counted(objective, positions, *, exact):
        run.append(exact)
        yield from original(objective, positions, exact=exact)

    monkeypatch.setattr(ahead, "_tasks", counted)
    return run


def test_the_same_shapes_are_compiled_once(scene, monkeypatch):
    simulator, parameters, start = scene
    run = _tasks_run(monkeypatch)
    first = static_solve(simulator, parameters, jnp.asarray(start))
    assert set(run) == {False, True}
    count = len(run)
    again = static_solve(dataclasses.replace(simulator), parameters, jnp.asarray(start))
    assert len(run) == count
    assert np.array_equal(first.positions, again.positions)


def test_what_a_newton_iteration_needs_is_compiled_by_then(scene):
    """No program is compiled by evaluations at the start once all tasks have run."""
    simulator, parameters, start = scene
    objective = resting_objective(simulator, parameters, start)
    ahead.compile_ahead(objective, start, exact=True)
    compiled = []

    def heard(event, duration, **_):
        if event.endswith(("backend_compile_duration", "cache_retrieval_time_sec")):
            compiled.append(duration)

    jax.monitoring.register_event_duration_secs_listener(heard)
    try:
        objective.value_and_gradient(start)
        objective.value(start)
        for exact in (False, True):
            objective.factorize(start, exact=exact)
        objective.step_bound(start, np.zeros_like(start))
    finally:
        jax.monitoring.unregister_event_duration_listener(heard)
    assert not compiled


def test_one_worker_compiles_nothing_ahead(scene, monkeypatch):
    simulator, parameters, start = scene
    run = _tasks_run(monkeypatch)
    alone = dataclasses.replace(simulator, workers=1)
    ahead.compile_ahead(resting_objective(alone, parameters, start), start, exact=True)
    assert not run
