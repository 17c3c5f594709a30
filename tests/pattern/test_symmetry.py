"""Which panels mirror each other, and parameters made symmetric: S4.1 to S4.9."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.io.patterns import load_pattern
from dress_jax.pattern import (
    Panel,
    Pattern,
    PatternParameters,
    edge_lengths,
    edge_table,
    pattern_parameters,
    scaled,
    with_parameters,
)
from dress_jax.pattern.mirror import find_mirror
from dress_jax.pattern.model import arc, cubic, line, quadratic
from dress_jax.pattern.symmetry import make_symmetry, validated
from dress_jax.pattern.templates import straight_skirt, t_shirt
from tests.central_differences import check_slope

LEFT_OVER = 1e-5  # of an asymmetry, with the default nearness of 1e-6
DERIVATIVE = 1e-9  # the map is linear; central differences are exact up to rounding
ROUNDING = 1e-12


def mirrored_panel(panel, name, *, same_direction):
    """The panel mirrored at x = 0 in the world; its loop runs on as it was, or turned around."""
    flip = np.diag([-1.0, 1.0, 1.0])
    corners = panel.vertices * [-1.0, 1.0]
    edges = []
    count = len(panel.vertices)
    for edge in panel.edges:
        controls = edge.controls * [1.0, -1.0]
        if same_direction:
            edges.append(dataclasses.replace(edge, controls=controls))
        else:
            turned = edge.controls[::-1] * [-1.0, 1.0] + [1.0, 0.0]
            start, end = (count - 1 - edge.end) % count, (count - 1 - edge.start) % count
            edges.append(dataclasses.replace(edge, start=start, end=end, controls=turned))
    if not same_direction:
        corners, edges = corners[::-1], edges[::-1]
    first = next(k for k, edge in enumerate(edges) if edge.start == 0)
    return dataclasses.replace(
        panel,
        name=name,
        vertices=corners,
        edges=tuple(edges[first:] + edges[:first]),
        rotation=flip @ panel.rotation @ np.diag([-1.0, 1.0, 1.0]),
        translation=flip @ panel.translation,
    )


def curved_panel():
    """No two edges alike: a quadratic, a cubic, an arc and two lines."""
    corners = np.array([(0.0, 0.0), (0.3, 0.02), (0.36, 0.3), (0.2, 0.42), (-0.02, 0.4)])
    edges = (
        quadratic(0, 1, (0.4, -0.1)),
        cubic(1, 2, (0.2, -0.08), (0.7, -0.12)),
        arc(2, 3, -0.15),
        line(3, 4),
        line(4, 0),
    )
    return Panel(
        name="left",
        vertices=corners,
        edges=edges,
        rotation=np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]]),
        translation=np.array([0.1, 1.0, 0.2]),
    )


def pair_pattern(*, same_direction):
    panel = curved_panel()
    return Pattern((panel, mirrored_panel(panel, "right", same_direction=same_direction)))


def perturbed(pattern, amount, *, seed=3):
    rng = np.random.default_rng(seed)
    start = pattern_parameters(pattern)
    return PatternParameters(
        start.vertices + amount * rng.normal(size=start.vertices.shape),
        start.controls + amount * rng.normal(size=start.controls.shape),
    )


def named_pairs(pattern, **options):
    names = [panel.name for panel in pattern.panels]
    return {(names[p.first], names[p.second]) for p in find_mirror(pattern, **options).pairs}


@pytest.mark.parametrize("same_direction", [True, False])
def test_a_pair_of_panels_is_found_edge_by_edge(same_direction):
    pattern = pair_pattern(same_direction=same_direction)
    mirror = find_mirror(pattern)
    (pair,) = mirror.pairs
    assert (pair.first, pair.second, pair.reversed) == (0, 1, not same_direction)
    assert pair.distance < ROUNDING
    np.testing.assert_allclose(pair.reflection, np.diag([-1.0, 1.0]))
    np.testing.assert_allclose(np.append(mirror.normal, mirror.offset), [1, 0, 0, 0], atol=1e-9)
    lengths = np.asarray(edge_lengths(pattern_parameters(pattern), edge_table(pattern)))
    np.testing.assert_allclose(lengths[5:][pair.edges], lengths[:5], rtol=1e-9)


def test_panels_mirror_themselves_and_each_other_under_noise():
    pattern = t_shirt()
    wanted = named_pairs(pattern)
    assert {a for a, b in wanted if a == b} and {a for a, b in wanted if a != b}
    assert {name for pair in wanted for name in pair} == {p.name for p in pattern.panels}
    for seed in range(5):
        noisy = with_parameters(pattern, perturbed(pattern, 5e-3, seed=seed))
        assert named_pairs(noisy) == wanted


def test_the_plane_is_found_beside_the_origin():
    pattern = t_shirt()
    shift = np.array([0.07, 0.0, 0.0])
    moved = [dataclasses.replace(p, translation=p.translation + shift) for p in pattern.panels]
    mirror = find_mirror(dataclasses.replace(pattern, panels=tuple(moved)))
    np.testing.assert_allclose(mirror.offset, 0.07, atol=1e-9)
    assert len(mirror.pairs) == len(find_mirror(pattern).pairs)


def test_what_is_asymmetric_by_design_stays_so():
    pattern = t_shirt()
    sleeves = [name for name in (p.name for p in pattern.panels) if "left" in name.lower()]
    assert sleeves
    uneven = scaled(pattern, {name: (1.0, 1.3) for name in sleeves})
    found = {name for pair in named_pairs(uneven) for name in pair}
    assert found.isdisjoint(sleeves)
    assert found  # the torso still mirrors itself
    symmetry = make_symmetry(uneven)
    raw = pattern_parameters(uneven)
    np.testing.assert_allclose(validated(raw, symmetry).vertices, raw.vertices, atol=1e-9)


def test_without_symmetry_there_is_nothing_to_validate():
    lone = Pattern((curved_panel(),))
    assert make_symmetry(lone) is None
    raw = pattern_parameters(lone)
    assert validated(raw, None) is raw


@pytest.mark.parametrize("same_direction", [True, False])
def test_validated_pairs_mirror_each_other(same_direction):
    pattern = pair_pattern(same_direction=same_direction)
    symmetry = make_symmetry(pattern)
    noisy = perturbed(pattern, 1e-2)
    (pair,) = find_mirror(with_parameters(pattern, noisy)).pairs
    assert pair.distance > 1e-2
    valid = validated(noisy, symmetry)
    (pair,) = find_mirror(with_parameters(pattern, valid)).pairs
    assert pair.distance < LEFT_OVER
    # Panels do not wander: each keeps the mean of its corners.
    for panel in (slice(0, 5), slice(5, 10)):
        np.testing.assert_allclose(
            valid.vertices[panel].mean(axis=0), noisy.vertices[panel].mean(axis=0), atol=1e-9
        )


def test_a_panel_is_validated_with_itself():
    pattern = straight_skirt()
    symmetry = make_symmetry(pattern)
    noisy = perturbed(pattern, 1e-2)
    valid = validated(noisy, symmetry)
    for pair in find_mirror(with_parameters(pattern, valid)).pairs:
        assert pair.first == pair.second
        assert pair.distance < LEFT_OVER
        np.testing.assert_array_equal(pair.reflection, np.diag([-1.0, 1.0]))  # S4.9
    lengths = np.asarray(edge_lengths(valid, edge_table(pattern)))
    count = len(pattern.panels[0].edges)
    mirrored = find_mirror(pattern).pairs[0].edges
    np.testing.assert_allclose(lengths[:count][mirrored], lengths[:count], rtol=LEFT_OVER)


def test_the_solve_minimizes_what_it_should():
    pattern = pair_pattern(same_direction=False)
    nearness = 1e-2
    symmetry = make_symmetry(pattern, nearness=nearness)
    (pair,) = find_mirror(pattern).pairs
    table, raw = edge_table(pattern), perturbed(pattern, 2e-2)

    def objective(corners):
        value = nearness * jnp.sum((corners - raw.vertices) ** 2)
        for e, f in enumerate(pair.edges + 5):
            i, j = table.vertices[e]
            k, m = table.vertices[f]
            flipped = (corners[k] - corners[m]) * jnp.array([-1.0, 1.0])
            value = value + jnp.sum((corners[i] - corners[j] + flipped) ** 2)
        return value

    gradient = jax.grad(objective)(validated(raw, symmetry).vertices)
    assert np.abs(jax.grad(objective)(raw.vertices)).max() > 1e-3
    np.testing.assert_allclose(gradient, 0.0, atol=ROUNDING)


def test_the_derivative_of_validation():
    pattern = t_shirt()
    symmetry = make_symmetry(pattern)
    weights = perturbed(pattern, 1.0, seed=8)

    def value(parameters):
        valid = validated(parameters, symmetry)
        return sum(
            jnp.sum(w * v)
            for w, v in zip(jax.tree.leaves(weights), jax.tree.leaves(valid), strict=True)
        )

    check_slope(value, perturbed(pattern, 1e-2), tolerance=DERIVATIVE, step=0.1)


def test_real_patterns_find_their_pairs(shared_data):
    folder = shared_data / "patterns" / "garmentcode"
    sides = {"left": "right", "right": "left"}
    for name in ("tshirt", "fitted_shirt_long", "dress_sleeves"):
        pattern = load_pattern(next(folder.glob(f"{name}*.json")))
        for first, second in named_pairs(pattern):
            side = next((s for s in sides if s in first), None)
            assert second == (first if side is None else first.replace(side, sides[side]))
        assert {n for pair in named_pairs(pattern) for n in pair} == {
            p.name for p in pattern.panels
        }
