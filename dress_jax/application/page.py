"""The page of a reconstruction: everything side by side, in one file that a phone can show."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from dress_jax.application.found_body import load_wearer, moved_bundle
from dress_jax.application.stages import StageOutcome, complete_stage
from dress_jax.application.start_pattern import front_view
from dress_jax.capture.bundle import Bundle
from dress_jax.capture.frames import view_azimuth
from dress_jax.capture.labels import LABEL_COLORS
from dress_jax.capture.reduction import reduced_view, reduction_factor
from dress_jax.capture.views import View
from dress_jax.io.capture.bundles import load_bundle
from dress_jax.io.documents import read_json
from dress_jax.io.page import (
    Page,
    ViewedMesh,
    picture,
    picture_of_file,
    text,
    viewer,
    write_document,
)
from dress_jax.io.results import DrapedState, read_state
from dress_jax.render.shading import BODY_COLOR, GARMENT_COLOR, shade

PAGE = "index.html"
SINGLE_VIEW = (
    "This was reconstructed from one picture. Only the outline and the colours of the front are "
    "seen; the back follows from symmetry, from the seams, and from the template. Depth, and with "
    "it the size of the person, is assumed, and so is the camera. How wide the clothes are from "
    "front to back, and every seam that the front does not show, are those of the template. "
    "Pictures from all sides measure these things.",
)
_LONGEST = 384  # of the pictures beside each other [px]
_MARGIN = 0.08  # around what is shown
_BODIES = 4  # views in which the body is shown over the picture
_START_COLOR = (0.85, 0.60, 0.35)
_TINT = np.array([200.0, 70.0, 110.0])


def write_page(path: str | Path, folder: str | Path, *, title: str) -> None:
    """Write the page of a reconstruction whose other stages are complete.

    Args:
        path: the HTML file.
        folder: of the reconstruction, see `application.reconstruct`.
        title: of the page.

    Raises:
        InputError: a stage is missing or damaged.
    """
    folder = Path(folder)
    wearer, offset = load_wearer(folder / "body")
    bundle = moved_bundle(load_bundle(folder / "bundle" / "bundle.h5"), offset)
    begin, end = (read_state(folder / name / "drape.h5") for name in ("drape", "fit"))
    drape, fit = (
        read_json(folder / name / "report.json", what="a report") for name in ("drape", "fit")
    )
    names = ("bundle", "body", "pattern", "drape", "fit", "texture")
    stages = [stage for name in names if (stage := complete_stage(folder, name)) is not None]
    small = _small_views(bundle.views)
    sections = [
        ("3D view", _viewer(begin, end, folder)),
        ("Input and segmentation", _input(bundle, small)),
        ("Body", _body(small, wearer.vertices, wearer.faces, folder)),
        ("Pattern", _patterns(folder)),
        ("Drape beside picture", _views(small, begin, end)),
        ("Course of the fit", _course(folder)),
        ("Texture", _texture(folder)),
        ("Certificates", _certificates(drape, fit)),
        ("Stages", _stages(stages)),
    ]
    single = bool(read_json(folder / "bundle" / "facts.json", what="facts")["single_view"])
    head = _chips(fit) + (_warning(SINGLE_VIEW) if single else "")
    write_document(path, Page(title=f"Reconstruction of {title}", head=head, sections=sections))


def _chips(fit: Mapping[str, Any]) -> str:
    """The figures that are looked at first."""

    def change(key: str, scale: float, unit: str, digits: int, inner: str = "") -> str | None:
        found = fit.get(key)
        if found is None:
            return None
        start, end = (found[k][inner] if inner else found[k] for k in ("start", "end"))
        return f"{scale * start:.{digits}f} → {scale * end:.{digits}f}{unit}"

    crossings = fit["intersections"]
    rows = [
        ("mask IoU, start → end", change("iou", 1.0, "", 3)),
        ("distance to the true garment", change("chamfer_cm", 1.0, " cm", 2)),
        ("edge lengths off, median", change("edge_length_error", 100.0, " %", 1, "median")),
        ("edge lengths off, largest", change("edge_length_error", 100.0, " %", 1, "max")),
        ("intersections", f"{crossings['self']} with itself, {crossings['body']} with the body"),
        ("triangles", f"{fit['faces']}"),
    ]
    chips = [f"<li><b>{text(v)}</b><span>{text(k)}</span></li>" for k, v in rows if v is not None]
    return f'<ul class="chips">{"".join(chips)}</ul>'


def _warning(sentences: Sequence[str]) -> str:
    inner = "".join(f"<p>{text(s)}</p>" for s in sentences)
    return f'<div class="warn"><p><b>What one view leaves open.</b></p>{inner}</div>'


def _viewer(begin: DrapedState, end: DrapedState, folder: Path) -> str:
    meshes = [
        ViewedMesh("body", end.body_vertices, end.body_faces, BODY_COLOR),
        ViewedMesh("garment", end.garment.vertices, end.garment.faces, GARMENT_COLOR),
        ViewedMesh("start", begin.garment.vertices, begin.garment.faces, _START_COLOR, shown=False),
    ]
    instead = picture_of_file(folder / "fit" / "preview.png", "front, side and back")
    hint = '<p class="soft">Drag to turn, pinch or scroll to zoom, double-tap to reset.</p>'
    return viewer("scene", meshes, instead=instead) + hint


def _input(bundle: Bundle, small: Sequence[View]) -> str:
    figures = []
    if bundle.image is not None:
        figures.append(picture(bundle.image, "photograph"))
        if bundle.labels is not None:
            labels = LABEL_COLORS[bundle.labels].astype(float)
            mixed = np.round(0.45 * bundle.image + 0.55 * labels).astype(np.uint8)
            figures.append(picture(mixed, "labels"))
    else:
        figures = [
            picture(_tinted(view), f"{view.name} ({view_azimuth(view.camera)}°)") for view in small
        ]
        return f'<div class="grid small">{"".join(figures)}</div>'
    return f'<div class="grid">{"".join(figures)}</div>'


def _body(small: Sequence[View], vertices: np.ndarray, faces: np.ndarray, folder: Path) -> str:
    """The body over the pictures; what it shows of its own clothes is not hidden."""
    chosen = np.unique(np.arange(_BODIES) * len(small) // _BODIES)
    figures = []
    for view in (small[k] for k in chosen):
        drawn = shade(view.camera, [(vertices, faces, np.asarray(BODY_COLOR))])
        seen = _shown(view).astype(float)
        on_body = np.any(drawn < 255, axis=2, keepdims=True)
        over = np.where(on_body, np.round(0.35 * seen + 0.65 * drawn), seen).astype(np.uint8)
        figures.append(picture(over[_filled([drawn])], f"body over {view.name}"))
    report = read_json(folder / "body" / "report.json", what="a report")
    said = ""
    if "landmark_error_px" in report:
        said = (
            f'<p class="soft">Fitted to {_counted(report["views"], "view")}: landmarks are off by '
            f"{report['landmark_error_px']:.1f} px (rms), height {report['height_m']:.2f} m as "
            "posed.</p>"
        )
    return f'<div class="grid small">{"".join(figures)}</div>{said}'


def _counted(number: int, what: str) -> str:
    return f"{number} {what}" + ("" if number == 1 else "s")


def _patterns(folder: Path) -> str:
    start = picture_of_file(folder / "pattern" / "pattern.svg", "start")
    end = picture_of_file(folder / "fit" / "pattern.svg", "fitted")
    return f'<div class="grid pattern">{start}{end}</div>'


def _views(small: Sequence[View], begin: DrapedState, end: DrapedState) -> str:
    """Picture, start and result from every camera."""
    rows = []
    for view in small:
        pictures = [(_shown(view), f"{view_azimuth(view.camera)}°: picture")]
        for state, name in ((begin, "start"), (end, "result")):
            garment = (state.garment.vertices, state.garment.faces, np.asarray(GARMENT_COLOR))
            body = (state.body_vertices, state.body_faces, np.asarray(BODY_COLOR))
            pictures.append((shade(view.camera, [garment, body]), name))
        box = _filled([pixels for pixels, _ in pictures[1:]])
        shown = [picture(pixels[box], caption) for pixels, caption in pictures]
        rows.append(f'<div class="row">{"".join(shown)}</div>')
    return f'<div class="views">{"".join(rows)}</div>'


def _filled(pictures: Sequence[np.ndarray]) -> tuple[slice, slice]:
    """Rows and columns in which one of the pictures shows something on white, with a margin."""
    covered = np.any([(pixels < 255).any(axis=2) for pixels in pictures], axis=0)
    if not covered.any():
        return slice(None), slice(None)
    slices = []
    for axis in (1, 0):
        places = np.flatnonzero(covered.any(axis=axis))
        margin = max(2, round(_MARGIN * (places[-1] - places[0])))
        slices.append(slice(max(int(places[0]) - margin, 0), int(places[-1]) + 1 + margin))
    return slices[0], slices[1]


def _course(folder: Path) -> str:
    figures = [picture_of_file(folder / "fit" / "loss.png", "loss and mask IoU")]
    if (folder / "fit" / "known.png").is_file():
        caption = "what the pictures tell about every edge"
        figures.append(picture_of_file(folder / "fit" / "known.png", caption))
    return f'<div class="grid">{"".join(figures)}</div>'


def _texture(folder: Path) -> str:
    names = {"preview.png": "textured, front and back", "comparison.png": "pictures and result"}
    figures = [
        picture_of_file(folder / "texture" / name, caption)
        for name, caption in names.items()
        if (folder / "texture" / name).is_file()
    ]
    return f'<div class="grid">{"".join(figures)}</div>' if figures else ""


def _certificates(drape: Mapping[str, Any], fit: Mapping[str, Any]) -> str:
    """What holds of the two drapes, counted from their positions alone."""

    def certificate(report: Mapping[str, Any], key: str, form: str) -> str:
        found = report["certificate"]
        value = found.get(key, "unknown")
        return form.format(value) if isinstance(value, float) else _WORDS.get(value, str(value))

    rows: list[tuple[str, list[str]]] = [
        ("converged", ["yes" if r["converged"] else str(r["result"]) for r in (drape, fit)]),
        (
            "intersections, itself / body",
            [f"{r['intersections']['self']} / {r['intersections']['body']}" for r in (drape, fit)],
        ),
        ("smallest distance", [f"{1e3 * r['min_distance_m']:.2f} mm" for r in (drape, fit)]),
        ("largest gap of a seam", [f"{1e3 * r['max_seam_gap_m']:.2g} mm" for r in (drape, fit)]),
        ("largest strain", [f"{r['max_strain']:.1%}" for r in (drape, fit)]),
    ]
    for key, label, form in _CERTIFIED:
        rows.append((label, [certificate(r, key, form) for r in (drape, fit)]))
    lines = "".join(
        f"<tr><td>{text(name)}</td>"
        + "".join(f'<td class="number">{text(v)}</td>' for v in values)
        + "</tr>"
        for name, values in rows
    )
    return (
        '<div class="scroll"><table><tr><th></th><th>start drape</th><th>fitted drape</th></tr>'
        f"{lines}</table></div>"
    )


def _stages(stages: Sequence[StageOutcome]) -> str:
    rows = []
    for stage in stages:
        notes = [n for n in (stage.result.skipped, *stage.result.notes) if n]
        word = "yes" if stage.result.good else "no"
        sound = f'<span class="{word}">{word}</span>'
        rows.append(
            f"<tr><td>{text(stage.name)}</td><td>{sound}</td>"
            f'<td class="number">{stage.seconds:.0f} s</td><td>{text(" ".join(notes))}</td></tr>'
        )
    return (
        '<div class="scroll"><table><tr><th>stage</th><th>sound</th><th>time</th><th>notes</th>'
        f"</tr>{''.join(rows)}</table></div>"
    )


_WORDS = {True: "yes", False: "no"}
_CERTIFIED = (
    ("residual", "largest force that is left", "{:.2g} N"),
    ("smallest_eigenvalue", "smallest eigenvalue of the Hessian", "{:.3g} 1/s²"),
    ("stable", "stable", "{}"),
)


def _small_views(views: Sequence[View]) -> list[View]:
    """All views, fit for a page, the front one first and on around the body."""
    factor = reduction_factor(tuple(views), _LONGEST)
    first = view_azimuth(front_view(tuple(views)).camera)
    around = sorted(views, key=lambda view: (view_azimuth(view.camera) - first) % 360)
    return [reduced_view(dataclasses.replace(view, normal=None), factor) for view in around]


def _shown(view: View) -> UInt8[np.ndarray, "h w 3"]:
    """The colours of a view, or its mask in grey."""
    if view.rgb is not None:
        return view.rgb
    size = (view.camera.height, view.camera.width)
    mask = np.zeros(size, np.uint8) if view.mask is None else view.mask
    return np.repeat((255 - 0.6 * mask.astype(float)).astype(np.uint8)[..., None], 3, axis=2)


def _tinted(view: View) -> UInt8[np.ndarray, "h w 3"]:
    base = _shown(view).astype(float)
    if view.mask is None:
        return _shown(view)
    weight = 0.5 * view.mask[..., None] / 255.0
    return np.round(base * (1.0 - weight) + _TINT * weight).astype(np.uint8)
