"""A drawn person whose regions and landmarks are known."""

import numpy as np

from dress_jax.capture import ClothesLabel, Landmarks
from dress_jax.capture.landmarks import COUNT

HEIGHT, WIDTH = 480, 320
SKIN, HAIR, SHOE = (224, 172, 140), (50, 35, 30), (35, 35, 40)
TOP, BOTTOM = (60, 90, 170), (120, 120, 60)
BACKGROUND = (205, 210, 215)
# fmt: off
POINTS = {
    0: (160, 72), 1: (168, 63), 2: (152, 63), 3: (178, 68), 4: (142, 68),
    5: (195, 120), 6: (125, 120), 7: (222, 182), 8: (98, 182), 9: (240, 238), 10: (80, 238),
    11: (180, 245), 12: (140, 245), 13: (184, 335), 14: (136, 335), 15: (188, 420), 16: (132, 420),
    17: (198, 440), 19: (186, 436), 20: (122, 440), 22: (134, 436),
}
"""Column and row of the landmarks in COCO-WholeBody's order; the person faces us."""
# fmt: on


def mannequin(*, top=TOP, bottom=BOTTOM, sleeve=1.0, hem=1.0, shoe=SHOE, seed=0):
    """Image, mask, labels and landmarks.

    Args:
        top, bottom, shoe: colours; the shoes are bare feet where `shoe` is None.
        sleeve: how much of the upper arm is covered.
        hem: how much of the shin is covered.
        seed: of the noise on every colour.
    """
    labels = np.zeros((HEIGHT, WIDTH), np.uint8)
    colors = np.empty((HEIGHT, WIDTH, 3))
    colors[:] = BACKGROUND

    def paint(mask, label, color):
        labels[mask], colors[mask] = label, color

    def limb(start, end, radius, share=1.0):
        start, end = np.array(start, float), np.array(end, float)
        return _capsule(start, start + share * (end - start), radius)

    skin = (ClothesLabel.SKIN, SKIN)
    for a, b, c in ((5, 7, 9), (6, 8, 10)):
        paint(limb(POINTS[a], POINTS[b], 13), *skin)
        paint(limb(POINTS[b], POINTS[c], 10), *skin)
        paint(limb(POINTS[c], 2 * np.array(POINTS[c]) - POINTS[b], 11, 0.4), *skin)
    for hip, knee, ankle, toe in ((11, 13, 15, 17), (12, 14, 16, 20)):
        paint(limb(POINTS[knee], POINTS[ankle], 15), *skin)
        foot = skin if shoe is None else (ClothesLabel.SHOE, shoe)
        paint(limb(POINTS[ankle], POINTS[toe], 13), *foot)
        paint(limb(POINTS[hip], POINTS[knee], 24), ClothesLabel.BOTTOM, bottom)
        if hem > 0.0:
            paint(limb(POINTS[knee], POINTS[ankle], 19, hem), ClothesLabel.BOTTOM, bottom)
    paint(_capsule(np.array([160.0, 85.0]), np.array([160.0, 115.0]), 14), *skin)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    half = 42.0 - 6.0 * np.sin(np.pi * np.clip((rows - 112) / 140.0, 0.0, 1.0))
    trunk = (np.abs(columns - 160) <= half) & (rows >= 112) & (rows < 252)
    paint(trunk & (rows >= 235), ClothesLabel.BOTTOM, bottom)
    paint(trunk & (rows < 235), ClothesLabel.TOP, top)
    for a, b in ((5, 7), (6, 8)):
        paint(limb(POINTS[a], POINTS[b], 16, sleeve), ClothesLabel.TOP, top)
    paint(((columns - 160) / 27.0) ** 2 + ((rows - 58) / 36.0) ** 2 < 1.0, ClothesLabel.HAIR, HAIR)
    paint(((columns - 160) / 21.0) ** 2 + ((rows - 70) / 27.0) ** 2 < 1.0, *skin)
    for x, y, r in ((168, 63, 2.5), (152, 63, 2.5)):
        colors[np.hypot(columns - x, rows - y) < r] = (40, 30, 30)
    colors += np.random.default_rng(seed).normal(size=colors.shape) * 3.0
    image = np.round(np.clip(colors, 0, 255)).astype(np.uint8)
    return image, labels != ClothesLabel.BACKGROUND, labels, landmarks()


def landmarks():
    points, confidence = np.zeros((COUNT, 2)), np.zeros(COUNT)
    for index, place in POINTS.items():
        points[index], confidence[index] = place, 0.9
    return Landmarks(points=points, confidence=confidence)


def _capsule(start, end, radius):
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    pixels = np.stack([columns, rows], axis=-1).astype(float)
    along = end - start
    share = np.clip((pixels - start) @ along / max(along @ along, 1e-9), 0.0, 1.0)
    return np.linalg.norm(pixels - start - share[..., None] * along, axis=-1) <= radius
