"""Points of seams and hems as targets of a fit: their rows, derivatives, and what they recover."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from fit_scenes import EDGE_LENGTH, cameras, with_options

from dress_jax.core.errors import InputError
from dress_jax.optimisation import FitMethod, Landmark, evaluate, fit, init, make_problem
from dress_jax.optimisation.gauss_newton.landmark_rows import rows_in_pictures
from dress_jax.optimisation.landmarks import check_landmarks, landmark_distances, landmark_weights
from dress_jax.pattern import discretize
from dress_jax.render.cameras import look_at_camera, project, stack_cameras, unstack_cameras


def hem(count, observed=None):
    """Landmarks along both hems, at places of an edge's samples."""
    places = np.linspace(0.0, 1.0, count)
    marks = [
        Landmark(panel, 0, float(t), (0.0, 0.0, 0.0)) for panel in ("front", "back") for t in places
    ]
    if observed is None:
        return marks
    return [dataclasses.replace(m, position=tuple(p)) for m, p in zip(marks, observed, strict=True)]


def test_landmarks_lie_on_their_edge(problem):
    mesh = problem.discretization
    rest = np.zeros((mesh.vertex_count, 3))
    rest[np.asarray(mesh.weld_map), :2] = np.asarray(mesh.meshed_positions)
    marks = [Landmark("front", 2, t, (0.0, 0.0, 0.0)) for t in (0.4, 0.5, 0.63)]
    points = landmark_weights(marks, mesh).dot(rest)
    start, end = problem.pattern.panels[0].vertices[[2, 3]]
    wanted = [start + t * (end - start) for t in (0.4, 0.5, 0.63)]
    np.testing.assert_allclose(points[:, :2], wanted, atol=1e-12)


@pytest.mark.parametrize("perspective", [False, True])
def test_a_landmark_in_a_picture_is_its_projection(problem, state, perspective):
    views = cameras()
    if perspective:
        eyes = [[0.3, 0.1, 1.5], [1.4, -0.4, 0.2], [-1.0, 0.2, -0.9]]
        views = stack_cameras(
            [look_at_camera(e, [0.0, -0.1, 0.0], vertical_angle=0.5, height=96) for e in eyes]
        )
    x, mesh = np.asarray(state.positions), problem.discretization
    marks = [Landmark("front", 1, 0.3, view=k, pixel=(40.0, 50.0)) for k in range(3)]
    point = landmark_weights(marks[:1], mesh).dot(x)
    seen = [project(camera, jnp.asarray(point)) for camera in unstack_cameras(views)]
    exact = [
        dataclasses.replace(m, pixel=(float(u[0]), float(v[0])))
        for m, (u, v, _) in zip(marks, seen, strict=True)
    ]
    assert np.abs(rows_in_pictures(exact, mesh, x, views).value).max() < 1e-6  # cameras are float32
    way = np.random.default_rng(2).normal(size=x.shape)
    rows = rows_in_pictures(marks, mesh, x, views)
    ahead, behind = (
        rows_in_pictures(marks, mesh, x + sign * 1e-4 * way, views).value for sign in (1.0, -1.0)
    )
    slope = rows.jacobian.dot(way.ravel()).reshape(-1, 2)
    assert np.abs(slope).min() > 1e-3
    np.testing.assert_allclose((ahead - behind) / 2e-4, slope, rtol=1e-6)
    # One pixel to the right is one pixel's size to the left of the pixel.
    pixel = 1.0 / np.asarray(views.scale)[0, 0] * (1.0 if not perspective else float(seen[0][2][0]))
    right = dataclasses.replace(exact[0], pixel=(exact[0].pixel[0] + 1.0, exact[0].pixel[1]))
    off = rows_in_pictures([right], mesh, x, views).value
    np.testing.assert_allclose(off, [[-pixel, 0.0]], atol=1e-6)


@pytest.mark.slow
def test_landmarks_alone_recover_a_length(fresh, truth):
    """The hem's place says how long a tube is, with no picture at all."""
    problem, start = fresh(method=FitMethod.GAUSS_NEWTON, iterations=12, weights={})
    marks = hem(5)
    drape = np.asarray(truth[2].positions)
    mesh = problem.discretization
    observed = landmark_weights(marks, discretize(truth[0], EDGE_LENGTH)).dot(drape)
    problem = make_problem(
        problem.pattern,
        mesh,
        problem.simulator,
        problem.parameters,
        problem.observation,
        options=problem.options,
        landmarks=hem(5, observed),
    )
    state = init(problem, start)
    before = landmark_distances(problem.landmarks, mesh, np.asarray(state.positions))
    end = fit(problem, state)
    after = landmark_distances(problem.landmarks, mesh, np.asarray(end.positions))
    assert before.max() > 0.02 and after.max() < 0.25 * before.max()
    errors = [evaluate(problem, s, true_pattern=truth[0]) for s in (state, end)]
    assert errors[1].median_length_error < errors[0].median_length_error


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"panel": "sleeve"}, "no panel 'sleeve'"),
        ({"edge": 7}, "no edge 7"),
        ({"at": 1.5}, "'at' is 1.5"),
        ({"view": 0}, "either a position"),
        ({"position": None}, "either a position"),
        ({"position": None, "view": 9, "pixel": (1.0, 1.0)}, "no view 9"),
        ({"position": (0.0, np.nan, 0.0)}, "not 3 numbers"),
    ],
)
def test_landmarks_that_are_none(problem, changes, message):
    mark = dataclasses.replace(Landmark("front", 0, 0.5, (0.0, 0.0, 0.0)), **changes)
    with pytest.raises(InputError, match=f"landmark 1.*{message}"):
        check_landmarks([Landmark("back", 0, 0.5, (0.0, 0.0, 0.0)), mark], problem.pattern, 3)


def test_adam_does_not_look_at_landmarks(problem):
    with pytest.raises(InputError, match="Adam"):
        make_problem(
            problem.pattern,
            problem.discretization,
            problem.simulator,
            problem.parameters,
            problem.observation,
            options=with_options(problem, method=FitMethod.ADAM).options,
            landmarks=hem(2),
        )
