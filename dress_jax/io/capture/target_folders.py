"""Target folders as `render` writes them, gathered into a bundle."""

from pathlib import Path

from dress_jax.capture.bundle import Bundle
from dress_jax.capture.views import View, unit_normals
from dress_jax.core.errors import InputError
from dress_jax.io.capture.fields import within
from dress_jax.io.capture.pictures import read_coverage, read_pixels
from dress_jax.io.images import load_targets, read_normals
from dress_jax.render.cameras import cameras_from_dict


def read_target_folder(folder: str | Path) -> Bundle:
    """The views of a target folder: colours, normals, masks of the garment and of its parts.

    Args:
        folder: see `io.images`. Masks of parts keep their names; a true garment beside the
            pictures stays behind.

    Raises:
        InputError: something is missing or malformed, or there is no view.
    """
    folder = Path(folder)
    targets = load_targets(folder)
    if not targets.azimuths:
        raise InputError("holds no views", where=str(folder / "cameras.json"))
    with within(folder / "cameras.json"):
        cameras = cameras_from_dict({"cameras": list(targets.cameras)})
    views = []
    for azimuth, camera in zip(targets.azimuths, cameras, strict=True):
        name = f"{azimuth:03d}"
        file = f"{name}.png"
        mask = None if targets.mask is None else read_coverage(folder / "mask" / file)
        normal = None
        if targets.normal is not None:
            if mask is None:
                raise InputError(
                    "has normals without masks", where=str(folder), mend="add mask/ beside normal/"
                )
            normal = unit_normals(read_normals(folder / "normal" / file), mask)
        with within(folder):
            view = View(
                name=name,
                camera=camera,
                rgb=None if targets.rgb is None else read_pixels(folder / "rgb" / file)[0],
                mask=mask,
                parts={p: read_coverage(folder / f"mask-{p}" / file) for p in targets.parts},
                normal=normal,
            )
        views.append(view)
    return Bundle(views=tuple(views), sources={"views": "target folder"})
