"""The clothes parser on drawn people, whose regions are known."""

import dataclasses

import numpy as np
import pytest
from mannequin import SKIN, TOP, mannequin

from dress_jax.capture import ClothesLabel, Landmarks
from dress_jax.core.errors import InputError
from dress_jax.vision.clothes import ONE_PIECE_CONTRAST, parse_clothes
from dress_jax.vision.colors import contrast, lab, palette, shade_tolerant
from dress_jax.vision.random_walk import random_walk
from dress_jax.vision.skin import may_be_skin

LEAST_IOU = 0.9


def parse(image, mask, landmarks):
    return parse_clothes(image, 255 * mask.astype(np.uint8), landmarks)


def iou(first, second):
    return (first & second).sum() / (first | second).sum()


@pytest.mark.parametrize(
    "drawn",
    [
        {},
        {"sleeve": 0.6, "hem": 0.0},
        {"hem": 0.4, "shoe": None},
        {"top": (215, 60, 60), "bottom": (235, 235, 235)},
    ],
)
def test_regions_of_a_mannequin_are_found(drawn):
    image, mask, truth, landmarks = mannequin(**drawn)
    labels, report = parse(image, mask, landmarks)
    for kind in np.unique(truth):
        assert iou(labels == kind, truth == kind) > LEAST_IOU, ClothesLabel(kind)
    assert ClothesLabel.SHOE in report.shares or drawn.get("shoe", 0) is None
    assert not report.one_piece and not report.cut_off
    assert sum(report.shares.values()) == pytest.approx(1.0)
    assert all(0.5 < value <= 1.0 for value in report.certainty.values())


def test_one_colour_across_the_waist_is_one_piece():
    image, mask, truth, landmarks = mannequin(bottom=TOP, hem=0.0)
    labels, report = parse(image, mask, landmarks)
    clothes = np.isin(truth, [ClothesLabel.TOP, ClothesLabel.BOTTOM])
    assert report.one_piece and report.waist_contrast < 0.5 * ONE_PIECE_CONTRAST
    assert iou(labels == ClothesLabel.DRESS, clothes) > LEAST_IOU
    assert not np.isin(labels, [ClothesLabel.TOP, ClothesLabel.BOTTOM]).any()


def test_labels_move_with_the_person():
    image, mask, _, landmarks = mannequin()
    labels, _ = parse(image, mask, landmarks)
    wide = ((30, 17), (11, 40))
    moved, _ = parse(
        np.pad(image, (*wide, (0, 0)), mode="edge"),
        np.pad(mask, wide),
        dataclasses.replace(landmarks, points=landmarks.points + np.array([11, 30])),
    )
    np.testing.assert_array_equal(moved[30:-17, 11:-40], labels)


def test_a_person_over_the_border_is_reported():
    image, mask, _, landmarks = mannequin()
    cut = np.s_[:300]
    confidence = np.where(landmarks.points[:, 1] < 300, landmarks.confidence, 0.0)
    seen = Landmarks(points=landmarks.points, confidence=confidence)
    _, report = parse(image[cut], mask[cut], seen)
    assert report.cut_off


def test_without_trunk_or_matte_there_are_no_labels():
    image, mask, _, landmarks = mannequin()
    nothing = Landmarks(points=landmarks.points, confidence=np.zeros(133))
    with pytest.raises(InputError, match="shoulders nor hips"):
        parse(image, mask, nothing)
    with pytest.raises(InputError, match="matte: is empty"):
        parse(image, np.zeros_like(mask), landmarks)


def test_gloves_and_mask_leave_no_skin():
    image, mask, truth, landmarks = mannequin()
    image[truth == ClothesLabel.SKIN] = (20, 160, 60)
    labels, report = parse(image, mask, landmarks)
    assert report.skin_pixels == 0
    assert not (labels == ClothesLabel.SKIN).any()


def test_lab_has_its_known_values():
    """White, black, and pure red (Lindbloom's sRGB under D65: 53.24, 80.09, 67.20)."""
    found = lab(np.array([[255, 255, 255], [0, 0, 0], [255, 0, 0]], np.uint8))
    np.testing.assert_allclose(found[0], [100, 0, 0], atol=0.02)
    np.testing.assert_allclose(found[1], [0, 0, 0], atol=0.02)
    np.testing.assert_allclose(found[2], [53.24, 80.09, 67.20], atol=0.05)


def test_contrast_is_zero_for_equal_palettes_and_the_distance_of_plain_colours():
    generator = np.random.default_rng(0)
    mixed = generator.normal(size=(600, 3)) * 20.0
    assert contrast(mixed[::2], mixed[1::2]) < 3.0
    assert contrast(np.zeros((50, 3)), np.full((50, 3), [3.0, 4.0, 0.0])) == pytest.approx(5.0)


def test_a_palette_finds_separate_colours():
    colors = np.repeat([[0.0, 0.0, 0.0], [40.0, 0.0, 0.0], [0.0, 60.0, 0.0]], [50, 30, 20], axis=0)
    centres, shares = palette(colors, 3)
    np.testing.assert_allclose(sorted(shares), [0.2, 0.3, 0.5])
    assert {tuple(c) for c in centres.round(6)} == {tuple(c) for c in np.unique(colors, axis=0)}


@pytest.mark.parametrize("tone", [SKIN, (245, 215, 195), (141, 85, 54), (80, 50, 38)])
def test_skin_of_every_tone_may_be_skin(tone):
    assert may_be_skin(lab(np.array(tone, np.uint8)))


@pytest.mark.parametrize("color", [(60, 90, 170), (30, 150, 60), (128, 128, 128), (230, 20, 20)])
def test_other_colours_may_not(color):
    assert not may_be_skin(lab(np.array(color, np.uint8)))


def test_a_walk_solves_its_equations_and_stops_at_edges():
    colors = np.zeros((6, 8, 3))
    colors[:, 4:] = 50.0
    priors = np.full((6, 8, 2), 0.5)
    seeds = np.zeros((6, 8), bool)
    seeds[3, 0], priors[3, 0] = True, [1.0, 0.0]
    seeds[2, 7], priors[2, 7] = True, [0.0, 1.0]
    region = np.ones((6, 8), bool)
    region[0, 0] = False
    found = random_walk(
        shade_tolerant(colors),
        priors,
        seeds,
        region,
        spread=5.0,
        strength=1e-4,
        seed_strength=10.0,
    )
    np.testing.assert_allclose(found[region].sum(axis=-1), 1.0, atol=1e-9)
    assert (found[0, 0] == 0.0).all()
    assert (found[..., 0][region & (np.arange(8) < 4)] > 0.9).all()
    assert (found[:, 4:, 1] > 0.9).all()
