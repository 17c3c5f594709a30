"""The result folder of a fit: the fitted garment, and pictures of how it came about."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dress_jax.application.drape import picture
from dress_jax.application.fit import FitResult
from dress_jax.application.fit_knowledge import write_knowledge
from dress_jax.io.figures import write_comparison, write_loss_figure
from dress_jax.io.results import DrapedState, write_result
from dress_jax.render.cameras import Camera, unstack_cameras
from dress_jax.render.shading import BODY_COLOR, GARMENT_COLOR, shade

COMPARED_VIEWS = 4


def save_fit(folder: str | Path, result: FitResult, report: Mapping[str, Any]) -> None:
    """Write a fit: everything that a drape's folder has, `loss.png`, `comparison.png`, `known.png`.

    Args:
        folder: where to.
        result: the fit.
        report: from `fit_report`, with whatever else belongs into the file.

    Raises:
        InputError: the folder cannot be written to.
    """
    folder = Path(folder)
    write_loss_figure(
        folder / "loss.png",
        [record["loss"] for record in result.course.history],
        [record["iou"] if result.views.has_mask else None for record in result.course.history],
    )
    rows, columns = comparison(result)
    write_comparison(folder / "comparison.png", rows, columns)
    if result.known is not None:
        write_knowledge(
            folder / "known.png",
            result.problem,
            result.pattern,
            result.end.unknowns,
            result.known,
        )
    write_result(
        folder,
        result.state,
        pattern=result.pattern,
        preview=picture(result.state),
        report=report,
    )


def comparison(result: FitResult) -> tuple[dict[str, list[np.ndarray]], list[str]]:
    """Target, start and result from four of the target cameras, and the views' names.

    The target is the true garment where it is known, the target picture otherwise; without either
    there are start and result only.
    """
    views = result.views
    count = len(views.azimuths)
    chosen = np.unique(np.arange(COMPARED_VIEWS) * count // COMPARED_VIEWS)
    every = unstack_cameras(views.observation.cameras)
    cameras = [every[i] for i in chosen]
    if views.truth is not None:
        target = _pictures(cameras, views.truth.vertices, views.truth.faces, result.start)
    else:
        target = [_target_picture(result, int(i)) for i in chosen]
    first, last = np.asarray(result.first.discretization.faces), result.state.garment.faces
    rows = {
        **({"target": target} if views.has_mask else {}),
        "start": _pictures(cameras, np.asarray(result.begin.positions), first, result.start),
        "result": _pictures(cameras, result.state.garment.vertices, last, result.start),
    }
    return rows, [f"{views.azimuths[i]}°" for i in chosen]


def _pictures(
    cameras: list[Camera], vertices: np.ndarray, faces: np.ndarray, body: DrapedState
) -> list[np.ndarray]:
    meshes = [
        (vertices, faces, np.asarray(GARMENT_COLOR)),
        (body.body_vertices, body.body_faces, np.asarray(BODY_COLOR)),
    ]
    return [shade(camera, meshes) for camera in cameras]


def _target_picture(result: FitResult, view: int) -> np.ndarray:
    """The colours of a view on white, or its mask where there are none."""
    observation = result.views.observation
    mask = np.asarray(observation.mask[view], np.float64)[..., None]
    inside = np.asarray(observation.garment[view], np.float64)[..., None]
    if result.views.has_color:
        shown = np.asarray(observation.color[view]) * inside + (1.0 - inside)
    else:
        shown = np.repeat(1.0 - 0.6 * mask, 3, axis=2)
    return np.round(255.0 * np.clip(shown, 0.0, 1.0)).astype(np.uint8)
