"""Figures of a fit: how the loss went, and target, start and result side by side."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dress_jax.io.atomic import atomic_path

_TILE = 2.6  # inches
_DOTS = 160  # per inch


def write_loss_figure(
    path: str | Path, losses: Sequence[float | None], ious: Sequence[float | None]
) -> None:
    """Plot loss (logarithmic) and mask IoU over the iterations; rejected steps are gaps.

    Args:
        path: the PNG file.
        losses: per iteration, None where the step was rejected.
        ious: likewise.
    """
    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    left = figure.add_subplot()
    right = left.twinx()
    steps = np.arange(len(losses))
    left.plot(steps, _gaps(losses), ".-", color="tab:blue")
    right.plot(steps, _gaps(ious), ".-", color="tab:orange")
    if np.nanmax(_gaps(losses), initial=0.0) > 0.0:
        left.set_yscale("log")
    left.set_xlabel("iteration")
    left.set_ylabel("loss", color="tab:blue")
    right.set_ylabel("mask IoU", color="tab:orange")
    left.grid(alpha=0.3)
    save_figure(figure, path)


def write_comparison(
    path: str | Path,
    rows: Mapping[str, Sequence[UInt8[np.ndarray, "h w 3"]]],
    columns: Sequence[str],
) -> None:
    """Rows of pictures with names at the left and the views' names above.

    Args:
        path: the PNG file.
        rows: pictures by row name, one per column.
        columns: names of the views.
    """
    size = (_TILE * len(columns) + 0.4, _TILE * len(rows) + 0.3)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(len(rows), len(columns), squeeze=False)
    for line, (name, pictures) in zip(axes, rows.items(), strict=True):
        for axis, picture in zip(line, pictures, strict=True):
            axis.imshow(picture)
            axis.set_xticks([])
            axis.set_yticks([])
            for spine in axis.spines.values():
                spine.set_visible(False)
        line[0].set_ylabel(name)
    for axis, name in zip(axes[0], columns, strict=True):
        axis.set_title(name, fontsize=9)
    save_figure(figure, path)


def _gaps(values: Sequence[float | None]) -> np.ndarray:
    return np.array([np.nan if value is None else value for value in values], dtype=float)


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, atomically."""
    # The canvas is given, so that no window system is looked for.
    FigureCanvasAgg(figure)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=_DOTS)
