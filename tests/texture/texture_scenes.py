"""A garment that can be unrolled: a wavy tube of two panels around a thin body, exact to first
order of the mesh, so that what is on the panels is known everywhere."""

import numpy as np

from dress_jax.render.rings import ring_cameras
from dress_jax.texture.panel_maps import PanelMap
from dress_jax.texture.surface import make_panel_surface

HEIGHT = 0.6
COLUMNS, ROWS = 60, 24  # cells of each panel
SIZE, HALF_EXTENT = 192, 0.4
PIXEL = 2.0 * HALF_EXTENT / SIZE
TEXEL = 0.003
PERIOD = (0.05, 0.04)  # of the checks, across and along the grain [m]


def tube_arrays(waves=0.04):
    """Arrays of `make_panel_surface`; panel x is arc length from the seam at the wearer's right
    (front) or left (back), panel y is height."""
    steps = 2 * COLUMNS
    angle = np.pi - 2.0 * np.pi * np.arange(steps + 1) / steps  # from -x over +z to +x and back
    radius = 0.2 * (1.0 + waves * np.cos(5.0 * angle))
    ring = np.stack([radius * np.cos(angle), np.zeros(steps + 1), radius * np.sin(angle)], axis=1)
    length = np.concatenate([[0.0], np.linalg.norm(np.diff(ring, axis=0), axis=1).cumsum()])
    height = np.linspace(-0.5 * HEIGHT, 0.5 * HEIGHT, ROWS + 1)
    vertices = np.concatenate([ring[:-1] + np.array([0.0, y, 0.0]) for y in height])
    rest, rest_faces, faces, face_panels = [], [], [], []
    for panel in range(2):
        start = panel * COLUMNS
        first = sum(len(r) for r in rest)
        across = length[start : start + COLUMNS + 1] - length[start]
        x, y = np.meshgrid(across, height - height[0])
        rest.append(np.stack([x.ravel(), y.ravel()], axis=1))
        for row in range(ROWS):
            for column in range(COLUMNS):
                a = row * (COLUMNS + 1) + column
                corners = [a, a + 1, a + COLUMNS + 2, a + COLUMNS + 1]
                around = [(start + column) % steps, (start + column + 1) % steps]
                welded = [
                    row * steps + around[0],
                    row * steps + around[1],
                    (row + 1) * steps + around[1],
                    (row + 1) * steps + around[0],
                ]
                for pick in ((0, 1, 2), (0, 2, 3)):
                    rest_faces.append([first + corners[k] for k in pick])
                    faces.append([welded[k] for k in pick])
                    face_panels.append(panel)
    return (
        vertices,
        np.array(faces),
        np.concatenate(rest),
        np.array(rest_faces),
        ("front", "back"),
        np.array(face_panels),
    )


def tube(waves=0.04):
    """The tube as a `PanelSurface`."""
    return make_panel_surface(*tube_arrays(waves))


def body(radius=0.08, height=0.9):
    """A closed prism inside the tube."""
    count = 12
    angle = 2.0 * np.pi * np.arange(count) / count
    ring = np.stack([radius * np.cos(angle), np.zeros(count), radius * np.sin(angle)], axis=1)
    up = np.array([0.0, 0.5 * height, 0.0])
    vertices = np.concatenate([ring - up, ring + up])
    faces = []
    for k in range(count):
        following = (k + 1) % count
        faces += [(k, k + count, following), (following, k + count, following + count)]
    for k in range(1, count - 1):
        faces += [(0, k, k + 1), (count, count + k + 1, count + k)]
    return vertices, np.array(faces)


def cameras(count=8, size=SIZE):
    """A ring of orthographic cameras."""
    azimuths = [360.0 * k / count for k in range(count)]
    return ring_cameras(azimuths, size=size, center=np.zeros(3), half_extent=HALF_EXTENT)


def stripes(shape, texel, period, axis):
    """Soft stripes of two colours across an axis of an image: 1 changes along the columns."""
    at = texel * (0.5 + np.arange(shape[axis]))
    wave = 0.5 + 0.5 * np.tanh(6.0 * np.sin(2.0 * np.pi * at / period)) / np.tanh(6.0)
    wave = wave[None, :] if axis == 1 else wave[:, None]
    wave = np.broadcast_to(wave, shape)[..., None]
    return wave * np.array([0.85, 0.80, 0.70]) + (1.0 - wave) * np.array([0.15, 0.25, 0.45])


def checks(shape, texel, period):
    """Stripes both ways; `period` is (along columns, along rows) [m]."""
    across = stripes(shape, texel, period[0], 1)
    return 0.5 * (across + stripes(shape, texel, period[1], 0))


def flat_map(coordinates, cosine, spacing):
    """One flat panel as a camera sees it: panel coordinates [m] of every pixel are given."""
    shape = coordinates.shape[:2]
    return PanelMap(
        panel=np.zeros(shape, np.int64),
        coordinates=coordinates,
        cosine=np.full(shape, cosine),
        side=np.ones(shape),
        spacing=np.full(shape, spacing),
    )
