"""The container: what it refuses, and how bundles are put together."""

import dataclasses

import jax
import numpy as np
import pytest
from capture_scenes import SIZE, body, camera, full_bundle, labels, landmarks

from dress_jax.capture import Bundle, Landmarks, Surface, View, merge_bundles
from dress_jax.capture.body import to_axis_angle
from dress_jax.capture.surfaces import split_clothes
from dress_jax.capture.views import (
    largest_region,
    matte_from_normals,
    matte_from_white,
    unit_normals,
    with_labels,
)
from dress_jax.core.errors import InputError

RNG = np.random.default_rng(0)
PICTURE = np.zeros((SIZE, SIZE), np.uint8)
POINTS = np.zeros((133, 2))


def test_an_empty_bundle_is_refused_and_one_part_is_enough():
    with pytest.raises(InputError, match="holds nothing"):
        Bundle()
    assert Bundle(labels=labels()).present == ("labels",)
    assert full_bundle().present == (
        *("image", "matte", "labels", "landmarks", "body", "body_mesh", "scan", "views", "pattern"),
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Bundle(image=PICTURE), r"image: is uint8 of shape \(48, 48\)"),
        (lambda: Bundle(matte=PICTURE / 255.0), "matte: is float64"),
        (lambda: Bundle(labels=PICTURE + 8), "labels: 8 is no label"),
        (lambda: Bundle(matte=PICTURE, labels=PICTURE[:, 1:]), "labels: is 47x48, the matte"),
        (lambda: Bundle(labels=labels(), sources={"views": "x"}), "'views', which is absent"),
        (lambda: Bundle(landmarks=POINTS), "landmarks: is a ndarray"),
        (lambda: Landmarks(POINTS[1:], np.zeros(133)), r"points: has shape \(132, 2\)"),
        (lambda: Landmarks(POINTS + np.inf, np.zeros(133)), "points: .*not finite"),
        (lambda: Landmarks(POINTS, np.full(133, -1.0)), "landmark 0 has confidence -1"),
        (
            lambda: Bundle(matte=PICTURE, landmarks=Landmarks(POINTS + 99, np.ones(133))),
            "none lies in the matte of 48x48",
        ),
        (lambda: body(RNG, scale=0.0), "body, scale: is 0"),
        (lambda: body(RNG, jaw_pose=np.zeros(4)), r"body, jaw_pose: has shape \(4,\)"),
        (lambda: body(RNG, to_world=np.diag([1.0, 1.0, -1.0])), "to_world: is no rotation"),
        (lambda: Surface(np.zeros((2, 3)), [[0, 1, 2]]), "faces: an index is not in 0 to 1"),
        (lambda: Surface(np.zeros((0, 3)), np.zeros((0, 3))), "no vertex"),
        (
            lambda: Surface(np.eye(3), [[0, 1, 2]], labels=np.full(3, 9, np.uint8)),
            "labels: 9 is no label",
        ),
        (lambda: View("a/b", camera()), "the name 'a/b'"),
        (lambda: View("a", camera(), mask=PICTURE[1:]), "view 'a', mask: is 48x47, its camera"),
        (lambda: View("a", camera(), normal=np.ones((SIZE, SIZE, 3))), "neither unit nor zero"),
        (lambda: View("a", _stacked()), "a stack of cameras"),
        (lambda: Bundle(views=(View("a", camera()),) * 2), "two are named 'a'"),
        (lambda: to_axis_angle(np.zeros(7), 1, where="x"), "x: holds 7 numbers for 1 joint"),
        (lambda: to_axis_angle(np.zeros(6), 1, where="x"), "span no plane"),
        (lambda: to_axis_angle(-np.eye(3), 1, where="x"), "is no rotation"),
    ],
)
def test_a_malformed_part_is_named(make, message):
    with pytest.raises(InputError, match=message):
        make()


def _stacked():
    return jax.tree.map(lambda leaf: leaf[None], camera())


def test_bundles_are_merged_by_parts():
    first = Bundle(labels=labels(), sources={"labels": "one"})
    second = Bundle(matte=PICTURE, labels=PICTURE, sources={"matte": "two"})
    with pytest.raises(InputError, match="there is labels already"):
        merge_bundles(first, second)
    merged = merge_bundles(first, second, replace=True)
    assert merged.labels is PICTURE and merged.sources == {"matte": "two"}
    added = merge_bundles(first, Bundle(landmarks=landmarks(RNG)))
    assert added.present == ("labels", "landmarks") and added.sources == {"labels": "one"}
    with pytest.raises(InputError, match="of 48x48 pixels"):
        merge_bundles(first, Bundle(landmarks=Landmarks(POINTS + 99, np.ones(133))))


def test_label_maps_give_a_view_its_masks():
    found = with_labels(View("a", camera()), labels())
    assert list(found.parts) == ["dress"]
    assert found.mask is not None and found.hidden is not None and found.matte is not None
    assert found.mask[15, 10] == 255 and found.mask[15, 37] == 0  # not its mirror image
    assert found.hidden[5, 9] == 255 and found.hidden[15, 10] == 0
    assert found.matte[25, 33] == 255 and found.matte[0, 0] == 0
    kept = with_labels(dataclasses.replace(found, matte=PICTURE), labels())
    assert kept.matte is PICTURE


def test_mattes_are_the_largest_region():
    chosen = np.zeros((9, 9), bool)
    chosen[1:5, 1:4] = chosen[5, 4] = True  # touches by a corner
    chosen[8, 8] = True
    matte = largest_region(chosen)
    assert matte.sum() == 255 * 13 and matte[5, 4] == 255 and matte[8, 8] == 0
    assert not largest_region(np.zeros((3, 3), bool)).any()
    rgb = np.full((9, 9, 3), 252, np.uint8)
    rgb[chosen] = (255, 255, 30)
    assert (matte_from_white(rgb) == matte).all()


@pytest.mark.parametrize("background", [(1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (-1.0, -1.0, -1.0)])
def test_normals_tell_the_person_from_any_plain_background(background):
    encoded = np.full((12, 12, 3), background)
    encoded[2:9, 3:6] = (0.0, 0.55, 0.55)  # short, as networks draw them
    matte = matte_from_normals(encoded)
    assert matte.sum() == 255 * 21 and matte[2, 3] == 255
    normal = unit_normals(encoded, matte)
    np.testing.assert_allclose(normal[4, 4], [0.0, 0.5**0.5, 0.5**0.5], atol=1e-6)
    assert not normal[0].any()


def test_clothes_are_cut_out_of_a_scan():
    vertices = np.arange(15.0).reshape(5, 3)
    kinds = np.array([3, 3, 1, 1, 5], np.uint8)
    scan = Surface(vertices, [[0, 1, 2], [1, 2, 3], [0, 3, 4]], labels=kinds)
    clothes, rest = split_clothes(scan)
    assert clothes is not None and rest is not None and clothes.labels is not None
    np.testing.assert_array_equal(clothes.vertices, vertices)  # triangles 0 and 2
    np.testing.assert_array_equal(clothes.faces, [[0, 1, 2], [0, 3, 4]])
    np.testing.assert_array_equal(rest.vertices, vertices[1:4])
    cloud, skin = split_clothes(dataclasses.replace(scan, faces=np.zeros((0, 3), int)))
    assert cloud is not None and skin is not None
    assert len(cloud.vertices) == 3 and len(skin.vertices) == 2
    with pytest.raises(InputError, match="no labels"):
        split_clothes(dataclasses.replace(scan, labels=None))
