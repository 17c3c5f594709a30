"""The colour of a person's skin, learned from the face and hands in the picture."""

import numpy as np
from jaxtyping import Bool, Float

from dress_jax.vision.anatomy import Figure, Part, distance_to
from dress_jax.vision.colors import contrast, density, palette, shade_tolerant

# Skin of every tone has a hue between red and yellow (L*a*b* angle [degrees]); only its lightness
# and strength vary much.
HUE = (15.0, 80.0)
CHROMA = (6.0, 55.0)
LIGHTNESS = (8.0, 97.0)
SPREAD = 7.0
"""Tolerance around the learned colours, in the units of `shade_tolerant`."""
_LEAST_PIXELS = 12
_LEAST_SHARE = 0.3
_TONES = 3
_SHIN_LIKENESS, _BARE_SHINS, _BARE_FEET = 0.2, 0.3, 0.7
BARE_CONTRAST = 10.0
"""Contrast of feet and bare shins (`colors.contrast`) below which there are no shoes."""


def may_be_skin(colors: Float[np.ndarray, "*shape 3"]) -> Bool[np.ndarray, "*shape"]:
    """Whether L*a*b* colours lie in the range of skin at all."""
    lightness, a, b = np.moveaxis(colors, -1, 0)
    hue, chroma = np.degrees(np.arctan2(b, a)), np.hypot(a, b)
    return (
        (hue > HUE[0])
        & (hue < HUE[1])
        & (chroma > CHROMA[0])
        & (chroma < CHROMA[1])
        & (lightness > LIGHTNESS[0])
        & (lightness < LIGHTNESS[1])
    )


def skin_tones(
    colors: Float[np.ndarray, "h w 3"],
    body: Figure,
    region: Bool[np.ndarray, "h w"],
    more: Bool[np.ndarray, "h w"] | None = None,
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, " k"], int]:
    """Palette of the skin, and from how many pixels it was learned.

    Face and hands are asked in turn; a face that is mostly no skin is one seen from behind.

    Args:
        colors: L*a*b*, shape (h, w, 3).
        body: its lines.
        region: the person.
        more: pixels that are known to be skin as well.

    Returns:
        Colours (`shade_tolerant`), their shares, and the number of pixels; empty where neither
        face nor hands show skin.
    """
    rows, columns = np.mgrid[: region.shape[0], : region.shape[1]]
    pixels = np.stack([columns, rows], axis=-1).astype(np.float64)
    places = [np.linalg.norm(pixels - body.face, axis=-1) <= body.face_radius]
    hands = [bone for bone in body.bones if bone.part is Part.HAND]
    places += [distance_to(bone, pixels) <= 0.07 * body.torso for bone in hands]
    found = []
    for place in places:
        sample = colors[place & region]
        fits = may_be_skin(sample)
        if len(sample) and fits.mean() >= _LEAST_SHARE:
            found.append(sample[fits])
    if more is not None and found:
        found.append(colors[more & region])
    learned = np.concatenate(found) if found else np.zeros((0, 3))
    if len(learned) < _LEAST_PIXELS:
        return np.zeros((0, 3)), np.zeros(0), 0
    centres, shares = palette(shade_tolerant(learned), _TONES)
    return centres, shares, len(learned)


def bare_feet(
    colors: Float[np.ndarray, "h w 3"],
    skin: Float[np.ndarray, "h w"],
    feet: Bool[np.ndarray, "h w"],
    shins: Bool[np.ndarray, "h w"],
) -> bool:
    """Whether the feet continue bare shins: light from above leaves them darker than the face.

    Args:
        colors: L*a*b*, shape (h, w, 3).
        skin: `skin_likeness` of the pixels.
        feet, shins: their pixels.
    """
    if min(feet.sum(), shins.sum()) < _LEAST_PIXELS:
        return False
    bare = shins & (skin > _SHIN_LIKENESS)  # a hem may hide the rest
    if bare.sum() < _BARE_SHINS * shins.sum() or may_be_skin(colors[feet]).mean() < _BARE_FEET:
        return False
    return contrast(shade_tolerant(colors[feet]), shade_tolerant(colors[bare])) < BARE_CONTRAST


def skin_likeness(
    colors: Float[np.ndarray, "h w 3"],
    tones: tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]],
) -> Float[np.ndarray, "h w"]:
    """How well L*a*b* colours fit the person's skin, 0 to 1."""
    centres, shares = tones
    if len(centres) == 0:
        return np.zeros(colors.shape[:2])
    flat = shade_tolerant(colors).reshape(-1, 3)
    fit = density(flat, centres, shares, spread=SPREAD).reshape(colors.shape[:2])
    return np.clip(np.where(may_be_skin(colors), fit, 0.2 * fit), 0.0, 1.0)
