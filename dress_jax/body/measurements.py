"""Tape measures of a body in T pose: height and girths."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull

# Search ranges as fractions of the height, wide enough for any adult.
BUST_RANGE = (0.68, 0.76)
WAIST_RANGE = (0.58, 0.68)
HIPS_RANGE = (0.46, 0.56)
LEVELS = 25


@dataclasses.dataclass(frozen=True)
class Measurements:
    """Sizes [m]; the levels are heights above the floor where the girths were taken."""

    height: float
    bust: float
    waist: float
    hips: float
    bust_level: float
    waist_level: float
    hips_level: float


def measure(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    *,
    half_width: float,
) -> Measurements:
    """Height, fullest bust, narrowest waist and fullest hips of a body in T pose.

    A girth is the perimeter of the convex hull of a level section, as a tape would lie.

    Args:
        vertices: body in T pose [m], shape (n, 3).
        faces: triangles, shape (f, 3).
        half_width: distance of the shoulder joints from the middle plane [m]; sections are cut
            there so that the arms stay out.

    Raises:
        ValueError: a section is empty.
    """
    floor = float(vertices[:, 1].min())
    height = float(np.ptp(vertices[:, 1]))

    def girths(span: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        levels = floor + height * np.linspace(*span, LEVELS)
        return levels, np.array(
            [section_girth(vertices, faces, level, half_width=half_width) for level in levels]
        )

    bust_levels, busts = girths(BUST_RANGE)
    waist_levels, waists = girths(WAIST_RANGE)
    hips_levels, hips = girths(HIPS_RANGE)
    return Measurements(
        height=height,
        bust=float(busts.max()),
        waist=float(waists.min()),
        hips=float(hips.max()),
        bust_level=float(bust_levels[busts.argmax()] - floor),
        waist_level=float(waist_levels[waists.argmin()] - floor),
        hips_level=float(hips_levels[hips.argmax()] - floor),
    )


def section_girth(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    level: float,
    *,
    half_width: float = np.inf,
) -> float:
    """Perimeter [m] of the convex hull of the section at y = `level`, within |x| <= `half_width`.

    Raises:
        ValueError: the plane misses the body.
    """
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    start, end = vertices[edges[:, 0]], vertices[edges[:, 1]]
    crossing = (start[:, 1] - level) * (end[:, 1] - level) < 0.0
    start, end = start[crossing], end[crossing]
    share = (level - start[:, 1]) / (end[:, 1] - start[:, 1])
    points = (start + share[:, None] * (end - start))[:, [0, 2]]
    points = points[np.abs(points[:, 0]) <= half_width]
    if len(points) < 3:
        raise ValueError(f"the level {level:.3f} m does not cut the body")
    return float(ConvexHull(points).area)  # of a plane hull, `area` is the perimeter
