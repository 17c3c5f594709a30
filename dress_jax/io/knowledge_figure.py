"""A picture of what is known about a pattern: how wide intervals are, and along what it is open."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from dress_jax.io.figures import save_figure
from dress_jax.pattern import Pattern
from dress_jax.pattern.drawing import layout
from dress_jax.pattern.outline import edge_points, fine_count, fine_outline

_WIDEST = 20.0  # [%] of the length; wider intervals look the same
_COLORS = "viridis_r"
_LINE = "#3d3a36"
_TICKS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


class OpenDirection(NamedTuple):
    """A combination of lengths that is known least.

    Attributes:
        deviation: of the lengths together [cm].
        ahead, behind: the pattern some way along it, either way.
    """

    deviation: float
    ahead: Pattern
    behind: Pattern


def write_knowledge_figure(
    path: str | Path,
    pattern: Pattern,
    intervals: Mapping[str, Float[np.ndarray, " edges"]],
    fabric: Mapping[str, tuple[float, float, float]],
    directions: Sequence[OpenDirection],
) -> None:
    """Edges in the colour of their interval's half width, fabric with error bars, open directions.

    Args:
        path: the PNG file.
        pattern: the fitted pattern.
        intervals: half of every edge's 95 % interval over its length [%], by panel.
        fabric: value and ends of the interval of every number of the fabric, by name.
        directions: to draw below; what is shown may be exaggerated.
    """
    figure = Figure(figsize=(11.0, 8.0 if directions else 4.8), layout="constrained")
    rows: Any = figure.subfigures(2, 1, height_ratios=[1.5, 1.0]) if directions else [figure]
    main, beside = rows[0].subplots(1, 2, width_ratios=[2.2, 1.0])
    colors = ScalarMappable(Normalize(0.0, _WIDEST), _COLORS)
    _draw_edges(main, pattern, intervals, colors)
    bar = figure.colorbar(colors, ax=main, extend="max", fraction=0.04)
    bar.set_label("95 % interval of the length, half [%]")
    _draw_fabric(beside, fabric)
    if directions:
        axes = rows[1].subplots(1, len(directions), squeeze=False)[0]
        for axis, direction in zip(axes, directions, strict=True):
            _draw_outlines(axis, pattern, direction.ahead, color="tab:red", lw=1.2)
            _draw_outlines(axis, pattern, direction.behind, color="tab:blue", lw=1.2)
            _draw_outlines(axis, pattern, pattern, color=_LINE, lw=0.6)
            title = f"lengths open by ± {direction.deviation:.1f} cm (drawn larger)"
            axis.set_title(title, fontsize=9)
    save_figure(figure, path)


def _draw_edges(
    axis: Axes,
    pattern: Pattern,
    intervals: Mapping[str, Float[np.ndarray, " edges"]],
    colors: ScalarMappable,
) -> None:
    origins, _, _ = layout(pattern)
    for panel, origin in zip(pattern.panels, origins, strict=True):
        outline = _placed(fine_outline(panel)[0], origin)
        axis.fill(*outline.T, color="#f6f2ea", lw=0)
        x, y = (float(value) for value in outline.mean(axis=0))
        axis.text(x, y, panel.name, fontsize=5, ha="center", va="center", color=_LINE)
        for edge, width in zip(panel.edges, intervals[panel.name], strict=True):
            count = fine_count(edge)
            points = edge_points(panel, edge, np.arange(count + 1) / count)
            axis.plot(*_placed(points, origin).T, color=colors.to_rgba(width), lw=2.5)
    _bare(axis)


def _draw_outlines(axis: Axes, places: Pattern, shown: Pattern, **style: Any) -> None:
    """A pattern's outlines where another one's panels are laid out."""
    origins, _, _ = layout(places)
    for panel, origin in zip(shown.panels, origins, strict=True):
        outline = _placed(fine_outline(panel)[0], origin)
        axis.plot(*np.vstack([outline, outline[:1]]).T, **style)
    _bare(axis)


def _draw_fabric(axis: Axes, fabric: Mapping[str, tuple[float, float, float]]) -> None:
    places = np.arange(len(fabric))
    values = np.array(list(fabric.values())).reshape(-1, 3)
    positive = bool(np.all(values[:, 1] > 0.0))
    axis.errorbar(
        values[:, 0],
        places,
        xerr=np.abs(values[:, 1:] - values[:, :1]).T,
        fmt="o",
        capsize=4,
        color="tab:blue",
    )
    if positive:
        axis.set_xscale("log")
        low, high = 0.9 * values[:, 1].min(), 1.1 * values[:, 2].max()
        axis.set_xlim(low, high)
        ticks = [t for t in _TICKS if low <= t <= high]
        axis.set_xticks(ticks, [f"{t:g}" for t in ticks])
        axis.minorticks_off()
    axis.axvline(1.0 if positive else 0.0, color=_LINE, lw=0.6)
    axis.set_yticks(places, list(fabric), fontsize=7)
    axis.set_ylim(-0.8, len(fabric) - 0.2)
    axis.set_title("fabric: factor, 95 % interval", fontsize=9)


def _placed(
    points: Float[np.ndarray, "n 2"], origin: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "n 2"]:
    """Panel coordinates in the picture [cm], y down."""
    return origin + 100.0 * points * np.array([1.0, -1.0])


def _bare(axis: Axes) -> None:
    axis.set_aspect("equal")
    if not axis.yaxis_inverted():
        axis.invert_yaxis()
    axis.axis("off")
