"""Discretization: samples, seams, welding, orientation, and rest positions with derivatives."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from documents import SQUARE_VERTICES, curved, document, loop, panel, pillow, stitch
from jax.flatten_util import ravel_pytree

from dress_jax.core.errors import InputError
from dress_jax.geometry.triangulation import triangle_areas
from dress_jax.pattern import (
    EdgeKind,
    PatternParameters,
    build,
    components,
    discretize,
    edge_lengths,
    edge_table,
    parse_specification,
    pattern_parameters,
    placed_positions,
    rest_positions,
    samples_of_edge,
    with_parameters,
)
from dress_jax.pattern.outline import edge_points
from dress_jax.pattern.templates import sleeveless_dress
from dress_jax.pattern.welding import PanelMesh, faulty_segments, split_faulty_edges

MESHED = 1e-12  # [m], the harmonic solve's rounding
DERIVATIVE = 1e-7  # relative, central differences with a step of 1e-6
UNIFORM = 1e-9  # relative, arc-length inversion

CURVED = parse_specification(curved())
CURVED_MESH = discretize(CURVED, 0.03)


def edge_uses(faces):
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, undirected = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)
    _, oriented = np.unique(directed, axis=0, return_counts=True)
    return undirected, oriented


def assert_surface(mesh):
    """Every welded edge has at most two faces, on opposite sides, and no face is degenerate."""
    undirected, oriented = edge_uses(mesh.faces)
    assert undirected.max() <= 2
    assert oriented.max() == 1
    corners = np.sort(mesh.faces, axis=1)
    assert (corners[:, :-1] != corners[:, 1:]).all()


def euler_characteristic(mesh):
    undirected, _ = edge_uses(mesh.faces)
    return mesh.vertex_count - len(undirected) + len(mesh.faces)


def with_chord_middles(parameters):
    """Parameters in general position, so that no derivative vanishes by symmetry."""
    rng = np.random.default_rng(5)
    return PatternParameters(
        vertices=parameters.vertices + 1e-3 * rng.normal(size=parameters.vertices.shape),
        controls=parameters.controls + 1e-2 * rng.normal(size=parameters.controls.shape),
    )


def test_rest_positions_are_the_meshed_ones():
    rest = rest_positions(pattern_parameters(CURVED), CURVED_MESH)
    np.testing.assert_allclose(rest, CURVED_MESH.meshed_positions, atol=MESHED)


def test_rest_positions_match_central_differences_in_every_parameter():
    parameters = with_chord_middles(pattern_parameters(CURVED))
    rng = np.random.default_rng(7)
    weights = jnp.asarray(rng.normal(size=(len(CURVED_MESH.weld_map), 2)))

    @jax.jit
    def value(parameters, mesh):
        return jnp.sum(weights * rest_positions(parameters, mesh))

    gradient = jax.grad(value)(parameters, CURVED_MESH)
    flat, unravel = ravel_pytree(parameters)
    actual, _ = ravel_pytree(gradient)
    step = 1e-6
    expected = [
        (
            value(unravel(flat.at[i].add(step)), CURVED_MESH)
            - value(unravel(flat.at[i].add(-step)), CURVED_MESH)
        )
        / (2.0 * step)
        for i in range(len(flat))
    ]
    scale = float(np.abs(actual).max())
    np.testing.assert_allclose(actual, expected, atol=DERIVATIVE * scale)
    # Only an arc's first number has no effect.
    arc_row = int(CURVED_MESH.edges.controls[0, 0])
    silent = np.zeros(parameters.controls.shape, dtype=bool)
    silent[arc_row, 0] = True
    assert (np.abs(gradient.vertices) > 0.0).all()
    np.testing.assert_array_equal(np.asarray(gradient.controls) == 0.0, silent)


def test_moved_corners_keep_controls_relative():
    # Rotating and scaling all corners is a similarity, which relative controls follow exactly.
    parameters = pattern_parameters(CURVED)
    matrix = 1.3 * np.array([[np.cos(0.4), np.sin(0.4)], [-np.sin(0.4), np.cos(0.4)]])
    moved = PatternParameters(parameters.vertices @ matrix + 0.2, parameters.controls)
    np.testing.assert_allclose(
        rest_positions(moved, CURVED_MESH),
        CURVED_MESH.meshed_positions @ matrix + 0.2,
        atol=1e-11,
    )


def test_one_program_serves_all_parameters():
    traces = []

    @jax.jit
    def rest(parameters, mesh):
        traces.append(1)
        return rest_positions(parameters, mesh)

    parameters = pattern_parameters(CURVED)
    rest(parameters, CURVED_MESH)
    rest(with_chord_middles(parameters), CURVED_MESH)
    rest(parameters, discretize(CURVED, 0.03))
    assert len(traces) == 1


def test_samples_are_uniform_and_seams_have_equal_counts():
    for number in range(len(CURVED.panels)):
        for edge in range(len(CURVED.panels[number].edges)):
            samples = samples_of_edge(CURVED_MESH, number, edge)
            assert len(samples) >= 2
            steps = np.hypot(*np.diff(CURVED_MESH.meshed_positions[samples], axis=0).T)
            assert steps.max() <= 0.03 * (1.0 + UNIFORM)
            if CURVED.panels[number].edges[edge].kind in (EdgeKind.LINE, EdgeKind.ARC):
                np.testing.assert_allclose(steps, steps[0], rtol=UNIFORM)
    first, second = samples_of_edge(CURVED_MESH, 0, 4), samples_of_edge(CURVED_MESH, 1, 1)
    assert len(first) == len(second)
    # This stitch is right_wrong: start meets start.
    np.testing.assert_array_equal(CURVED_MESH.seam_vertices, np.stack([first, second], axis=1))
    np.testing.assert_array_equal(CURVED_MESH.weld_map[first], CURVED_MESH.weld_map[second])


def test_default_stitches_join_start_and_end():
    mesh = discretize(parse_specification(pillow()), 0.05)
    pairs = mesh.seam_vertices[mesh.seam_offset[1] : mesh.seam_offset[2]]
    np.testing.assert_array_equal(pairs[:, 0], samples_of_edge(mesh, 0, 1))
    np.testing.assert_array_equal(pairs[:, 1], samples_of_edge(mesh, 1, 3)[::-1])
    # The panels face each other, so default pairing joins points at equal x and y in the world.
    world = placed_positions(
        rest_positions(pattern_parameters(parse_specification(pillow())), mesh), mesh
    )
    gaps = np.asarray(world)[mesh.seam_vertices[:, 0]] - np.asarray(world)[mesh.seam_vertices[:, 1]]
    np.testing.assert_allclose(gaps, np.tile([0.0, 0.0, 0.4], (len(gaps), 1)), atol=1e-12)


@pytest.mark.parametrize("edge_length", [0.03, 0.1, 0.5])
def test_a_pillow_is_a_sphere_at_every_resolution(edge_length):
    mesh = discretize(parse_specification(pillow()), edge_length)
    assert_surface(mesh)
    assert euler_characteristic(mesh) == 2
    assert edge_uses(mesh.faces)[0].min() == 2  # closed
    np.testing.assert_allclose(
        rest_positions(pattern_parameters(parse_specification(pillow())), mesh),
        mesh.meshed_positions,
        atol=MESHED,
    )


@pytest.mark.parametrize("edge_length", [0.03, 0.1, 0.5])
def test_a_panel_sewn_into_a_cone(edge_length):
    # Two neighbouring edges of one convex corner: every edge at the tip has to be kept apart.
    source = document({"a": panel(SQUARE_VERTICES)}, [stitch(("a", 0), ("a", 3))])
    mesh = discretize(parse_specification(source), edge_length)
    assert_surface(mesh)
    assert euler_characteristic(mesh) == 1  # a disc


@pytest.mark.parametrize("edge_length", [0.03, 0.1, 0.5])
def test_a_panel_sewn_into_a_tube(edge_length):
    source = document({"a": panel(SQUARE_VERTICES)}, [stitch(("a", 1), ("a", 3))])
    mesh = discretize(parse_specification(source), edge_length)
    assert_surface(mesh)
    assert euler_characteristic(mesh) == 0


@pytest.mark.parametrize("edge_length", [0.01, 0.05, 0.3])
def test_a_dart(edge_length):
    vertices = [[0, 0], [40, 0], [40, 30], [22, 30], [20, 12], [18, 30], [0, 30]]
    source = document({"a": panel(vertices)}, [stitch(("a", 3), ("a", 4))])
    mesh = discretize(parse_specification(source), edge_length)
    assert_surface(mesh)
    assert euler_characteristic(mesh) == 1
    tip = samples_of_edge(mesh, 0, 3)[-1]
    assert not (mesh.seam_vertices == tip).any()  # a pair of a vertex with itself is left out
    opening = samples_of_edge(mesh, 0, 3)[0], samples_of_edge(mesh, 0, 4)[-1]
    assert mesh.weld_map[opening[0]] == mesh.weld_map[opening[1]]


def test_gathers_keep_both_rest_lengths():
    wide = [[0.0, 0.0], [80.0, 0.0], [80.0, 30.0], [0.0, 30.0]]
    source = document(
        {"wide": panel(wide), "narrow": panel(SQUARE_VERTICES)},
        [stitch(("wide", 2), ("narrow", 0))],
    )
    pattern = parse_specification(source)
    mesh = discretize(pattern, 0.02)
    assert len(samples_of_edge(mesh, 0, 2)) == len(samples_of_edge(mesh, 1, 0)) == 41
    lengths = edge_lengths(pattern_parameters(pattern), mesh.edges)
    np.testing.assert_allclose(lengths[jnp.array([2, 4])], [0.8, 0.4], rtol=1e-12)


def test_right_wrong_panels_are_turned_around():
    # A small collar lies on the large panel: right side to wrong side.
    collar = [[0.0, 0.0], [40.0, 0.0], [40.0, 6.0], [0.0, 6.0]]
    source = document(
        {"collar": panel(collar), "body": panel(SQUARE_VERTICES)},
        [stitch(("collar", 0), ("body", 2), "right_wrong")],
    )
    mesh = discretize(parse_specification(source), 0.03)
    np.testing.assert_array_equal(mesh.orientation, [-1, 1])
    assert mesh.seam_consistent.all()
    assert_surface(mesh)


def test_a_one_sided_garment_is_reported():
    source = document({"a": panel(SQUARE_VERTICES)}, [stitch(("a", 1), ("a", 3), "right_wrong")])
    mesh = discretize(parse_specification(source), 0.03)
    assert not mesh.seam_consistent.any()
    assert edge_uses(mesh.faces)[0].max() == 2


@pytest.mark.parametrize("clockwise", [False, True])
def test_faces_follow_the_loop(clockwise):
    vertices = SQUARE_VERTICES[::-1] if clockwise else SQUARE_VERTICES
    mesh = discretize(parse_specification(document({"a": panel(vertices)})), 0.05)
    areas = triangle_areas(mesh.meshed_positions, mesh.rest_faces)
    assert (areas * mesh.orientation[0] > 0.0).all()
    assert mesh.orientation[0] == (-1 if clockwise else 1)
    np.testing.assert_allclose(abs(areas.sum()), 0.12, rtol=1e-12)


def test_tables_agree_with_each_other():
    mesh = CURVED_MESH
    np.testing.assert_array_equal(mesh.faces, mesh.weld_map[mesh.rest_faces])
    np.testing.assert_array_equal(np.unique(mesh.weld_map), np.arange(mesh.vertex_count))
    np.testing.assert_array_equal(
        mesh.panel_of_vertex[mesh.rest_faces], np.repeat(mesh.face_panel[:, None], 3, axis=1)
    )
    np.testing.assert_array_equal(
        np.bincount(mesh.panel_of_vertex), np.diff(np.asarray(mesh.panel_offset))
    )
    corners = samples_of_edge(mesh, 0, 2)[[0, -1]]
    np.testing.assert_allclose(
        mesh.meshed_positions[corners], CURVED.panels[0].vertices[[2, 3]], atol=1e-15
    )


def test_placement_is_rigid_and_differentiable():
    rest = rest_positions(pattern_parameters(CURVED), CURVED_MESH)
    world = placed_positions(rest, CURVED_MESH)
    owner = CURVED_MESH.panel_of_vertex
    for number, one in enumerate(CURVED.panels):
        local = np.c_[np.asarray(rest)[owner == number], np.zeros(np.sum(owner == number))]
        expected = local @ one.rotation.T + one.translation
        np.testing.assert_allclose(np.asarray(world)[owner == number], expected, atol=1e-14)
    direction = jnp.ones_like(rest)
    _, moved = jax.jvp(lambda x: placed_positions(x, CURVED_MESH), (rest,), (direction,))
    np.testing.assert_allclose(jnp.sum(moved**2, axis=1), 2.0, rtol=1e-12)


def test_components_follow_seams():
    panels = {name: panel(SQUARE_VERTICES) for name in "abcde"}
    source = document(panels, [stitch(("a", 0), ("d", 0)), stitch(("d", 1), ("c", 1))])
    mesh = discretize(parse_specification(source), 0.2)
    np.testing.assert_array_equal(components(mesh), [0, 1, 0, 0, 2])


def test_lines_become_curves_when_their_control_moves():
    pattern = parse_specification(document({"a": panel(SQUARE_VERTICES)}))
    parameters = pattern_parameters(pattern)
    same = with_parameters(pattern, parameters)
    assert all(edge.kind == EdgeKind.LINE for edge in same.panels[0].edges)
    controls = parameters.controls.at[1, 1].set(0.2)
    curved_pattern = with_parameters(pattern, PatternParameters(parameters.vertices, controls))
    kinds = [edge.kind for edge in curved_pattern.panels[0].edges]
    assert kinds == [EdgeKind.LINE, EdgeKind.QUADRATIC, EdgeKind.LINE, EdgeKind.LINE]
    mesh = discretize(curved_pattern, 0.02)
    np.testing.assert_allclose(
        rest_positions(pattern_parameters(curved_pattern), mesh), mesh.meshed_positions, atol=MESHED
    )


def test_with_parameters_refuses_what_does_not_fit():
    parameters = pattern_parameters(CURVED)
    with pytest.raises(InputError, match="do not fit"):
        with_parameters(CURVED, PatternParameters(parameters.vertices[1:], parameters.controls))
    bad = parameters.vertices.at[0, 0].set(jnp.nan)
    with pytest.raises(InputError, match="not finite"):
        with_parameters(CURVED, PatternParameters(bad, parameters.controls))


def test_edge_lengths_match_samples_and_differentiate():
    parameters = with_chord_middles(pattern_parameters(CURVED))
    table = edge_table(CURVED)
    lengths = edge_lengths(parameters, table)
    moved = with_parameters(CURVED, parameters).panels[0]
    for number, edge in enumerate(moved.edges):
        points = edge_points(moved, edge, np.linspace(0.0, 1.0, 100_001))
        polyline = np.hypot(*np.diff(points, axis=0).T).sum()
        np.testing.assert_allclose(lengths[number], polyline, rtol=1e-9)

    @jax.jit
    def value(parameters):
        return jnp.sum(edge_lengths(parameters, table) ** 2)

    gradient = jax.grad(value)(parameters)
    step = 1e-6
    for row in range(parameters.controls.shape[0]):
        for axis in range(2):
            ends = [
                value(
                    PatternParameters(parameters.vertices, parameters.controls.at[row, axis].add(s))
                )
                for s in (step, -step)
            ]
            expected = (ends[0] - ends[1]) / (2.0 * step)
            np.testing.assert_allclose(gradient.controls[row, axis], expected, atol=1e-8)


def test_straight_edges_have_finite_length_gradients():
    pattern = parse_specification(document({"a": panel(SQUARE_VERTICES)}))
    table = edge_table(pattern)
    gradient = jax.grad(lambda p: jnp.sum(edge_lengths(p, table)))(pattern_parameters(pattern))
    assert np.isfinite(gradient.vertices).all() and np.isfinite(gradient.controls).all()


@pytest.mark.parametrize("edge_length", [0.0, -0.01, float("nan")])
def test_bad_edge_lengths(edge_length):
    with pytest.raises(InputError, match="edge length"):
        discretize(CURVED, edge_length)


def test_crossing_panels_of_an_optimised_pattern_are_named():
    pattern = parse_specification(pillow(), source="shirt.json")
    parameters = pattern_parameters(pattern)
    crossed = parameters.vertices.at[1].set(jnp.array([-0.1, 0.2]))
    pattern = with_parameters(pattern, PatternParameters(crossed, parameters.controls))
    with pytest.raises(InputError, match=r"shirt.json, panel 'front'.*edges 1 and 3 cross"):
        discretize(pattern, 0.03)


@pytest.mark.parametrize("edge_length", [0.05, 0.5])
def test_three_corners_of_one_panel_may_become_one_vertex(edge_length):
    # Start on start of neighbouring edges: corners 0, 1 and 2 are welded.
    source = document({"a": panel(SQUARE_VERTICES)}, [stitch(("a", 0), ("a", 1), "right_wrong")])
    mesh = discretize(parse_specification(source), edge_length)
    corners = [samples_of_edge(mesh, 0, edge)[0] for edge in range(3)]
    assert len(set(mesh.weld_map[corners].tolist())) == 1
    assert edge_uses(mesh.faces)[0].max() == 2


def test_edges_that_stay_folded_are_named(monkeypatch):
    # A tube of one segment around is a point; without another attempt that is an error.
    monkeypatch.setattr(build, "_MAX_ATTEMPTS", 1)
    source = document({"a": panel(SQUARE_VERTICES)}, [stitch(("a", 1), ("a", 3))])
    with pytest.raises(InputError, match=r"tube.json, panel 'a', edge 0.*folds this edge"):
        discretize(parse_specification(source, source="tube.json"), 0.5)


def test_faulty_segments_are_found():
    # A square 0 1 2 3 whose corners 0 and 1 are one, and 2 and 3 another.
    ends = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    label = np.array([0, 0, 1, 1])
    collapsed_or_folded = faulty_segments(ends, np.full(4, -1), label)
    np.testing.assert_array_equal(collapsed_or_folded, [True, True, True, True])
    sewn = faulty_segments(ends, np.array([-1, 3, -1, 1]), label)
    np.testing.assert_array_equal(sewn, [True, False, True, False])


def test_inner_edges_that_stay_at_fault_are_named():
    # Two squares of two triangles each, all four corners sewn: the diagonals coincide.
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    mesh = PanelMesh(points, np.array([[0, 1, 2], [0, 2, 3]]), 4)
    label = [np.arange(4), np.arange(4)]
    with pytest.raises(InputError, match="more than two triangles"):
        split_faulty_edges([mesh, mesh], label, max_rounds=0)
    first, second = split_faulty_edges([mesh, mesh], label)
    for split in (first, second):
        assert len(split.points) == 5 and len(split.faces) == 4
        np.testing.assert_allclose(triangle_areas(split.points, split.faces), 0.25)


def test_a_narrow_slit_gets_finer_samples_instead_of_an_error():
    # Two arcs bulge past each other's chords without touching: coarse polylines cross.
    edges = loop(6)
    edges[2]["curvature"] = {"type": "quadratic", "params": [[0.5, -0.35]]}
    edges[3]["curvature"] = {"type": "quadratic", "params": [[0.5, 0.33]]}
    vertices = [[0, 0], [40, 0], [40, 30], [20, 2], [0, 30.0], [-5, 15]]
    pattern = parse_specification(document({"a": panel(vertices, edges)}))
    mesh = discretize(pattern, 0.2)
    assert_surface(mesh)


def test_mirrored_panels_get_mirrored_samples():
    dress = sleeveless_dress()
    mesh = discretize(dress, 0.05)
    outline = mesh.meshed_positions[samples_of_edge(mesh, 0, 1)]
    other = mesh.meshed_positions[samples_of_edge(mesh, 0, 7)][::-1]
    np.testing.assert_allclose(outline, other * np.array([-1.0, 1.0]), atol=1e-14)


def test_trial_patterns_weld_into_oriented_surfaces(shared_data):
    paths = sorted((shared_data / "patterns" / "garmentcodedata").glob("*.json"))
    # The second name holds right_wrong stitches, the others are spread over the folder.
    names = {path.name for path in paths[::30]} | {"rand_0MQTO8DP3W_specification.json"}
    for path in paths:
        if path.name not in names:
            continue
        mesh = discretize(parse_specification(json.loads(path.read_text()), source=path.name), 0.03)
        assert_surface(mesh)
        assert mesh.seam_consistent.all(), path.name


def test_rest_positions_need_double_precision():
    parameters = pattern_parameters(CURVED)
    with jax.enable_x64(False), pytest.raises(RuntimeError, match="jax_enable_x64"):
        rest_positions(parameters, CURVED_MESH)


def test_a_discretization_is_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        CURVED_MESH.vertex_count = 0
