"""Seam length and area ratio: closed forms, invariances, derivatives."""

import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.loss.area_ratio import area_ratio, panel_areas
from dress_jax.loss.seam_length import seam_length, seam_ratios
from dress_jax.pattern import (
    PatternParameters,
    components,
    discretize,
    pattern_parameters,
    rest_positions,
    scaled,
)
from dress_jax.pattern.templates import sleeveless_dress, t_shirt
from tests.central_differences import check_slope

EXACT = 1e-12
DERIVATIVE = 1e-7  # relative, central differences with a step of 1e-6

PATTERN = t_shirt()
MESH = discretize(PATTERN, 0.06)
PARAMETERS = pattern_parameters(PATTERN)


def moved(scale=1e-2):
    rng = np.random.default_rng(11)
    return PatternParameters(
        vertices=PARAMETERS.vertices + scale * rng.normal(size=PARAMETERS.vertices.shape),
        controls=PARAMETERS.controls + scale * rng.normal(size=PARAMETERS.controls.shape),
    )


def test_matched_seams_cost_nothing():
    assert seam_length(PARAMETERS, MESH.edges, MESH.stitch_edges) < EXACT


def test_seam_length_in_closed_form():
    # The back stretched to 1.1 in height: its straight shoulder and side seams are longer.
    pattern = sleeveless_dress()
    mesh = discretize(pattern, 0.06)
    front, back = pattern.panels
    taller = scaled(pattern, {"back": (1.0, 1.1)})
    parameters = pattern_parameters(taller)
    differences = []
    for i, j in ((1, 7), (7, 1), (3, 5), (5, 3)):
        e, f = front.edges[i], back.edges[j]
        a = np.linalg.norm(front.vertices[e.end] - front.vertices[e.start])
        b = np.linalg.norm((back.vertices[f.end] - back.vertices[f.start]) * [1.0, 1.1])
        differences.append(abs(a - b))
    actual = seam_length(parameters, mesh.edges, mesh.stitch_edges)
    np.testing.assert_allclose(actual, np.mean(differences), rtol=EXACT)
    ratio = seam_ratios(parameters, mesh.edges, mesh.stitch_edges)
    assert seam_length(parameters, mesh.edges, mesh.stitch_edges, ratio=ratio) < EXACT


def test_no_stitches_cost_nothing():
    assert seam_length(PARAMETERS, MESH.edges, np.zeros((0, 2), dtype=int)) == 0.0


def test_seam_length_gradient():
    check_slope(
        lambda p: seam_length(p, MESH.edges, MESH.stitch_edges), moved(), tolerance=DERIVATIVE
    )


def area_value(parameters, reference=None):
    reference = areas(PARAMETERS) if reference is None else reference
    return area_ratio(
        rest_positions(parameters, MESH),
        MESH.rest_faces,
        MESH.face_panel,
        components(MESH),
        reference,
    )


def areas(parameters):
    rest = rest_positions(parameters, MESH)
    return panel_areas(rest, MESH.rest_faces, MESH.face_panel, MESH.panel_count)


def test_panel_areas_match_the_outlines():
    straight = PatternParameters(
        PARAMETERS.vertices, jnp.tile(jnp.array([[0.5, 0.0]]), (len(PARAMETERS.controls), 1))
    )
    expected = []
    for panel in PATTERN.panels:
        x, y = panel.vertices.T
        expected.append(0.5 * abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)))
    np.testing.assert_allclose(areas(straight), expected, rtol=EXACT)


def test_area_ratio_vanishes_at_the_reference_and_under_uniform_scale():
    assert area_value(PARAMETERS) < EXACT
    larger = PatternParameters(1.7 * PARAMETERS.vertices, PARAMETERS.controls)
    assert area_value(larger) < EXACT


def test_area_ratio_in_closed_form():
    reference = areas(PARAMETERS)
    doubled = reference.at[0].mul(2.0)
    share = reference / reference.sum()
    wanted = doubled / doubled.sum()
    expected = jnp.mean((share / wanted - 1.0) ** 2)
    np.testing.assert_allclose(area_value(PARAMETERS, doubled), expected, rtol=1e-10)
    assert expected > 0.01


def test_components_are_normalised_separately():
    rest = jnp.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [3.0, 0.0], [0.0, 2.0]])
    faces, panel = np.array([[0, 1, 2], [3, 5, 4]]), np.array([0, 1])
    np.testing.assert_allclose(panel_areas(rest, faces, panel, 2), [0.5, 3.0])
    apart = area_ratio(rest, faces, panel, np.array([0, 1]), jnp.array([0.2, 7.0]))
    together = area_ratio(rest, faces, panel, np.array([0, 0]), jnp.array([0.2, 7.0]))
    assert apart == pytest.approx(0.0, abs=EXACT) and together > 0.1


def test_area_ratio_gradient():
    check_slope(area_value, moved(), tolerance=DERIVATIVE)
