"""Templates are chosen by what clothes cover in any pose; patterns stand on the floor (S4)."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dress_jax.application.start_pattern import (
    SMPL_ORIGIN,
    find_coverage,
    front_view,
    on_the_floor,
    symmetric,
    template_for,
)
from dress_jax.application.tailor import template_measurements
from dress_jax.application.wearer import fitted_wearer
from dress_jax.body.poses import relaxed_pose, t_pose
from dress_jax.body.skeleton import joint_index
from dress_jax.capture import View
from dress_jax.core.errors import InputError
from dress_jax.io.bodies import load_default_body
from dress_jax.pattern.templates import sleeveless_dress, straight_skirt
from dress_jax.render.images import render
from dress_jax.render.mesh import make_render_mesh
from dress_jax.render.rings import frame_body, ring_cameras

SIZE = 160
HEM, SLEEVE = 0.03, 0.03  # bins are 2 cm, pixels 1.3 cm
_render = jax.jit(render)


def sitting_pose():
    """Arms down, one leg raised to the side, a turn of the whole body."""
    pose = relaxed_pose()
    pose[0] = [0.1, 0.3, 0.0]
    pose[joint_index("left_hip")] = [-0.5, 0.0, 0.5]
    pose[joint_index("left_knee")] = [0.6, 0.0, 0.0]
    return pose


@pytest.fixture(scope="module", params=[t_pose, sitting_pose])
def person(request):
    """Wearer, measurements, the front view, and where each pixel's body is in the T pose."""
    model = load_default_body()
    shape = np.zeros(model.shapedirs.shape[2])
    wearer = fitted_wearer(model, request.param(), shape)
    center, half = frame_body(wearer.vertices)
    [camera] = ring_cameras([0.0], size=SIZE, center=center, half_extent=half)
    mesh = make_render_mesh(
        jnp.asarray(wearer.vertices), wearer.faces, attributes=jnp.asarray(wearer.start)
    )
    image = _render(camera, mesh, None)
    place = np.where(np.asarray(image.mask)[..., None] > 0.99, np.asarray(image.attributes), np.nan)
    return wearer, template_measurements(model, shape), View("000", camera), place


def covered(place, low, high, reach, *, arms=True):
    """A mask of the body between two heights, out to a reach along the arms."""
    with np.errstate(invalid="ignore"):
        mask = (place[..., 1] > low) & (place[..., 1] < high) & (np.abs(place[..., 0]) < reach)
        if not arms:
            mask &= ~((np.abs(place[..., 0]) > 0.22) & (place[..., 1] > 1.1))
    return 255 * mask.astype(np.uint8)


@pytest.mark.parametrize(("hem", "reach"), [(0.85, 0.70), (0.62, 0.35)])
def test_hems_and_sleeves_are_read_in_the_dressing_pose(person, hem, reach):
    wearer, measures, view, place = person
    found = find_coverage(view, covered(place, hem, 1.42, reach), wearer, measures)
    assert found.hem_height == pytest.approx(hem, abs=HEM)
    assert found.sleeve_reach == pytest.approx(reach, abs=SLEEVE)


def test_what_has_no_sleeves_is_seen_to_have_none(person):
    wearer, measures, view, place = person
    mask = covered(place, 0.5, 1.40, 0.19)
    assert find_coverage(view, mask, wearer, measures).sleeve_reach == 0.0
    dressed = dataclasses.replace(view, parts={"dress": mask})
    pattern, [note] = template_for(dressed, wearer, measures)
    assert pattern.source == "sleeveless_dress" and "dress begins as our template" in note
    lowest = min(p.translation[1] + p.vertices[:, 1].min() for p in pattern.panels)
    assert lowest == pytest.approx(0.5, abs=HEM)


def test_top_and_trousers_become_an_outfit(person):
    wearer, measures, view, place = person
    parts = {"top": covered(place, 0.9, 1.42, 0.6), "bottom": covered(place, 0.3, 0.9, 0.5)}
    pattern, notes = template_for(dataclasses.replace(view, parts=parts), wearer, measures)
    assert pattern.source == "t_shirt and trousers" and len(notes) == 2
    hems = [p.translation[1] + p.vertices[:, 1].min() for p in pattern.panels]
    assert min(hems) == pytest.approx(0.3, abs=HEM)


def test_a_skirt_covers_the_gap_between_the_legs(person):
    wearer, measures, view, place = person
    body = covered(place, 0.3, 0.9, 0.5)
    filled = body.copy()
    for row in np.flatnonzero(body.any(axis=1)):
        columns = np.flatnonzero(place[row, :, 1] < 0.9)
        filled[row, columns[0] : columns[-1] + 1] = 255
    for mask, source in ((body, "trousers"), (filled, "straight_skirt")):
        found = find_coverage(view, mask, wearer, measures)
        assert found.between_legs is not None
        pattern, _ = template_for(
            dataclasses.replace(view, parts={"bottom": mask}), wearer, measures
        )
        assert pattern.source == source, found


def test_views_that_do_not_tell_are_refused(person):
    wearer, measures, view, _ = person
    with pytest.raises(InputError, match=r"does not say what the clothes are.*--pattern"):
        template_for(view, wearer, measures)
    nothing = dataclasses.replace(view, parts={"top": np.zeros((SIZE, SIZE), np.uint8)})
    with pytest.raises(InputError, match=r"view '000', mask: covers nothing"):
        template_for(nothing, wearer, measures)


def test_the_front_view_is_the_one_closest_to_the_front():
    cameras = ring_cameras([170.0, 20.0, -15.0], size=8, center=np.zeros(3), half_extent=1.0)
    views = tuple(View(str(k), camera) for k, camera in enumerate(cameras))
    assert front_view(views).name == "2"
    with pytest.raises(InputError, match="there are no views"):
        front_view(())


def test_patterns_in_smpls_frame_are_moved_up():
    pattern = straight_skirt()
    assert on_the_floor(pattern, 1.7) == (pattern, "")
    down = tuple(
        dataclasses.replace(p, translation=p.translation - [0.0, SMPL_ORIGIN * 1.7, 0.0])
        for p in pattern.panels
    )
    moved, note = on_the_floor(dataclasses.replace(pattern, panels=down), 1.7)
    assert "moved up by 1.12 m" in note
    for before, after in zip(pattern.panels, moved.panels, strict=True):
        np.testing.assert_allclose(before.translation, after.translation)


def test_noise_of_symmetric_panels_is_taken_out():
    rng = np.random.default_rng(0)
    pattern = sleeveless_dress()
    panels = tuple(
        dataclasses.replace(p, vertices=p.vertices + 1e-3 * rng.normal(size=p.vertices.shape))
        for p in pattern.panels
    )
    made, note = symmetric(dataclasses.replace(pattern, panels=panels))
    assert note.startswith("2 panels or pairs")
    front = made.panel("front").vertices
    # Edge k's corner is mirrored by that of edge 9 - k; a shift of the axis is free.
    across = front[:, 0] + front[(9 - np.arange(8)) % 8, 0]
    np.testing.assert_allclose(across, across[0], atol=1e-6)
    lopsided = panels[0].vertices.copy()
    lopsided[2] += [0.3, 0.1]
    alone = dataclasses.replace(
        pattern, panels=(dataclasses.replace(panels[0], vertices=lopsided),), stitches=()
    )
    assert symmetric(alone) == (alone, "No two panels mirror each other; nothing was symmetrized.")
