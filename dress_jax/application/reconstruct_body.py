"""A body from pictures of a person (S7): the workflow, its report and its pictures."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from dress_jax.application.progress import Progress, silent
from dress_jax.body.model import BodyModel
from dress_jax.io.bodies import load_body_model, load_default_body
from dress_jax.io.figures import write_comparison
from dress_jax.io.meshes import write_body_obj
from dress_jax.io.person import SavedBody, read_body, write_body
from dress_jax.io.report import write_report
from dress_jax.reconstruction import (
    BodyParameters,
    BodyViews,
    Reconstruction,
    ReconstructionOptions,
    body_in_world,
    reconstruct,
)
from dress_jax.reconstruction.parameters import make_parameters, model_translation, rest_pelvis
from dress_jax.render.cameras import unstack_cameras
from dress_jax.render.shading import BODY_COLOR, shade

COMPARED_VIEWS = 4
_ONLY_TRUE, _ONLY_FOUND, _BOTH = (215, 60, 50), (50, 95, 215), (205, 205, 205)


@dataclasses.dataclass(frozen=True)
class BodyResult:
    """A reconstructed body.

    Attributes:
        body: what the model came from: "default", or the path of an SMPL-X file.
        model: the body model.
        views: what it was found from.
        found: parameters, colours, and how it went.
        vertices: in the world [m], (n, 3).
        joints: likewise, (j, 3).
    """

    body: str
    model: BodyModel
    views: BodyViews
    found: Reconstruction
    vertices: Float[np.ndarray, "n 3"]
    joints: Float[np.ndarray, "j 3"]

    @property
    def good(self) -> bool:
        """Landmarks have converged, pictures have lowered the loss, all outlines were followed."""
        end = self.found.fine_end
        by_pictures = end is None or (self.found.fine_kept and end.unfinished == 0)
        return self.found.landmark_fit.converged and by_pictures


def reconstruct_body(
    views: BodyViews,
    *,
    body: str | Path = "default",
    estimate: BodyParameters | str | Path | None = None,
    options: ReconstructionOptions | None = None,
    progress: Progress = silent,
) -> BodyResult:
    """Find the body that several views show.

    Args:
        views: from `make_body_views`, or `application.body_views`.
        body: "default", or an SMPL-X `.npz` file.
        estimate: pose and shape to begin with and to stay near, or a file of them (`io.person`).
        options: see `ReconstructionOptions`.
        progress: told about every stage.

    Raises:
        InputError: files that cannot be used, or an estimate that does not fit the body.
    """
    model = load_default_body() if str(body) == "default" else load_body_model(body)
    if estimate is not None and not isinstance(estimate, BodyParameters):
        estimate = read_estimate(model, estimate)

    def listen(stage: str, done: int, total: int, loss: float | None) -> None:
        progress(stage, done, total, loss=loss)

    found = reconstruct(model, views, estimate=estimate, options=options, listen=listen)
    state = body_in_world(model, found.parameters)
    return BodyResult(
        body=str(body),
        model=model,
        views=views,
        found=found,
        vertices=np.asarray(state.vertices, np.float64),
        joints=np.asarray(state.joints, np.float64),
    )


def read_estimate(model: BodyModel, path: str | Path) -> BodyParameters:
    """An estimate from a file that `io.person.write_body` wrote, or one of the same keys.

    Raises:
        InputError: a file that cannot be used, or does not fit the body.
    """
    saved = read_body(path)
    pelvis = rest_pelvis(model, saved.shape)
    return make_parameters(
        model,
        pose=saved.pose,
        shape=saved.shape,
        scale=saved.scale,
        translation=saved.scale * (pelvis + saved.translation),
    )


def save_body(folder: str | Path, result: BodyResult, report: Mapping[str, Any]) -> None:
    """Write `body.obj`, `body.npz`, `comparison.png` and, last, `report.json`; each atomically.

    Args:
        folder: where to.
        result: the body.
        report: from `body_report`, with whatever else belongs into the file.

    Raises:
        InputError: the folder cannot be written to.
    """
    folder, parameters = Path(folder), result.found.parameters
    faces = np.asarray(result.model.faces)
    write_body_obj(folder / "body.obj", result.vertices, faces)
    write_body(
        folder / "body.npz",
        SavedBody(
            pose=np.asarray(parameters.pose, np.float64),
            shape=np.asarray(parameters.shape, np.float64),
            scale=parameters.scale,
            translation=model_translation(result.model, parameters),
        ),
        joints=result.joints,
        colors=result.found.colors,
        smplx=result.body != "default",
    )
    rows, columns = comparison(result.views, result.vertices, faces)
    write_comparison(folder / "comparison.png", rows, columns)
    write_report(folder / "report.json", report)


def body_report(result: BodyResult) -> dict[str, Any]:
    """What `report.json` says: losses before and after, iterations, errors of the landmarks."""
    found = result.found
    fine = [
        {"loss": t.total, "rgb": t.rgb, "mask": t.mask, "landmark": t.landmark}
        for t in found.fine_terms
    ]
    ends = {
        name: None if terms is None else terms._asdict()
        for name, terms in (("start", found.fine_start), ("end", found.fine_end))
    }
    return {
        "body": result.body,
        "views": result.views.count,
        "landmarks_seen": int(np.sum(np.asarray(result.views.confidence) > 0.0)),
        "landmark_error_px": found.landmark_error,
        "scale": found.parameters.scale,
        "height_m": float(np.ptp(result.vertices[:, 1])),
        "good": result.good,
        "coarse": _fit_report(found.coarse_fit),
        "landmarks": _fit_report(found.landmark_fit),
        "fine": {"iterations": len(fine), "history": fine, "kept": found.fine_kept, **ends},
    }


def comparison(
    views: BodyViews,
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    *,
    truth: Float[np.ndarray, "n 3"] | None = None,
) -> tuple[dict[str, list[UInt8[np.ndarray, "h w 3"]]], list[str]]:
    """Pictures of four views by row name, and the names of the views.

    Args:
        views: what was seen; hidden regions are dimmed in its pictures.
        vertices, faces: the body that was found.
        truth: the true one, where it is known: what only it covers is red, only the other blue.
    """
    chosen = np.unique(np.arange(COMPARED_VIEWS) * views.count // COMPARED_VIEWS)
    every = unstack_cameras(views.cameras)
    rows: dict[str, list[np.ndarray]] = {}
    for view in chosen:
        drawn = shade(every[view], [(vertices, faces, np.asarray(BODY_COLOR))])
        seen = _seen(views, int(view))
        if seen is not None:
            rows.setdefault("seen", []).append(seen)
            on_body = np.any(drawn < 255, axis=2, keepdims=True)
            over = np.where(on_body, (0.35 * seen + 0.65 * drawn).astype(np.uint8), seen)
            rows.setdefault("reconstructed, over it", []).append(over)
        rows.setdefault("reconstructed", []).append(drawn)
        if truth is not None:
            real = shade(every[view], [(truth, faces, np.asarray(BODY_COLOR))])
            rows.setdefault("true", []).append(real)
            rows.setdefault("only true red, only found blue", []).append(_difference(real, drawn))
    return rows, [f"view {view}" for view in chosen]


def _seen(views: BodyViews, view: int) -> np.ndarray | None:
    if views.mask is None or views.visible is None:
        return None
    if views.color is None:
        picture = np.repeat(1.0 - np.asarray(views.mask[view])[:, :, None], 3, axis=2)
    else:
        picture = np.asarray(views.color[view])
    dim = np.where(np.asarray(views.visible[view])[:, :, None] > 0.5, 1.0, 0.6)
    return np.round(255.0 * np.clip(picture * dim, 0.0, 1.0)).astype(np.uint8)


def _difference(true: np.ndarray, found: np.ndarray) -> np.ndarray:
    there, here = (np.any(picture < 250, axis=2) for picture in (true, found))
    result = np.full(true.shape, 255, np.uint8)
    result[there & here] = _BOTH
    result[there & ~here] = _ONLY_TRUE
    result[here & ~there] = _ONLY_FOUND
    return result


def _fit_report(fit: Any) -> dict[str, Any]:
    return {
        "iterations": fit.iterations,
        "converged": bool(fit.converged),
        "loss": {"start": fit.losses[0], "end": fit.loss},
    }
