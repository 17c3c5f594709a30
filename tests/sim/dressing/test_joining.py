"""Panels that become one welded surface: no crossing, no squashing, components in order."""

import numpy as np
import pytest
import trimesh

from dress_jax.geometry.intersection import count_intersections, minimum_distance
from dress_jax.geometry.topology import unique_edges
from dress_jax.io.body_meshes import load_body_mesh
from dress_jax.io.patterns import load_pattern
from dress_jax.pattern import Pattern
from dress_jax.sim.dressing.components import split_components
from dress_jax.sim.dressing.growth import make_collider, plan_growth
from dress_jax.sim.dressing.joining import join
from tests.sim.dressing.dressing_scenes import (
    arranged,
    panel,
    person,
    stitched,
    tube,
    tube_parts,
)

CLEARANCE = 1e-5
# GarmentCode patterns whose panels cross, or nearly do, as soon as their seams meet.
TANGLED = ("tshirt", "fitted_shirt_long", "jumpsuit", "pants_cuffed", "circle_skirt")


def surfaces(pattern: Pattern, edge_length: float):
    return [part.surface for part in split_components(*arranged(pattern, edge_length))]


def assert_free(joined, surface) -> None:
    assert joined.free
    assert count_intersections(joined.positions, surface.faces).self == 0
    assert minimum_distance(joined.positions, surface.faces) >= CLEARANCE


def test_a_tube_is_joined_around_its_axis_and_keeps_its_length():
    (surface,) = surfaces(tube(top=100.0, bottom=60.0, half_width=30.0), 0.04)
    joined = join(surface, clearance=CLEARANCE)
    assert_free(joined, surface)
    x = joined.positions
    angles = np.arctan2(x[:, 0], x[:, 2])
    assert np.ptp(angles) > np.pi  # it goes around
    # Free edges are not drawn in: the hem and the waist stay at their heights.
    assert x[:, 1].max() == pytest.approx(1.0, abs=0.01)
    assert x[:, 1].min() == pytest.approx(0.6, abs=0.01)


def test_a_narrow_strap_keeps_its_width():
    """Plain smoothing would squash a strip that is narrower than the smoothing length."""
    strip = [(-2.0, 0.0), (2.0, 0.0), (2.0, 40.0), (-2.0, 40.0)]
    panels = {"front": panel(strip, z=20.0), "back": panel(strip, z=-20.0, back=True)}
    (surface,) = surfaces(stitched(panels, [("front", 2, "back", 2)]), 0.015)
    joined = join(surface, clearance=CLEARANCE)
    assert_free(joined, surface)
    rest = np.ptp(surface.rest_positions[:, 0])
    middle = np.abs(joined.positions[:, 1] - 0.2) < 0.05
    assert np.ptp(joined.positions[middle, 0]) > 0.9 * rest


def test_panels_that_cross_as_placed_are_freed():
    pattern = tube(top=100.0, bottom=60.0, half_width=30.0, gap=25.0)
    made, rest, placed = arranged(pattern, 0.04)
    owner = np.asarray(made.panel_of_vertex)
    bulged = placed.copy()
    # The middle of one panel bulges through the other.
    back = owner == 1
    distance = np.hypot(placed[back, 0], placed[back, 1] - 0.8)
    bulged[back, 2] += 0.8 * np.exp(-((distance / 0.06) ** 2))
    weld = np.asarray(made.weld_map)
    assert count_intersections(bulged, np.asarray(made.rest_faces), weld_ids=weld).self > 0
    (component,) = split_components(made, rest, bulged)
    joined = join(component.surface, clearance=CLEARANCE)
    assert_free(joined, component.surface)


def test_what_cannot_be_freed_says_where():
    """Each side sewn to the opposite one: the sheets run through each other."""
    panels, _ = tube_parts("tube", 100.0, 60.0, 30.0, 25.0)
    seams = [("tube_front", 1, "tube_back", 1), ("tube_front", 3, "tube_back", 3)]
    (surface,) = surfaces(stitched(panels, seams), 0.04)
    joined = join(surface, clearance=CLEARANCE)
    assert not joined.free
    assert joined.crossed.any()
    assert joined.crossed.shape == (len(surface.faces),)


def test_a_skeleton_that_leaves_the_garment_is_taken_back_in():
    """A core that bulges 3 cm through the front of a tube, as a branching skeleton does."""
    (surface,) = surfaces(tube(top=100.0, bottom=60.0, half_width=30.0), 0.04)
    plain = join(surface, clearance=CLEARANCE)
    rod = trimesh.creation.cylinder(radius=0.005, height=0.6, sections=6).subdivide_loop(4)
    core = np.asarray(rod.vertices)[:, [0, 2, 1]] + np.array([0.0, 0.8, 0.0])
    front = plain.positions[np.abs(plain.positions[:, 1] - 0.8) < 0.05, 2].max()
    core[:, 2] += (front + 0.03) * np.exp(-(((core[:, 1] - 0.8) / 0.06) ** 2))
    faces = np.asarray(rod.faces)
    assert count_intersections(plain.positions, surface.faces, core, faces).body > 0
    joined = join(surface, clearance=CLEARANCE, core=(core, faces))
    assert_free(joined, surface)
    assert count_intersections(joined.positions, surface.faces, core, faces).body == 0
    # Around it, not beside it: the front is in front of the core, the back behind it.
    middle = np.abs(joined.positions[:, 1] - 0.8) < 0.04
    bulge = core[np.abs(core[:, 1] - 0.8) < 0.04, 2]
    assert joined.positions[middle, 2].max() > bulge.max()
    assert joined.positions[middle, 2].min() < bulge.min()


