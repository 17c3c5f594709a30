"""Bundles as what a fit looks at."""

import dataclasses
import shutil

import jax
import numpy as np
import pytest
from capture_scenes import SIZE, camera, labels

from dress_jax.application.bundle_targets import bundle_targets, draw_masks, read_views
from dress_jax.application.targets import read_targets
from dress_jax.capture import Bundle, Surface, View
from dress_jax.capture.views import with_labels
from dress_jax.core.errors import InputError
from dress_jax.io.capture.bundles import save_bundle
from dress_jax.io.capture.target_folders import read_target_folder
from dress_jax.io.images import Targets, save_targets
from dress_jax.render.cameras import cameras_to_dict
from dress_jax.render.rings import magicman_cameras

RNG = np.random.default_rng(7)
AZIMUTHS = (0, 90, 180, 270)
PIXEL = 1.5 / 255.0
EDGE = 0.6  # [px] between a drawn mask's edge and the true one


def target_folder(folder):
    """A target folder of random pictures, of two garments."""
    cameras = magicman_cameras(4, center=np.array([0.0, 0.9, 0.0]), half_extent=1.0, size=SIZE)
    normal = RNG.normal(size=(4, SIZE, SIZE, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    parts = {name: RNG.integers(0, 2, (4, SIZE, SIZE)) / 1.0 for name in ("bottom", "top")}
    targets = Targets(
        azimuths=AZIMUTHS,
        cameras=tuple(cameras_to_dict(cameras)["cameras"]),
        rgb=RNG.random((4, SIZE, SIZE, 3)),
        normal=normal,
        mask=np.maximum(parts["bottom"], parts["top"]),
        parts=parts,
    )
    save_targets(folder, targets)


@pytest.mark.parametrize("name", ["bundle.h5", "bundle"])
def test_a_fit_sees_a_bundle_as_it_sees_a_target_folder(tmp_path, name):
    target_folder(tmp_path / "targets")
    save_bundle(tmp_path / name, read_target_folder(tmp_path / "targets"))
    expected = read_targets(tmp_path / "targets")
    found = read_views(tmp_path / name)
    assert found.azimuths == expected.azimuths == AZIMUTHS
    assert found.has_color and found.has_normal and found.has_mask
    for field in dataclasses.fields(expected.observation):
        old, new = (getattr(v.observation, field.name) for v in (expected, found))
        if field.name == "parts":
            old = old[..., ::-1]  # a folder sorts by name, a bundle from the top down
        for a, b in zip(jax.tree.leaves(old), jax.tree.leaves(new), strict=True):
            np.testing.assert_allclose(b, a, atol=1e-5, err_msg=field.name)
    folder = read_views(tmp_path / "targets")
    np.testing.assert_array_equal(folder.observation.mask, expected.observation.mask)


def test_hair_and_accessories_do_not_count():
    view = with_labels(View("a", camera()), labels())
    rgb = np.full((SIZE, SIZE, 3), 51, np.uint8)
    observation = bundle_targets(Bundle(views=(dataclasses.replace(view, rgb=rgb),))).observation
    valid = np.asarray(observation.valid[0])
    assert (valid[4:10, 8:14] == 0.0).all() and valid.sum() == SIZE**2 - 36
    assert observation.parts.shape == (1, SIZE, SIZE, 1)  # one kind of clothes
    assert np.asarray(observation.mask[0]).sum() == 30 * 12
    np.testing.assert_allclose(np.asarray(observation.color[0])[20, 10], 0.2, atol=1e-6)
    assert not np.asarray(observation.color[0])[25, 33].any()  # skin


def test_pictures_that_one_view_lacks_are_left_out():
    full = with_labels(View("a", camera()), labels())
    colored = dataclasses.replace(full, rgb=np.zeros((SIZE, SIZE, 3), np.uint8))
    found = bundle_targets(Bundle(views=(colored, dataclasses.replace(full, name="b"))))
    assert not found.has_color and not found.has_normal


def test_what_a_fit_lacks_is_named(tmp_path):
    view = with_labels(View("a", camera()), labels())
    with pytest.raises(InputError, match="views: there are no views"):
        bundle_targets(Bundle(labels=labels()))
    save_bundle(tmp_path / "b.h5", Bundle(views=(view, View("bare", camera()))))
    with pytest.raises(InputError, match=r"b\.h5, view 'bare': has no mask.*--source labels"):
        read_views(tmp_path / "b.h5")
    other = View("c", camera(size=32), mask=np.full((32, 32), 255, np.uint8))
    with pytest.raises(InputError, match="views differ in size"):
        bundle_targets(Bundle(views=(view, other)))
    with pytest.raises(InputError, match="no view shows any garment"):
        bundle_targets(Bundle(views=(dataclasses.replace(view, mask=0 * view.mask),)))
    with pytest.raises(InputError, match=r"none\.h5: there is no such bundle"):
        read_views(tmp_path / "none.h5")


def square(x, y, z, half):
    """Two triangles around a point that look to +z."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half + [x, y]
    return np.concatenate([corners, np.full((4, 1), z)], axis=1), np.array([[0, 1, 2], [0, 2, 3]])


def scanned(kinds, squares):
    vertices = np.concatenate([v for v, _ in squares])
    faces = np.concatenate([f + 4 * k for k, (_, f) in enumerate(squares)])
    return Surface(vertices, faces, labels=np.repeat(np.array(kinds, np.uint8), 4))


def test_masks_are_drawn_from_a_scan_and_hidden_by_its_skin():
    """A top and trousers, an arm in front of the top, and a matte that cuts the picture."""
    scan = scanned(
        [3, 4, 1],
        [square(0.0, 1.2, 0.0, 0.25), square(0.1, 0.6, 0.0, 0.2), square(0.15, 1.2, 0.3, 0.1)],
    )
    [made] = magicman_cameras(1, center=np.array([0.0, 0.9, 0.0]), half_extent=1.0, size=SIZE)
    matte = np.full((SIZE, SIZE), 255, np.uint8)
    matte[:, :20] = 0
    bundle = Bundle(views=(View("000", made, matte=matte),), scan=scan, sources={"scan": "own"})
    [view] = draw_masks(bundle).views
    assert view.mask is not None and list(view.parts) == ["top", "bottom"]
    pixel = 2.0 / SIZE  # [m]
    whole, cut, arm = 0.5**2, 0.5 * (0.25 - (SIZE / 2 - 20) * pixel), 0.2**2
    area = view.parts["top"].sum() / 255.0 * pixel**2
    assert area == pytest.approx(whole - cut - arm, abs=4 * 0.5 * EDGE * pixel)
    below = view.parts["bottom"].sum() / 255.0 * pixel**2
    assert below == pytest.approx(0.4**2, abs=4 * 0.4 * EDGE * pixel)
    assert not view.mask[:, :20].any() and view.mask.max() == 255
    both = view.parts["top"].astype(int) + view.parts["bottom"]
    assert np.abs(both - view.mask).max() <= 255 * PIXEL
    rows = np.flatnonzero((view.parts["top"] > 128).any(axis=1))
    assert rows.max() < np.flatnonzero((view.parts["bottom"] > 128).any(axis=1)).min()
    assert (
        bundle_targets(dataclasses.replace(bundle, views=(view,))).observation.parts.shape[-1] == 2
    )


def test_masks_need_a_labelled_mesh_and_views():
    [made] = magicman_cameras(1, center=np.zeros(3), half_extent=1.0, size=SIZE)
    views = (View("a", made),)
    for scan, message in [
        (None, "both"),
        (Surface(np.eye(3), np.zeros((0, 3), int), labels=np.full(3, 3, np.uint8)), "cloud"),
        (Surface(np.eye(3), [[0, 1, 2]]), "no labels"),
        (Surface(np.eye(3), [[0, 1, 2]], labels=np.ones(3, np.uint8)), "shows no clothes"),
    ]:
        with pytest.raises(InputError, match=message):
            draw_masks(Bundle(views=views, scan=scan))


def test_bad_target_folders_are_named(tmp_path):
    target_folder(tmp_path)
    shutil.rmtree(tmp_path / "mask")
    with pytest.raises(InputError, match="normals without masks"):
        read_target_folder(tmp_path)
    shutil.rmtree(tmp_path / "normal")
    [first, *_] = read_target_folder(tmp_path).views
    assert first.mask is None and first.rgb is not None and len(first.parts) == 2
