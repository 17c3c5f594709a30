"""A small body and a small skirt for it: everything that the commands need, in seconds."""

import numpy as np

from dress_jax.pattern.templates import Measurements, straight_skirt

AROUND, LEVELS = 20, 13
HEIGHT = 1.6
# Radii of a body without limbs, from the floor up: legs, hips, waist, chest, neck, head [m].
PROFILE_HEIGHTS = (0.0, 0.45, 0.80, 1.00, 1.20, 1.40, 1.60)
PROFILE_RADII = (0.10, 0.12, 0.15, 0.115, 0.14, 0.06, 0.07)

MEASUREMENTS = Measurements(
    waist=2 * np.pi * 0.125,
    hips=2 * np.pi * 0.165,
    waist_height=1.0,
    hips_height=0.8,
    knee_height=0.6,
)


def turned_body():
    """A closed surface of revolution: vertices [m] and faces, outward."""
    heights = np.linspace(0.0, HEIGHT, LEVELS)
    radii = np.interp(heights, PROFILE_HEIGHTS, PROFILE_RADII)
    angles = 2.0 * np.pi * np.arange(AROUND) / AROUND
    rings = [
        np.stack([r * np.cos(angles), np.full(AROUND, y), r * np.sin(angles)], axis=1)
        for y, r in zip(heights, radii, strict=True)
    ]
    vertices = np.concatenate([*rings, [[0.0, 0.0, 0.0], [0.0, HEIGHT, 0.0]]])
    faces = []
    for level in range(LEVELS - 1):
        for k in range(AROUND):
            a, b = level * AROUND + k, level * AROUND + (k + 1) % AROUND
            c, d = a + AROUND, b + AROUND
            faces += [(a, c, b), (b, c, d)]
    bottom, top = len(vertices) - 2, len(vertices) - 1
    for k in range(AROUND):
        following = (k + 1) % AROUND
        faces.append((bottom, k, following))
        last = (LEVELS - 1) * AROUND
        faces.append((top, last + following, last + k))
    return vertices, np.array(faces)


def small_skirt():
    """Two panels, side seams."""
    return straight_skirt(MEASUREMENTS, ease=0.06)