def test_sleeves_that_lie_in_a_skirt_are_drawn_out_of_it(shared_data):
    """Smoothing alone does not free this one, which is a dress with wide sleeves."""
    name = "rand_I0CCWU9UJN_specification.json"
    pattern = load_pattern(shared_data / "patterns" / "garmentcodedata" / name)
    (surface,) = surfaces(pattern, 0.03)
    body, faces = load_body_mesh(shared_data / "bodies" / "mean_all.obj")
    collider = make_collider(body, faces)
    core = collider.thinned(1.0, arms=1.0, arm_length=0.0), collider.faces
    assert not join(surface, clearance=CLEARANCE).free
    joined = join(surface, clearance=CLEARANCE, core=core)
    assert_free(joined, surface)
    assert plan_growth(collider, joined.positions, surface.faces) is not None


def test_components_come_from_the_lowest_to_the_highest():
    upper, upper_seams = tube_parts("top", 135.0, 95.0, 30.0, 25.0)
    lower, lower_seams = tube_parts("skirt", 105.0, 60.0, 30.0, 25.0)
    made, rest, placed = arranged(stitched({**upper, **lower}, upper_seams + lower_seams), 0.05)
    parts = split_components(made, rest, placed)
    assert [part.panels for part in parts] == [
        ("skirt_front", "skirt_back"),
        ("top_front", "top_back"),
    ]
    everything = np.sort(np.concatenate([part.vertices for part in parts]))
    np.testing.assert_array_equal(everything, np.arange(made.vertex_count))
    faces = np.asarray(made.faces)
    for part in parts:
        own = part.vertices[part.surface.faces]
        assert {tuple(row) for row in own.tolist()} <= {tuple(row) for row in faces.tolist()}


@pytest.mark.parametrize("name", TANGLED)
def test_real_patterns_are_joined_without_a_crossing(shared_data, name):
    path = shared_data / "patterns" / "garmentcode" / f"{name}_specification.json"
    for surface in surfaces(load_pattern(path), 0.03):
        joined = join(surface, clearance=CLEARANCE)
        assert_free(joined, surface)
        # It stays near the panels: no collapse.
        edges = unique_edges(surface.faces)
        lengths = np.linalg.norm(np.diff(joined.positions[edges], axis=1)[:, 0], axis=1)
        assert np.median(lengths) > 0.4 * surface.edge_length


def test_a_wide_skirt_is_put_on_with_the_arms_drawn_in():
    body, faces = person("a")
    collider = make_collider(body, faces)
    (surface,) = surfaces(tube(top=105.0, bottom=90.0, half_width=20.0, flare=70.0), 0.05)
    joined = join(surface, clearance=CLEARANCE)
    growth = plan_growth(collider, joined.positions, surface.faces)
    assert growth is not None
    assert growth.arms_drawn_in
    first = count_intersections(joined.positions, surface.faces, growth.frames[0], faces)
    assert first.body == 0
    np.testing.assert_array_equal(growth.arm_frames[-1], body)
    # The arms, and nothing else, are missing before they grow out again.
    missing = np.linalg.norm(growth.frames[-1] - body, axis=1) > 1e-12
    arms = np.any([limb.part for limb in collider.skeleton.limbs[:2]], axis=0)
    np.testing.assert_array_equal(missing, arms)


def test_a_narrow_skirt_needs_no_such_thing():
    body, faces = person("a")
    (surface,) = surfaces(tube(top=100.0, bottom=50.0, half_width=30.0), 0.05)
    joined = join(surface, clearance=CLEARANCE)
    growth = plan_growth(make_collider(body, faces), joined.positions, surface.faces)
    assert growth is not None
    assert not growth.arms_drawn_in
    assert growth.contraction < 1.0
    np.testing.assert_array_equal(growth.frames[-1], body)


def test_panels_beside_the_body_have_no_place_to_grow():
    """A ring through which the trunk runs cannot be freed."""
    body, faces = person("a")
    (surface,) = surfaces(tube(top=100.0, bottom=50.0, half_width=30.0), 0.05)
    joined = join(surface, clearance=CLEARANCE)
    aside = joined.positions + np.array([0.25, 0.0, 0.0])
    assert plan_growth(make_collider(body, faces), aside, surface.faces) is None
