"""What bundles lack is found, what they have stays; a photograph becomes a view (S6.1-S6.3)."""

import dataclasses

import numpy as np
import pytest

from dress_jax.application.completion import (
    PHOTO_FOCAL,
    MaskSource,
    complete_bundle,
    photo_view,
)
from dress_jax.capture import Bundle, ClothesLabel, Surface, View
from dress_jax.core.errors import InputError
from dress_jax.render.rings import ring_cameras

SIZE = 64


def camera():
    [made] = ring_cameras([0.0], size=SIZE, center=np.array([0.0, 0.9, 0.0]), half_extent=1.0)
    return made


def square(label=ClothesLabel.DRESS):
    vertices = np.array([[-0.2, 0.6, 0.0], [0.2, 0.6, 0.0], [0.2, 1.2, 0.0], [-0.2, 1.2, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return Surface(vertices, faces, labels=np.full(4, label, np.uint8))


def person_on_white():
    rgb = np.full((SIZE, SIZE, 3), 255, np.uint8)
    rgb[10:60, 24:40] = 90
    return rgb


def photograph():
    labels = np.zeros((SIZE, SIZE), np.uint8)
    labels[10:60, 24:40] = ClothesLabel.SKIN
    labels[20:44, 24:40] = ClothesLabel.DRESS
    matte = 255 * (labels > 0).astype(np.uint8)
    return Bundle(image=person_on_white(), matte=matte, labels=labels)


def test_a_photograph_becomes_a_view_with_an_assumed_camera():
    done = complete_bundle(photograph(), longest_side=32, landmarks=False)
    assert done.single_view and "camera is assumed" in done.notes[0]
    [view] = done.bundle.views
    assert (view.camera.height, view.camera.width) == (32, 32)
    assert float(view.camera.scale[0]) == pytest.approx(PHOTO_FOCAL * 32)
    assert view.mask is not None and int((view.mask == 255).sum()) == 12 * 8
    assert list(view.parts) == ["dress"]
    np.testing.assert_array_equal(done.bundle.labels, photograph().labels)  # at full size
    for missing in ("labels", "image"):
        bare = dataclasses.replace(photograph(), **{missing: None})
        with pytest.raises(InputError, match=r"neither views nor a photograph.*--source photo"):
            photo_view(bare)


def test_masks_that_are_there_stay():
    mask = np.zeros((SIZE, SIZE), np.uint8)
    mask[20:30] = 200
    bundle = Bundle(views=(View("a", camera(), mask=mask),), scan=square())
    done = complete_bundle(bundle, landmarks=False)
    assert done.notes == () and not done.single_view
    np.testing.assert_array_equal(done.bundle.views[0].mask, mask)
    drawn = complete_bundle(bundle, masks=MaskSource.SCAN, landmarks=False)
    assert "drawn from the scan" in drawn.notes[-1]
    assert (drawn.bundle.views[0].mask != mask).any()


def test_a_labelled_scan_gives_masks_where_there_are_none():
    bundle = Bundle(views=(View("a", camera()),), scan=square())
    [view] = complete_bundle(bundle, landmarks=False).bundle.views
    assert view.mask is not None
    rows, columns = np.nonzero(view.mask > 128)
    pixel = 2.0 / SIZE
    assert (np.ptp(rows) + 1) * pixel == pytest.approx(0.6, abs=0.05)
    assert (np.ptp(columns) + 1) * pixel == pytest.approx(0.4, abs=0.05)


def test_what_cannot_be_found_is_named():
    blind = Bundle(views=(View("a", camera()),))
    with pytest.raises(InputError, match=r"parser needs colours and landmarks in every view"):
        complete_bundle(blind)
    with pytest.raises(InputError, match=r"view 'a': has no mask.*--masks parser"):
        complete_bundle(blind, masks=MaskSource.GIVEN, landmarks=False)
    # Nobody is in this picture: the view stays without landmarks, and the note says so.
    mask = np.full((SIZE, SIZE), 255, np.uint8)
    boring = View("a", camera(), rgb=person_on_white(), mask=mask)
    done = complete_bundle(Bundle(views=(boring,)))
    assert done.bundle.views[0].landmarks is None
    assert done.notes[-1] == "Views in which the landmark network saw nobody: a."
    matte = done.bundle.views[0].matte
    assert matte is not None and int((matte == 255).sum()) == 50 * 16
