"""Draw a pattern as an SVG picture: one unit is one centimetre of cloth."""

import colorsys
import math
from html import escape

import numpy as np
import shapely
from jaxtyping import Float

from dress_jax.geometry.polygons import signed_area
from dress_jax.pattern.model import Panel, Pattern
from dress_jax.pattern.outline import edge_points, fine_count, fine_outline

_GAP = 8.0  # between panels [cm]
_MARGIN = 6.0
_SCALE_BAR = 10.0
_FOOT = 8.0  # room for the scale bar
_GOLDEN = 0.618033988749895  # steps of hue that keep neighbouring seams apart
_FILL = "#f6f2ea"
_OUTLINE = "#3d3a36"


def drawing(pattern: Pattern, *, labels: bool = True) -> str:
    """An SVG document with all panels laid out side by side.

    Stitched edges share a colour and a number, seams that join start with start (`right_wrong`)
    are dashed, free edges are dark.

    Args:
        pattern: the pattern.
        labels: write panel names and seam numbers.

    Returns:
        The document; its user unit is one centimetre.
    """
    origins, width, height = layout(pattern)
    total_width, total_height = width + 2 * _MARGIN, height + 2 * _MARGIN + _FOOT
    seams = _seam_of_edge(pattern)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{total_width:.2f}cm" '
        f'height="{total_height:.2f}cm" viewBox="0 0 {total_width:.2f} {total_height:.2f}" '
        'font-family="Helvetica, Arial, sans-serif">',
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    for panel, origin in zip(pattern.panels, origins, strict=True):
        parts += _draw_panel(pattern, panel, origin + _MARGIN, seams, labels)
    parts += _draw_scale(_MARGIN, total_height - _MARGIN)
    parts.append("</svg>")
    return "\n".join(parts) + "\n"


def layout(pattern: Pattern) -> tuple[list[Float[np.ndarray, "2"]], float, float]:
    """Where panels go when they are laid out side by side.

    Returns:
        Place of every panel's origin in a picture whose y points down, and the width and height of
        the whole [cm].
    """
    boxes = [_bounds(panel) for panel in pattern.panels]
    corners, width, height = _layout([high - low for low, high in boxes])
    origins = [
        np.array([x - low[0], y + high[1]])
        for (x, y), (low, high) in zip(corners, boxes, strict=True)
    ]
    return origins, width, height


def _bounds(panel: Panel) -> tuple[np.ndarray, np.ndarray]:
    points = 100.0 * fine_outline(panel)[0]
    return points.min(axis=0), points.max(axis=0)


def _layout(sizes: list[np.ndarray]) -> tuple[list[tuple[float, float]], float, float]:
    """Put boxes in rows of about equal width, in order.

    Returns:
        Upper left corners, and the width and height of the whole [cm].
    """
    area = sum(float((w + _GAP) * (h + _GAP)) for w, h in sizes)
    widest = max(float(w) for w, _ in sizes)
    limit = max(widest, 1.3 * math.sqrt(area))
    origins, x, y, row_height, width = [], 0.0, 0.0, 0.0, 0.0
    for w, h in sizes:
        if x > 0.0 and x + w > limit:
            x, y, row_height = 0.0, y + row_height + _GAP, 0.0
        origins.append((x, y))
        width = max(width, x + float(w))
        x += float(w) + _GAP
        row_height = max(row_height, float(h))
    return origins, width, y + row_height


def _seam_of_edge(pattern: Pattern) -> dict[tuple[str, int], int]:
    seams = {}
    for number, stitch in enumerate(pattern.stitches):
        for side in (stitch.first, stitch.second):
            seams[side.panel, side.edge] = number
    return seams


def _colour(seam: int) -> str:
    channels = colorsys.hls_to_rgb((seam * _GOLDEN) % 1.0, 0.42, 0.75)
    return "#" + "".join(f"{round(255 * channel):02x}" for channel in channels)


def _path(points: np.ndarray) -> str:
    return " ".join(f"{'M' if i == 0 else 'L'}{x:.3f} {y:.3f}" for i, (x, y) in enumerate(points))


def _draw_panel(
    pattern: Pattern,
    panel: Panel,
    shift: np.ndarray,
    seams: dict[tuple[str, int], int],
    labels: bool,
) -> list[str]:
    def picture(points: np.ndarray) -> np.ndarray:
        return shift + 100.0 * points * np.array([1.0, -1.0])

    outline = fine_outline(panel)[0]
    turn = 1.0 if signed_area(outline) > 0.0 else -1.0
    parts = [
        f"<g><title>{escape(panel.name)}</title>",
        f'<path d="{_path(picture(outline))} Z" fill="{_FILL}" stroke="none"/>',
    ]
    texts = []
    for number, edge in enumerate(panel.edges):
        count = max(2, fine_count(edge))
        points = edge_points(panel, edge, np.arange(count + 1) / count)
        seam = seams.get((panel.name, number))
        style = f'stroke="{_OUTLINE}" stroke-width="0.25"'
        if seam is not None:
            dash = "" if pattern.stitches[seam].reversed else ' stroke-dasharray="1 0.6"'
            style = f'stroke="{_colour(seam)}" stroke-width="0.6"{dash}'
        parts.append(
            f'<path d="{_path(picture(points))}" fill="none" stroke-linecap="round" {style}/>'
        )
        if seam is not None and labels:
            middle = points[count // 2]
            along = points[count // 2 + 1] - points[count // 2 - 1]
            inward = turn * np.array([-along[1], along[0]]) / max(float(np.hypot(*along)), 1e-12)
            x, y = picture(middle + 0.014 * inward)
            texts.append(
                f'<text x="{x:.2f}" y="{y:.2f}" font-size="1.6" text-anchor="middle" '
                f'dominant-baseline="central" fill="{_colour(seam)}">{seam}</text>'
            )
    for x, y in picture(panel.vertices[[edge.start for edge in panel.edges]]):
        parts.append(f'<circle cx="{x:.3f}" cy="{y:.3f}" r="0.35" fill="{_OUTLINE}"/>')
    if labels:
        x, y = picture(_label_point(outline))
        room = 100.0 * float(np.ptp(outline[:, 0]))
        size = min(2.4, 1.5 * room / max(len(panel.name), 1))
        parts.append(
            f'<text x="{x:.2f}" y="{y:.2f}" font-size="{size:.2f}" text-anchor="middle" '
            f'dominant-baseline="central" fill="{_OUTLINE}">{escape(panel.name)}</text>'
        )
    return [*parts, *texts, "</g>"]


def _label_point(outline: np.ndarray) -> np.ndarray:
    """A point inside the outline for the name."""
    polygon = shapely.Polygon(outline)
    centre = polygon.centroid
    inside = centre if polygon.contains(centre) else polygon.representative_point()
    return np.array([inside.x, inside.y])


def _draw_scale(x: float, y: float) -> list[str]:
    return [
        f'<path d="M{x:.2f} {y - 0.8:.2f} v0.8 h{_SCALE_BAR} v-0.8" fill="none" '
        f'stroke="{_OUTLINE}" stroke-width="0.2"/>',
        f'<text x="{x + _SCALE_BAR + 1:.2f}" y="{y:.2f}" font-size="2" fill="{_OUTLINE}">'
        f"{_SCALE_BAR:.0f} cm</text>",
    ]
