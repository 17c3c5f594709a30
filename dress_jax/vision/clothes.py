"""A coarse clothes parser: body parts say what may be there, colours decide, a walk smooths.

No learned parser comes with a licence and size that fit, so this one reasons: landmarks give every
pixel its part of the body; face and hands give the colour of the skin; the middle of the trunk and
of the thighs give those of the clothes; the walk (`random_walk`) puts borders where colours change.
One garment or two is decided by how much the colours differ across the waist.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy import ndimage

from dress_jax.capture.labels import ClothesLabel
from dress_jax.capture.landmarks import Landmarks
from dress_jax.core.errors import InputError
from dress_jax.vision.anatomy import (
    Figure,
    Part,
    beside_trunk,
    figure,
    height_along,
    near_bones,
    part_map,
)
from dress_jax.vision.colors import contrast, density, lab, palette, shade_tolerant
from dress_jax.vision.random_walk import random_walk
from dress_jax.vision.resampling import resized
from dress_jax.vision.skin import bare_feet, skin_likeness, skin_tones

WORKING_SIDE = 320
"""Longer side of the person while labels are found [px]."""
ONE_PIECE_CONTRAST = 8.0
"""Contrast across the waist (`colors.contrast`) below which top and bottom are one garment."""
_B, _S, _H = ClothesLabel.BACKGROUND, ClothesLabel.SKIN, ClothesLabel.HAIR
_T, _L, _D, _F = ClothesLabel.TOP, ClothesLabel.BOTTOM, ClothesLabel.DRESS, ClothesLabel.SHOE
LABELS = (_S, _H, _T, _L, _F)
"""What is told apart; a dress is a top and a bottom of one colour."""
# What may be on a part of the body, before any colour is seen: skin, hair, top, bottom, shoe.
_EXPECTED = {
    Part.HEAD: (0.50, 0.48, 0.02, 0.00, 0.00),
    Part.NECK: (0.55, 0.20, 0.25, 0.00, 0.00),
    Part.TORSO: (0.08, 0.02, 0.60, 0.30, 0.00),
    Part.UPPER_ARM: (0.40, 0.01, 0.57, 0.02, 0.00),
    Part.FOREARM: (0.50, 0.00, 0.45, 0.05, 0.00),
    Part.HAND: (0.80, 0.00, 0.14, 0.06, 0.00),
    Part.THIGH: (0.12, 0.00, 0.23, 0.65, 0.00),
    Part.SHIN: (0.35, 0.00, 0.03, 0.55, 0.07),
    Part.FOOT: (0.25, 0.00, 0.00, 0.05, 0.70),
}
_BAREFOOT = (0.95, 0.00, 0.00, 0.05, 0.00)
_OPAQUE = 128
_PALETTE, _SPREAD = 4, 8.0
_FLOOR, _UNSEEN = 0.02, 0.3
_LEAST_SEEDS = 8
_BORDER_SHARE = 0.02
_SKINNY, _BARE = 0.35, 0.85
_WALK = {"spread": 5.0, "strength": 0.02, "seed_strength": 20.0}


@dataclasses.dataclass(frozen=True, eq=False)
class ClothesReport:
    """How far the labels can be trusted.

    Args:
        shares: part of the person's pixels that has each label; they sum to 1.
        certainty: mean probability of the label given, by label; 1 is certain.
        waist_contrast: of the colours above and below the waist; `ONE_PIECE_CONTRAST` decides.
        one_piece: whether top and bottom were taken for one garment.
        waist: its place, 0 at the shoulders and 1 at the hips.
        skin_pixels: from which the skin was learned; 0 where no skin was found in face and hands,
            and then nothing is labelled as skin.
        cut_off: whether the person reaches over the picture's upper or lower border; what lies
            beyond is guessed, and the labels near it with it.
    """

    shares: Mapping[ClothesLabel, float]
    certainty: Mapping[ClothesLabel, float]
    waist_contrast: float
    one_piece: bool
    waist: float
    skin_pixels: int
    cut_off: bool


def parse_clothes(
    image: UInt8[np.ndarray, "h w 3"],
    matte: UInt8[np.ndarray, "h w"],
    landmarks: Landmarks,
    *,
    one_piece: bool | None = None,
) -> tuple[UInt8[np.ndarray, "h w"], ClothesReport]:
    """Labels of the pixels, `ClothesLabel`, and how far they can be trusted.

    Args:
        image: RGB, shape (h, w, 3).
        matte: coverage by the person, 0 to 255, shape (h, w).
        landmarks: of the person.
        one_piece: whether top and bottom are one garment; None leaves it to the colours. Several
            views of one person have to agree.

    Raises:
        InputError: the matte is empty, or neither shoulders nor hips were found.
    """
    mask = matte >= _OPAQUE
    if not mask.any():
        raise InputError("is empty", where="matte", mend="give a picture of one person")
    rows, columns = _extent(mask)
    scale = min(1.0, WORKING_SIDE / max(rows.stop - rows.start, columns.stop - columns.start))
    height, width = mask[rows, columns].shape
    size = max(1, round(scale * height)), max(1, round(scale * width))
    # Colours at the rim of the matte are mixed with the background: they take no part in palettes.
    colors = lab(np.clip(resized(image[rows, columns], size), 0, 255))
    region = resized(mask[rows, columns].astype(np.float32), size) >= 0.5
    corner = np.array([columns.start, rows.start])
    moved = Landmarks(points=landmarks.points - corner, confidence=landmarks.confidence)
    body = figure(moved, scale=size[0] / height)
    if body is None:
        raise InputError(
            "show neither shoulders nor hips well enough",
            where="landmarks",
            mend="give a picture of a whole person, or label maps of your own (--source labels)",
        )
    scene = _scene(colors, region, body)
    waist, waist_contrast = find_waist(scene)
    probabilities = _probabilities(scene, waist)
    if one_piece is None:
        one_piece = waist_contrast < ONE_PIECE_CONTRAST
    found, certain = _decided(probabilities, mask[rows, columns], one_piece=one_piece)
    labels = np.zeros(mask.shape, np.uint8)
    labels[rows, columns] = found
    total = float(mask.sum())
    present = [ClothesLabel(int(k)) for k in np.unique(found[found > 0])]
    report = ClothesReport(
        shares={kind: float((found == kind).sum()) / total for kind in present},
        certainty={kind: float(certain[found == kind].mean()) for kind in present},
        waist_contrast=waist_contrast,
        one_piece=one_piece,
        waist=waist,
        skin_pixels=scene.skin_pixels,
        cut_off=bool(max(mask[0].mean(), mask[-1].mean()) > _BORDER_SHARE),
    )
    return labels, report


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """A person at working size.

    Args:
        colors: L*a*b*, shape (h, w, 3).
        region: the person, shape (h, w).
        body: its lines.
        parts: `Part` of each pixel, shape (h, w).
        gap: distance from the part's line in units of its breadth, shape (h, w).
        height: 0 at the shoulders, 1 at the hips, shape (h, w).
        aside: distance from the trunk's axis as a share of its length, shape (h, w).
        skin: likeness to the person's skin, shape (h, w).
        skin_pixels: from which the skin was learned.
        barefoot: whether the feet are bare.
    """

    colors: Float[np.ndarray, "h w 3"]
    region: Bool[np.ndarray, "h w"]
    body: Figure
    parts: np.ndarray
    gap: Float[np.ndarray, "h w"]
    height: Float[np.ndarray, "h w"]
    aside: Float[np.ndarray, "h w"]
    skin: Float[np.ndarray, "h w"]
    skin_pixels: int
    barefoot: bool


def _scene(
    colors: Float[np.ndarray, "h w 3"], region: Bool[np.ndarray, "h w"], body: Figure
) -> Scene:
    size = region.shape
    centres, shares, count = skin_tones(colors, body, region)
    parts, gap = part_map(body, size)
    skin = skin_likeness(colors, (centres, shares))
    feet, shins = (region & (parts == part) for part in (Part.FOOT, Part.SHIN))
    barefoot = bare_feet(colors, skin, feet, shins)
    if barefoot:
        centres, shares, count = skin_tones(colors, body, region, feet | (shins & (skin > _SKINNY)))
        skin = skin_likeness(colors, (centres, shares))
    return Scene(
        colors=colors,
        region=region,
        body=body,
        parts=parts,
        gap=gap,
        height=height_along(body, size),
        aside=beside_trunk(body, size),
        skin=skin,
        skin_pixels=count,
        barefoot=barefoot,
    )


def find_waist(scene: Scene) -> tuple[float, float]:
    """Where clothes change along the trunk, and the contrast between what is above and below.

    The place is where two narrow bands differ most. The contrast is that of two broad bands a
    little off that place, so that a belt does not make two garments of one.
    """
    inside = scene.region & ((scene.parts == Part.TORSO) | (scene.parts == Part.THIGH))
    inside &= (scene.aside < 0.45) & (scene.skin < _SKINNY)
    colors, height = shade_tolerant(scene.colors[inside]), scene.height[inside]

    def band(low: float, high: float) -> np.ndarray:
        return colors[(height >= low) & (height < high)]

    def differ(place: float, near: float, far: float) -> float:
        above, below = band(place - far, place - near), band(place + near, place + far)
        if min(len(above), len(below)) < 8:
            return 0.0
        return contrast(above, below)

    places = np.arange(0.55, 1.36, 0.05)
    narrow = [differ(place, 0.02, 0.2) for place in places]
    place = float(places[int(np.argmax(narrow))])
    return place, differ(place, 0.1, 0.55)


def _probabilities(scene: Scene, waist: float) -> Float[np.ndarray, "h w k"]:
    """Of every label of `LABELS` at every pixel of the region."""
    priors = _expected(scene, waist)
    seeds = _seeds(scene, waist)
    flat = shade_tolerant(scene.colors).reshape(-1, 3)
    fits = np.full((*scene.region.shape, len(LABELS)), _UNSEEN)
    for index, kind in enumerate(LABELS):
        if kind is _F:
            # Trousers reach over the foot; what looks like them shows no shoe.
            other = seeds[kind] & (fits[..., LABELS.index(_L)] < _SKINNY)
            seeds[kind] = other if other.sum() >= _LEAST_SEEDS else seeds[kind]
        if kind is _S:
            fits[..., index] = scene.skin if scene.skin_pixels else 0.0
        elif seeds[kind].sum() >= _LEAST_SEEDS:
            centres, shares = palette(shade_tolerant(scene.colors[seeds[kind]]), _PALETTE)
            fit = density(flat, centres, shares, spread=_SPREAD)
            fits[..., index] = fit.reshape(scene.region.shape)
    # A garment has colours that its seeds did not show; skin has not.
    bare = 0.2 * _FLOOR if scene.skin_pixels else 0.0
    floor = np.where(np.array(LABELS) == _S, bare, _FLOOR)
    posterior = priors * (fits + floor)
    posterior /= np.maximum(posterior.sum(axis=-1, keepdims=True), 1e-12)
    fixed = np.zeros(scene.region.shape, bool)
    for index, kind in enumerate(LABELS):
        certain = seeds[kind] & ~fixed & (posterior[..., index] > 0.3)
        posterior[certain] = np.eye(len(LABELS))[index]
        fixed |= certain
    walked = random_walk(shade_tolerant(scene.colors), posterior, fixed, scene.region, **_WALK)
    walked /= np.maximum(walked.sum(axis=-1, keepdims=True), 1e-12)
    # At full size the matte's rim reaches beyond the region: there the nearest pixel speaks.
    nearest = np.zeros((2, *scene.region.shape), np.int32)
    ndimage.distance_transform_edt(
        ~scene.region, return_distances=False, return_indices=True, indices=nearest
    )
    return walked[tuple(nearest)]


def _expected(scene: Scene, waist: float) -> Float[np.ndarray, "h w k"]:
    """What may be at a pixel by its part of the body and its height."""
    table = np.array([_EXPECTED[part] for part in Part])
    if scene.barefoot:
        table[Part.FOOT] = _BAREFOOT
    priors = table[scene.parts]
    index = {kind: i for i, kind in enumerate(LABELS)}
    # The top ends and the bottom begins at the waist.
    trunk = (scene.parts == Part.TORSO) | (scene.parts == Part.THIGH)
    below = 1.0 / (1.0 + np.exp(-np.clip((scene.height - waist) / 0.035, -50.0, 50.0)))
    both = priors[..., index[_T]] + priors[..., index[_L]]
    priors[..., index[_L]] = np.where(trunk, both * (0.02 + 0.96 * below), priors[..., index[_L]])
    priors[..., index[_T]] = np.where(trunk, both * (0.98 - 0.96 * below), priors[..., index[_T]])
    # Long hair hangs down: less likely the farther from the head.
    rows, columns = np.mgrid[: scene.region.shape[0], : scene.region.shape[1]]
    away = np.hypot(columns - scene.body.face[0], rows - scene.body.face[1]) / scene.body.torso
    hair = 0.25 * np.exp(-0.5 * (away / 0.45) ** 2)
    outside = scene.parts != Part.HEAD
    priors[..., index[_H]] = np.where(outside, hair, priors[..., index[_H]])
    return priors / priors.sum(axis=-1, keepdims=True)


def _seeds(scene: Scene, waist: float) -> dict[ClothesLabel, Bool[np.ndarray, "h w"]]:
    """Pixels that show a label's colours: the middle of the parts that it covers."""
    size = scene.region.shape
    rows, columns = np.mgrid[: size[0], : size[1]]
    body = scene.body
    face = np.hypot(columns - body.face[0], rows - body.face[1]) <= body.face_radius
    head = (scene.parts == Part.HEAD) & scene.region
    arms = np.isin(scene.parts, [Part.UPPER_ARM, Part.FOREARM, Part.HAND])
    middle = scene.region & ~arms & (scene.aside < 0.3)
    torso = middle & (scene.height > 0.3) & (scene.height < waist - 0.08)
    thighs = near_bones(body, Part.THIGH, size, share=0.6) & scene.region & ~arms
    thighs &= (scene.height > waist + 0.08) & (scene.height < waist + 0.7)
    torso, thighs = _without_skin(torso, scene.skin), _without_skin(thighs, scene.skin)
    above_eyes = (rows - body.face[1]) * (body.shoulders[1] - body.face[1]) < 0.0
    hair = head & above_eyes & ~face & (scene.skin < 0.1) & (scene.gap > 0.5)
    feet = near_bones(body, Part.FOOT, size, share=0.6) & scene.region
    return {
        _S: (face | near_bones(body, Part.HAND, size, share=0.4))
        & scene.region
        & (scene.skin > _SKINNY),
        _H: hair,
        _T: torso,
        _L: thighs,
        _F: feet & ~np.bool_(scene.barefoot) & (scene.skin < _SKINNY) & (scene.parts == Part.FOOT),
    }


def _without_skin(
    place: Bool[np.ndarray, "h w"], skin: Float[np.ndarray, "h w"]
) -> Bool[np.ndarray, "h w"]:
    """The pixels of a garment: those unlike skin, unless nearly all are alike (a nude colour)."""
    if not place.any() or (skin[place] > _SKINNY).mean() > _BARE:
        return place
    return place & (skin < _SKINNY)


def _decided(
    probabilities: Float[np.ndarray, "h w k"], mask: Bool[np.ndarray, "H W"], *, one_piece: bool
) -> tuple[UInt8[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """Labels at full size, and the probability of each."""
    large = resized(probabilities, mask.shape)
    kinds: list[ClothesLabel] = list(LABELS)
    if one_piece:
        top, bottom = kinds.index(_T), kinds.index(_L)
        large[..., top] += large[..., bottom]
        large[..., bottom] = 0.0
        kinds[top] = _D
    choice = large.argmax(axis=-1)
    labels = np.where(mask, np.array(kinds, np.uint8)[choice], np.uint8(_B))
    return labels, large.max(axis=-1)


def _extent(mask: Bool[np.ndarray, "h w"]) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
