"""Corners, seam curvature, Laplacian: closed forms, what each penalises, derivatives (S11)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.geometry.curves import end_directions
from dress_jax.loss.corners import (
    boundary_corner,
    corner_signs,
    discretization_consistency,
    small_angle,
)
from dress_jax.loss.laplacian import interior_vertices, laplacian
from dress_jax.loss.seam_curvature import seam_curvature
from dress_jax.pattern import (
    Panel,
    Pattern,
    PatternParameters,
    Side,
    Stitch,
    discretize,
    pattern_parameters,
    rest_positions,
)
from dress_jax.pattern.corners import corner_table, corner_tangents
from dress_jax.pattern.model import arc, cubic, line, quadratic
from tests.central_differences import check_slope

EXACT = 1e-12
DERIVATIVE = 1e-7  # relative; central differences with a steps of 1e-6 and 2e-6


def make_panel(name, corners, edges):
    return Panel(name, np.array(corners), tuple(edges), np.eye(3), np.zeros(3))


def two_panels(lean=0.0, *, clockwise=False):
    """Two rectangles sewn along one side each; `lean` moves the upper end of the seam in x."""
    corners = [(0.0, 0.0), (0.2, 0.0), (0.2 + lean, 0.3), (0.0, 0.3)]
    edges = [line(k, (k + 1) % 4) for k in range(4)]
    if clockwise:
        corners = corners[::-1]
    seam = 1  # turned around, the loop's second edge is still the one at x = 0.2
    panels = [make_panel(name, corners, edges) for name in ("a", "b")]
    return Pattern(tuple(panels), (Stitch(Side("a", seam), Side("b", seam)),))


def curved():
    """One panel with every kind of edge, and a sharp corner."""
    corners = [(0.0, 0.0), (0.3, 0.02), (0.36, 0.3), (0.2, 0.42), (0.1, 0.1)]
    edges = [
        quadratic(0, 1, (0.4, -0.1)),
        cubic(1, 2, (0.2, -0.08), (0.7, -0.12)),
        arc(2, 3, -0.15),
        line(3, 4),
        line(4, 0),
    ]
    return Pattern((make_panel("a", corners, edges),))


def prepared(pattern, edge_length=0.05):
    mesh = discretize(pattern, edge_length)
    return mesh, corner_table(mesh), pattern_parameters(pattern)


def moved(parameters, scale, *, seed=5):
    rng = np.random.default_rng(seed)
    return PatternParameters(
        parameters.vertices + scale * rng.normal(size=parameters.vertices.shape),
        parameters.controls + scale * rng.normal(size=parameters.controls.shape),
    )


def test_tangents_are_those_of_the_curves():
    mesh, corners, parameters = prepared(curved(), 0.002)
    arriving, leaving = corner_tangents(parameters, mesh.edges, corners)
    rest = np.asarray(mesh.meshed_positions)
    before, at, after = (rest[corners.samples[:, k]] for k in range(3))
    # On a mesh of 2 mm a segment turns from its end tangent by its curvature times 1 mm.
    for tangent, chord in ((arriving, at - before), (leaving, after - at)):
        unit = chord / np.linalg.norm(chord, axis=1, keepdims=True)
        np.testing.assert_allclose(tangent, unit, atol=0.03)


def test_tangents_where_controls_meet_their_ends():
    none, unit = np.zeros((1, 2)), np.array([[1.0, 0.0]])
    other = np.array([[0.3, 0.4]])
    flags = np.array([False])
    start, end = end_directions(flags, none, other, xp=np)
    np.testing.assert_allclose(start, other)
    np.testing.assert_allclose(end, unit - other)
    start, end = end_directions(flags, other, unit, xp=np)
    np.testing.assert_allclose(start, other)
    np.testing.assert_allclose(end, unit - other)


@pytest.mark.parametrize("clockwise", [False, True])
def test_hems_at_right_angles_to_seams_cost_nothing(clockwise):
    mesh, corners, parameters = prepared(two_panels(clockwise=clockwise))
    assert np.sum(corners.free.sum(axis=1) == 1) == 4  # both ends of the seam in both panels
    assert boundary_corner(parameters, mesh.edges, corners) < EXACT


def test_oblique_hems_cost_one_minus_the_sine():
    lean = 0.1
    mesh, corners, parameters = prepared(two_panels(lean))
    seam = np.array([lean, 0.3]) / np.hypot(lean, 0.3)
    # Below the seam turns by its slope from the hem, above by the rest of the half turn.
    sines = np.array([seam[1], seam[1]])
    actual = boundary_corner(parameters, mesh.edges, corners)
    np.testing.assert_allclose(actual, np.mean(1.0 - sines), rtol=1e-9)


def test_without_seams_there_are_no_boundary_corners():
    mesh, corners, parameters = prepared(curved())
    assert boundary_corner(parameters, mesh.edges, corners) == 0.0


def needle(height):
    """A triangle with one sharp corner at the origin."""
    corners = [(0.0, 0.0), (0.4, 0.0), (0.4, height)]
    return Pattern((make_panel("a", corners, [line(0, 1), line(1, 2), line(2, 0)]),))


def test_small_angles_in_closed_form():
    height = 0.4 * np.tan(0.2)
    mesh, corners, _ = prepared(needle(height))
    rest = jnp.asarray(mesh.meshed_positions)
    signs = corner_signs(rest, corners)
    # The loop is counter-clockwise: from the corner the sample before is turned to the left.
    np.testing.assert_allclose(small_angle(rest, corners, signs), -np.sin(0.2) / 3.0, rtol=1e-9)
    assert small_angle(rest, corners, signs, threshold=0.19) == 0.0
    # Flat: nothing is gained. Turned inside out: it costs.
    flipped = rest * jnp.array([[1.0, -1.0]])
    np.testing.assert_allclose(small_angle(flipped, corners, signs), np.sin(0.2) / 3.0, rtol=1e-9)


def test_small_angles_are_pushed_open():
    mesh, corners, parameters = prepared(needle(0.06))
    signs = corner_signs(jnp.asarray(mesh.meshed_positions), corners)

    def value(parameters):
        return small_angle(rest_positions(parameters, mesh), corners, signs)

    descent = -jax.grad(value)(parameters).vertices
    assert descent[2, 1] > 0.0 > descent[1, 1]
    check_slope(value, moved(parameters, 1e-3), tolerance=DERIVATIVE)


def test_consistency_grows_with_curvature_and_vanishes_on_lines():
    mesh, corners, parameters = prepared(two_panels(0.1))
    value = discretization_consistency(
        parameters, jnp.asarray(mesh.meshed_positions), mesh.edges, corners
    )
    assert abs(value) < EXACT
    costs = []
    for edge_length in (0.1, 0.05):
        mesh, corners, parameters = prepared(curved(), edge_length)
        costs.append(
            discretization_consistency(
                parameters, jnp.asarray(mesh.meshed_positions), mesh.edges, corners
            )
        )
    assert costs[0] > 2.0 * costs[1] > 0.0  # second order in the segments


@pytest.mark.parametrize("term", ["boundary", "consistency"])
def test_derivatives_of_corner_terms(term):
    pattern = two_panels(0.08) if term == "boundary" else curved()
    mesh, corners, parameters = prepared(pattern)

    def value(parameters):
        if term == "boundary":
            return boundary_corner(parameters, mesh.edges, corners)
        rest = rest_positions(parameters, mesh)
        return discretization_consistency(parameters, rest, mesh.edges, corners)

    check_slope(value, moved(parameters, 1e-2), tolerance=DERIVATIVE)


def test_seam_curvature_in_closed_form():
    pattern = two_panels()
    mesh, _, parameters = prepared(pattern)
    seam, free = 1, 0
    way = jnp.array([0.03, 0.04])
    controls = parameters.controls.at[seam].add(way).at[free].add(1.0)
    bent = PatternParameters(parameters.vertices, controls)
    stitched = np.asarray(mesh.stitch_edges)
    actual = seam_curvature(bent, parameters, mesh.edges, stitched)
    np.testing.assert_allclose(actual, 0.05 / 2.0, rtol=1e-12)  # one of the seam's two sides
    smooth = seam_curvature(bent, parameters, mesh.edges, stitched, smoothing=1e-3)
    np.testing.assert_allclose(smooth, 0.5 * (np.hypot(0.05, 1e-3) - 1e-3), rtol=1e-12)
    assert seam_curvature(parameters, parameters, mesh.edges, stitched) == 0.0
    for smoothing in (0.0, 1e-3):
        slope = jax.grad(seam_curvature)(
            parameters, parameters, mesh.edges, stitched, smoothing=smoothing
        )
        assert np.all(np.asarray(slope.controls) == 0.0)
    check_slope(
        lambda p: seam_curvature(p, parameters, mesh.edges, stitched, smoothing=1e-3),
        moved(parameters, 1e-2),
        tolerance=DERIVATIVE,
    )


def test_both_controls_of_a_cubic_count():
    panels = (
        curved().panels[0],
        make_panel("b", [(0, 0), (1, 0), (0, 1)], needle(1).panels[0].edges),
    )
    pattern = Pattern(panels, (Stitch(Side("a", 1), Side("b", 0)),))
    mesh, _, parameters = prepared(pattern)
    first, last = mesh.edges.controls[1]
    controls = parameters.controls.at[first, 0].add(0.3).at[last, 1].add(0.4)
    bent = PatternParameters(parameters.vertices, controls)
    actual = seam_curvature(bent, parameters, mesh.edges, np.asarray(mesh.stitch_edges))
    np.testing.assert_allclose(actual, 0.5 / 2.0, rtol=1e-12)


def square_cloth(edge_length=0.05):
    """A flat square as positions, rest positions and faces."""
    corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
    panel = make_panel("a", corners, [line(k, (k + 1) % 4) for k in range(4)])
    mesh = discretize(Pattern((panel,)), edge_length)
    rest = jnp.asarray(mesh.meshed_positions)
    faces = np.asarray(mesh.faces)
    return rest, jnp.asarray(faces.T), interior_vertices(faces, mesh.vertex_count)


def lifted(rest, height):
    return jnp.concatenate([rest, height[:, None]], axis=1)


def test_laplacian_of_flat_and_evenly_strained_cloth_is_zero():
    rest, faces, interior = square_cloth()
    assert 0 < interior.sum() < len(interior)
    tilted = lifted(1.3 * rest, 0.4 * rest[:, 0] - 0.2 * rest[:, 1])
    assert laplacian(tilted, rest, faces, faces, interior) < 1e-11


def test_laplacian_of_a_paraboloid():
    # z = (x^2 + y^2) / 2 has the Laplacian 2; the integral of 4 over the inner area is left.
    rest, faces, interior = square_cloth(0.02)
    bowl = lifted(rest, 0.5 * jnp.sum(rest**2, axis=1))
    actual = laplacian(bowl, rest, faces, faces, interior)
    np.testing.assert_allclose(actual, 2.0, rtol=0.05)  # a rim of half an edge is missing
    wavy = lifted(rest, 0.01 * jnp.sin(40.0 * rest[:, 0]))
    assert laplacian(wavy, rest, faces, faces, interior) > actual  # wrinkles cost more


def test_derivative_of_the_laplacian():
    rest, faces, interior = square_cloth(0.2)
    rng = np.random.default_rng(4)
    drape = lifted(rest, 0.1 * jnp.asarray(rng.normal(size=len(rest))))

    def value(both):
        return laplacian(both[0], both[1], faces, faces, interior)

    check_slope(value, (drape, rest), tolerance=DERIVATIVE)
    flat = lifted(rest, jnp.zeros(len(rest)))
    assert np.all(np.isfinite(jax.grad(value)((flat, rest))[0]))
