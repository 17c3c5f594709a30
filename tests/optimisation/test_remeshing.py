"""When a fit needs another mesh, and what it takes along: S13."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from fit_scenes import EDGE_LENGTH, hang, with_options

from dress_jax.core.pytree import replace
from dress_jax.optimisation import (
    FitMethod,
    carry_over,
    distortion,
    init,
    make_problem,
    needs_remeshing,
    pulled_back,
    step,
)
from dress_jax.optimisation.problem import rest_shape, validated_pattern
from dress_jax.optimisation.remeshing import pin_change
from dress_jax.pattern import discretize, pattern_parameters, with_parameters


def stretched(unknowns, factors):
    """The unknowns with all corners scaled."""
    pattern = unknowns.pattern
    vertices = pattern.vertices * jnp.asarray([factors])
    return replace(unknowns, pattern=replace(pattern, vertices=vertices))


def test_distortion_is_the_largest_stretch_or_its_inverse(problem, state):
    assert distortion(problem, state.unknowns.pattern) == pytest.approx(1.0, abs=1e-6)
    for factors in ((1.4, 1.0), (1.0, 1.0 / 1.4), (1.4, 0.9)):
        changed = stretched(state.unknowns, factors).pattern
        # The hem's curve bulges with the width of its chord, so a little more than the factors.
        assert distortion(problem, changed) == pytest.approx(1.4, rel=0.05)
    flipped = stretched(state.unknowns, (1.0, -1.0)).pattern
    assert distortion(problem, flipped) == np.inf


def test_the_threshold_triggers(problem, state):
    assert not needs_remeshing(problem, state)
    changed = replace(state, unknowns=stretched(state.unknowns, (1.0, 1.3)))
    assert not needs_remeshing(problem, changed)
    assert needs_remeshing(with_options(problem, remesh_distortion=1.2), changed)


def remeshed(problem, unknowns):
    """The problem with a mesh of the fitted pattern, and a garment to start from."""
    meshed = validated_pattern(problem, unknowns.pattern)
    fitted = with_parameters(problem.pattern, meshed)
    mesh = discretize(fitted, EDGE_LENGTH)
    discretization, simulator, parameters, start = hang(problem.pattern, mesh)
    new = make_problem(
        problem.pattern,
        discretization,
        simulator,
        parameters,
        problem.observation,
        options=problem.options,
    )
    return new, start


def test_the_new_mesh_maps_onto_the_initial_pattern(problem, state):
    """Its triangulation is that of the initial pattern too: no triangle flips (S13.3)."""
    unknowns = stretched(state.unknowns, (1.1, 1.35))
    new, _ = remeshed(problem, unknowns)
    assert distortion(new, unknowns.pattern) == pytest.approx(1.0, abs=1e-6)
    back = pulled_back(problem, new.discretization)
    assert distortion(new, pattern_parameters(problem.pattern)) < 1.6
    low, high = (
        np.asarray(problem.discretization.meshed_positions).min(axis=0),
        np.asarray(problem.discretization.meshed_positions).max(axis=0),
    )
    # The curve of the hem is sampled elsewhere.
    np.testing.assert_allclose(back.min(axis=0), low, atol=5e-4)
    np.testing.assert_allclose(back.max(axis=0), high, atol=5e-4)
    # The references are the initial pattern's (S21.11).
    np.testing.assert_allclose(
        new.tables.reference_areas, problem.tables.reference_areas, rtol=5e-3
    )


def test_pins_stay_where_they_were(problem, state):
    new, _ = remeshed(problem, state.unknowns)
    lower = dataclasses.replace(
        new,
        parameters=replace(
            new.parameters, pin_targets=new.parameters.pin_targets - jnp.array([[0.0, 0.03, 0.0]])
        ),
    )
    np.testing.assert_allclose(pin_change(problem, lower), [0.0, 0.03, 0.0], atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("method", FitMethod)
def test_a_state_goes_on_with_another_mesh(fresh, method):
    problem, start = fresh(method=method, iterations=6)
    colors = np.random.default_rng(3).uniform(size=(problem.discretization.vertex_count, 3))
    state = init(dataclasses.replace(problem, colors=colors), start)
    state, info = step(problem, state)
    assert info.accepted
    unknowns = state.unknowns
    new, positions = remeshed(problem, unknowns)
    moved, again = carry_over(problem, state, new, positions)
    assert again.accepted and again.intersections == 0
    assert again.loss == pytest.approx(info.loss, rel=0.1)  # S13.8: another mesh, another drape
    np.testing.assert_array_equal(moved.unknowns.pattern.vertices, unknowns.pattern.vertices)
    assert moved.unknowns.colors.shape == (new.discretization.vertex_count, 3)
    assert float(moved.unknowns.colors.min()) >= float(unknowns.colors.min()) - 1e-12
    if method is FitMethod.ADAM:
        first, second = (s.optimizer["colors"] for s in (state, moved))
        assert int(second.count) == int(first.count)
        assert second.nu.shape == moved.unknowns.colors.shape
    following, info = step(new, moved)
    assert int(following.iteration) == 2
    assert np.isfinite(info.loss) and info.intersections == 0


def test_rest_shapes_of_both_meshes_cover_the_same_panels(problem, state):
    new, _ = remeshed(problem, state.unknowns)
    for panel in range(new.discretization.panel_count):
        bounds = []
        for p in (problem, new):
            own = np.asarray(p.discretization.panel_of_vertex) == panel
            rest = np.asarray(rest_shape(p, state.unknowns.pattern))[own]
            bounds.append(np.concatenate([rest.min(axis=0), rest.max(axis=0)]))
        np.testing.assert_allclose(*bounds, atol=1e-3)
