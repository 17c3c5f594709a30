"""Comfort, options, optimiser, observations and figures on their own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fit_scenes import BALL, ball, cameras, tube_pattern

from dress_jax.core.errors import InputError
from dress_jax.core.pytree import replace
from dress_jax.energy.gathers import no_gathers
from dress_jax.loss.comfort import comfort
from dress_jax.optimisation import (
    PAPER_WEIGHTS,
    FitOptions,
    LearningRates,
    Unknowns,
    length_errors,
    make_observation,
    observe,
)
from dress_jax.optimisation.losses import IMAGE_TERMS, REGULARIZERS
from dress_jax.optimisation.optimizer import corner_links, init_optimizer, propose, rates
from dress_jax.optimisation.state import from_groups, groups
from dress_jax.pattern import PatternParameters, scaled
from dress_jax.pattern.templates import t_shirt

EXACT = 1e-12

REST = jnp.asarray([[0.0, 0.0], [0.4, 0.0], [0.4, 0.5], [0.0, 0.5]])
FACES = jnp.asarray([[0, 0], [1, 2], [2, 3]])


def _flat(rest):
    return jnp.stack([rest[:, 0], jnp.zeros(4), -rest[:, 1]], axis=1)


@pytest.mark.parametrize("stretch", [0.9, 1.0, 1.2])
def test_comfort_of_an_even_stretch(stretch):
    """F = s R: two singular values of s over an area of 0.2 m^2."""
    value = comfort(stretch * _flat(REST), REST, FACES, FACES, no_gathers())
    np.testing.assert_allclose(value, 0.2 * 2.0 * (stretch - 1.0) ** 2, atol=EXACT)


def test_comfort_grows_as_a_pattern_shrinks():
    worn = _flat(REST)
    values = [float(comfort(worn, s * REST, FACES, FACES, no_gathers())) for s in (1.0, 0.95, 0.9)]
    assert values[0] < values[1] < values[2]


def test_weights_are_the_papers():
    assert set(PAPER_WEIGHTS) == {*IMAGE_TERMS, *REGULARIZERS}
    assert dict(PAPER_WEIGHTS) == {
        "mask": 1.0,
        "color": 0.1,
        "normal": 0.1,
        "comfort": 0.1,
        "laplacian": 0.001,
        "area_ratio": 0.01,
        "small_angle": 0.01,
        "discretization": 0.001,
        "boundary_corner": 0.001,
        "seam_length": 0.1,
        "seam_curvature": 0.1,
    }
    assert FitOptions().weights == PAPER_WEIGHTS


@pytest.mark.parametrize(
    "bad",
    [
        {"weights": {"shine": 1.0}},
        {"weights": {"mask": -1.0}},
        {"iterations": -1},
        {"shrink": 1.0},
        {"views_per_iteration": 0},
        {"rates": LearningRates(vertices=np.nan)},
    ],
)
def test_bad_options(bad):
    with pytest.raises(InputError):
        FitOptions(**bad)


def _unknowns(value):
    return Unknowns(
        pattern=PatternParameters(jnp.full((4, 2), value), jnp.full((4, 2), value)),
        log_stiffness=jnp.full(2, value),
        pin_shift=jnp.full(3, value),
        colors=jnp.full((3, 3), value),
    )


def test_rates_follow_stages_and_decay():
    options = FitOptions(iterations=10, stage_one=3, final_rate=0.1)
    first, last = rates(options, 0, 1.0), rates(options, 10, 1.0)
    assert first["vertices"] == options.rates.vertices
    assert last["vertices"] == pytest.approx(0.1 * options.rates.vertices)
    assert first["controls"] == rates(options, 2, 1.0)["controls"] == 0.0
    assert rates(options, 3, 1.0)["controls"] > 0.0
    assert rates(options, 0, 0.5)["vertices"] == 0.5 * first["vertices"]


CORNER_PANEL = np.array([0, 0, 1, 1])


def _propose(start, slope, states, options, **changes):
    step_rates = {**rates(options, 0, 1.0), **changes}
    return propose(start, slope, states, options, step_rates, CORNER_PANEL, np.eye(4))


def test_first_step_has_the_length_of_the_rate():
    options = FitOptions(stage_one=0)
    start, slope = _unknowns(0.5), _unknowns(2e-5)
    moved, _ = _propose(start, slope, init_optimizer(start, options), options, panels=0.0)
    for name, value in groups(moved).items():
        np.testing.assert_allclose(value, 0.5 - getattr(options.rates, name), rtol=1e-6)


def test_panels_stretch_about_their_middle():
    """A slope that asks the first panel to grow in x moves its corners apart by the rate."""
    options = FitOptions(stage_one=0)
    start = _unknowns(0.5)
    corners = jnp.asarray([[0.0, 0.0], [0.4, 0.2], [1.0, 1.0], [2.0, 3.0]])
    start = replace(start, pattern=replace(start.pattern, vertices=corners))
    slope = jax.tree.map(jnp.zeros_like, start)
    pull = jnp.asarray([[1.0, 0.0], [-1.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    slope = replace(slope, pattern=replace(slope.pattern, vertices=pull))
    moved, _ = _propose(start, slope, init_optimizer(start, options), options, vertices=0.0)
    rate = options.rates.panels
    expected = corners + rate * jnp.asarray([[-0.2, 0.0], [0.2, 0.0], [0.0, 0.0], [0.0, 0.0]])
    np.testing.assert_allclose(moved.pattern.vertices, expected, atol=1e-9)


def test_ends_of_short_edges_move_together_and_those_of_long_ones_alone():
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.004], [0.0, 1.0]])
    links = corner_links(corners, np.array([[0, 1], [1, 2], [2, 3], [3, 0]]))
    np.testing.assert_allclose(links @ np.ones(4), 1.0, rtol=EXACT)  # a panel moves as a whole
    np.testing.assert_allclose(links, links.T, atol=EXACT)
    pushed = links @ np.array([0.0, 1.0, 0.0, 0.0])
    assert pushed[1] == pytest.approx(0.5, abs=0.01)
    assert abs(pushed[1] - pushed[2]) < 0.02
    assert abs(pushed[[0, 3]]).max() < 0.01


@pytest.mark.parametrize("sharing", [0.0, 0.5, 1.0])
def test_sharing_slows_what_hardly_matters(sharing):
    options = FitOptions(stage_one=0, sharing=sharing)
    start, slope = _unknowns(0.5), _unknowns(1.0)
    uneven = jnp.ones((4, 2)).at[0, 0].set(1e-2)
    slope = replace(slope, pattern=replace(slope.pattern, vertices=uneven))
    moved, _ = _propose(start, slope, init_optimizer(start, options), options, panels=0.0)
    steps = (0.5 - np.asarray(moved.pattern.vertices)) / options.rates.vertices
    np.testing.assert_allclose(steps[1], 1.0, rtol=1e-6)
    np.testing.assert_allclose(steps[0, 0], 1e-2**sharing, rtol=1e-6)


def test_a_wild_gradient_is_shortened():
    options = FitOptions(stage_one=0, clip=2.0)
    value, states = _unknowns(0.5), init_optimizer(_unknowns(0.5), options)
    for _ in range(5):
        _, states = _propose(value, _unknowns(1.0), states, options)
    _, wild = _propose(value, _unknowns(1e6), states, options)
    _, double = _propose(value, _unknowns(2.0), states, options)
    np.testing.assert_allclose(wild["vertices"].nu, double["vertices"].nu, rtol=1e-9)


def test_colors_stay_colors():
    options = FitOptions(stage_one=0)
    start = _unknowns(0.99)
    moved, _ = _propose(start, _unknowns(-1.0), init_optimizer(start, options), options)
    assert np.all(np.asarray(moved.colors) == 1.0)


def test_groups_round_trip():
    unknowns = _unknowns(0.3)
    assert set(groups(from_groups(groups(unknowns)))) == set(groups(unknowns))


def test_length_errors():
    true = t_shirt()
    assert max(errors.max() for errors in length_errors(true, true).values()) == 0.0
    larger = scaled(true, {"*": (1.1, 1.1)})
    for errors in length_errors(larger, true).values():
        np.testing.assert_allclose(errors, 0.1, rtol=1e-9)


def test_length_errors_of_other_patterns():
    with pytest.raises(InputError, match="panels"):
        length_errors(t_shirt(), tube_pattern())


def test_observe_draws_only_the_garment():
    """A ball seen as a garment, and a smaller one inside that is hidden."""
    vertices, faces = ball()
    alone = observe(cameras(), vertices, faces)
    center = vertices.mean(axis=0)
    inner = center + 0.8 * (vertices - center)
    covered = observe(cameras(), vertices, faces, body_vertices=inner, body_faces=faces)
    np.testing.assert_array_equal(alone.mask, covered.mask)
    outer = center + 1.2 * (vertices - center)
    with pytest.raises(InputError, match="no view shows"):
        observe(cameras(), vertices, faces, body_vertices=outer, body_faces=faces)
    area = float(np.asarray(alone.mask)[0].mean()) * 0.5**2
    assert area == pytest.approx(np.pi * BALL**2, rel=0.03)
    assert alone.mask.dtype == jnp.float32
    np.testing.assert_array_equal(alone.garment, np.asarray(alone.mask) > 0.5)
    assert np.all(np.asarray(alone.valid) == 1.0)


def test_observation_shapes_are_checked():
    mask = np.ones((3, 8, 8))
    with pytest.raises(InputError, match="do not fit"):
        make_observation(cameras(), mask)
    with pytest.raises(InputError, match="color"):
        make_observation(cameras(size=8), mask, color=np.ones((3, 8, 8)))
    with pytest.raises(InputError, match="finite"):
        make_observation(cameras(size=8), np.nan * mask)
