"""Observation bundles out of what other tools and data sets write (S6.1)."""

import enum
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from dress_jax.application.bundle_targets import draw_masks
from dress_jax.application.photo import read_photo
from dress_jax.application.progress import Progress, silent
from dress_jax.capture.bundle import Bundle, merge_bundles
from dress_jax.core.errors import InputError
from dress_jax.io.capture.body_files import read_magicman_body, read_osx, read_smpler_x
from dress_jax.io.capture.bundles import HDF5_SUFFIXES, load_bundle, save_bundle
from dress_jax.io.capture.close_scans import read_close
from dress_jax.io.capture.four_d_dress import read_four_d_dress
from dress_jax.io.capture.label_maps import label_views, read_label_map
from dress_jax.io.capture.landmark_files import read_openpose, read_wholebody
from dress_jax.io.capture.magicman import read_magicman
from dress_jax.io.capture.photographs import read_photograph
from dress_jax.io.capture.preview import contact_sheet
from dress_jax.io.capture.pshuman import read_pshuman
from dress_jax.io.capture.sewfactory import read_sewfactory
from dress_jax.io.capture.specifications import read_specification
from dress_jax.io.capture.target_folders import read_target_folder
from dress_jax.io.results import write_picture

PREVIEW = "preview.png"


class Source(enum.Enum):
    """Formats that are read."""

    BUNDLE = "bundle"
    PHOTO = "photo"
    TARGETS = "targets"
    PHOTOGRAPH = "photograph"
    LABELS = "labels"
    OPENPOSE = "openpose"
    DWPOSE = "dwpose"
    SMPLER_X = "smpler-x"
    OSX = "osx"
    MAGICMAN = "magicman"
    MAGICMAN_BODY = "magicman-body"
    PSHUMAN = "pshuman"
    SEWFACTORY = "sewfactory"
    FOUR_D_DRESS = "4d-dress"
    CLOSE = "close"
    PATTERN = "pattern"


def _magicman_body(path: Path) -> Bundle:
    return Bundle(body=read_magicman_body(path), sources={"body": "MagicMan"})


_READERS: Mapping[Source, Callable[..., Bundle]] = {
    Source.BUNDLE: load_bundle,
    Source.PHOTO: read_photo,
    Source.TARGETS: read_target_folder,
    Source.PHOTOGRAPH: read_photograph,
    Source.LABELS: read_label_map,
    Source.OPENPOSE: read_openpose,
    Source.DWPOSE: read_wholebody,
    Source.SMPLER_X: read_smpler_x,
    Source.OSX: read_osx,
    Source.MAGICMAN: read_magicman,
    Source.MAGICMAN_BODY: _magicman_body,
    Source.PSHUMAN: read_pshuman,
    Source.SEWFACTORY: read_sewfactory,
    Source.FOUR_D_DRESS: read_four_d_dress,
    Source.CLOSE: read_close,
    Source.PATTERN: read_specification,
}


def make_bundle(
    path: str | Path,
    source: Source,
    *,
    onto: Bundle | None = None,
    replace: bool = False,
    masks: bool = False,
    progress: Progress = silent,
    **options: Any,
) -> Bundle:
    """Read one input, and add it to an earlier bundle where there is one.

    Args:
        path: file or folder.
        source: its format. A folder of label maps gives the views of `onto` their masks.
        onto: the bundle to add to, of the same person in the same frame.
        replace: whether new parts may take the place of old ones.
        masks: draw the clothes' masks of all views from the labelled scan.
        progress: told about drawn views.
        options: of the reader (`height`, `pose`, `frame`, `table`, `person`, `matte`, `mirrored`,
            `tool`); None counts as not given.

    Raises:
        InputError: the input is malformed, an option does not apply or is lacking, or parts are
            there twice.
    """
    given = _checked(source, {name: v for name, v in options.items() if v is not None})
    if source is Source.LABELS and Path(path).is_dir():
        if onto is None:
            raise InputError(
                "holds one label map per view, but there are no views",
                where=str(path),
                mend="name the bundle that has them with --onto",
            )
        bundle = label_views(onto, path, **given)
    else:
        bundle = _READERS[source](Path(path), **given)
        if onto is not None:
            bundle = merge_bundles(onto, bundle, replace=replace)
    return draw_masks(bundle, progress=progress) if masks else bundle


def write_bundle(path: str | Path, bundle: Bundle) -> Path:
    """Save a bundle and its contact sheet.

    Returns:
        The sheet: `preview.png` in a folder, `NAME-preview.png` beside an HDF5 file.
    """
    path = Path(path)
    save_bundle(path, bundle)
    is_file = path.suffix.lower() in HDF5_SUFFIXES
    preview = path.with_name(f"{path.stem}-{PREVIEW}") if is_file else path / PREVIEW
    write_picture(preview, contact_sheet(bundle))
    return preview


def bundle_rows(bundle: Bundle) -> list[tuple[str, str, str]]:
    """Part, content and source of everything that is there."""
    return [(part, _content(bundle, part), bundle.sources.get(part, "")) for part in bundle.present]


def _content(bundle: Bundle, part: str) -> str:
    value = getattr(bundle, part)
    if part in ("image", "matte", "labels"):
        return f"{value.shape[1]}x{value.shape[0]} px"
    if part == "landmarks":
        return f"{int((value.confidence > 0.0).sum())} of {len(value.points)} found"
    if part == "body":
        return f"{value.family.value}, {len(value.betas)} betas"
    if part in ("body_mesh", "scan"):
        labelled = "" if value.labels is None else ", labelled"
        return f"{len(value.vertices)} vertices, {len(value.faces)} faces{labelled}"
    if part == "pattern":
        return f"{len(value.panels)} panels, {len(value.stitches)} seams"
    camera = value[0].camera
    kinds = [
        kind
        for kind in ("rgb", "matte", "mask", "normal")
        if all(getattr(view, kind) is not None for view in value)
    ]
    shown = ", ".join(kinds) or "cameras only"
    return f"{len(value)}, {camera.kind.value}, {camera.width}x{camera.height} px: {shown}"


def _checked(source: Source, options: dict[str, Any]) -> dict[str, Any]:
    """The options, where the reader takes all of them and lacks none."""
    parameters = inspect.signature(_READERS[source]).parameters
    known = {name: p for name, p in list(parameters.items())[1:]}
    for name in options:
        if name not in known:
            takes = ", ".join(f"--{n}" for n in known) or "no options"
            raise InputError(
                f"does not apply to {source.value}", where=f"--{name}", mend=f"it takes {takes}"
            )
    for name, parameter in known.items():
        if parameter.default is inspect.Parameter.empty and name not in options:
            raise InputError(f"{source.value} needs it", where=f"--{name}", mend="give it")
    return options
