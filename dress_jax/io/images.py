"""Pictures (PNG): colour, masks and encoded normals; folders of target views (S6.1).

A target folder has the layout of the multi-view generators: `rgb/ normal/ mask/` with one file
per view, named by azimuth in degrees (`018.png`), and `cameras.json`, one object per view. Of an
outfit, `mask-NAME/` may hold the masks of its garments beside `mask/`, which shows all of them.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image, UnidentifiedImageError

from dress_jax.core.errors import InputError
from dress_jax.io.atomic import atomic_path
from dress_jax.io.documents import read_json, write_json

KINDS = ("rgb", "normal", "mask")
_PART = "mask-"


def write_rgb(path: str | Path, image: Float[np.ndarray, "h w 3"]) -> None:
    """Write colours in [0, 1], shape (h, w, 3), with 8 bits.

    Raises:
        ValueError: wrong shape, values outside [0, 1] or not finite.
    """
    _write(path, _unit_range(image, channels=3))


def write_mask(path: str | Path, mask: Float[np.ndarray, "h w"]) -> None:
    """Write coverage in [0, 1], shape (h, w), with 8 bits.

    Raises:
        ValueError: wrong shape, values outside [0, 1] or not finite.
    """
    _write(path, _unit_range(mask, channels=0))


def write_normals(
    path: str | Path, normals: Float[np.ndarray, "h w 3"], mask: np.ndarray | None = None
) -> None:
    """Write unit normals as (n + 1) / 2, shape (h, w, 3).

    Args:
        path: the file.
        normals: components in [-1, 1]; zero where there is no surface.
        mask: where there is a surface; the rest becomes white. By default where the normal is not
            zero.

    Raises:
        ValueError: wrong shape, values outside [-1, 1] or not finite.
    """
    normals = np.asarray(normals, dtype=np.float64)
    covered = np.linalg.norm(normals, axis=-1) > 0.0 if mask is None else np.asarray(mask) > 0.0
    encoded = np.where(covered[..., None], 0.5 * (normals + 1.0), 1.0)
    _write(path, _unit_range(encoded, channels=3))


def read_rgb(path: str | Path) -> Float[np.ndarray, "h w 3"]:
    """Colours in [0, 1]; transparent pixels are laid over white."""
    with opened(path) as image:
        rgba = np.asarray(image.convert("RGBA"), dtype=np.float32) / 255.0
    return rgba[..., :3] * rgba[..., 3:] + (1.0 - rgba[..., 3:])


def read_mask(path: str | Path) -> Float[np.ndarray, "h w"]:
    """Coverage in [0, 1], from a grey image or the alpha channel of one that has it."""
    with opened(path) as image:
        grey = image.getchannel("A") if "A" in image.getbands() else image.convert("L")
        return np.asarray(grey, dtype=np.float32) / 255.0


def read_normals(path: str | Path) -> Float[np.ndarray, "h w 3"]:
    """Normals 2 c - 1 as encoded; not normalized, and white background reads as (1, 1, 1)."""
    with opened(path) as image:
        return np.asarray(image.convert("RGB"), dtype=np.float32) / 127.5 - 1.0


@dataclasses.dataclass(frozen=True)
class Targets:
    """Target views.

    Args:
        azimuths: name of each view [degrees], shape (v,).
        cameras: one plain dictionary per view.
        rgb: colours in [0, 1], shape (v, h, w, 3), or None.
        normal: normals in [-1, 1], shape (v, h, w, 3), or None.
        mask: coverage in [0, 1], shape (v, h, w), or None.
        parts: coverage by each garment of an outfit, by name; empty where they are not told apart.
    """

    azimuths: tuple[int, ...]
    cameras: tuple[Mapping[str, Any], ...]
    rgb: np.ndarray | None = None
    normal: np.ndarray | None = None
    mask: np.ndarray | None = None
    parts: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)


def save_targets(folder: str | Path, targets: Targets) -> None:
    """Write a target folder.

    Raises:
        ValueError: counts differ, azimuths repeat or fall outside 0..359, or pixels are out of
            range.
    """
    folder, count = Path(folder), len(targets.azimuths)
    if len(set(targets.azimuths)) != count or not all(0 <= a < 360 for a in targets.azimuths):
        raise ValueError(f"azimuths must be distinct and in 0..359, not {targets.azimuths}")
    stacks = {kind: getattr(targets, kind) for kind in KINDS}
    stacks |= {_PART + name: stack for name, stack in targets.parts.items()}
    for name, stack in {"cameras": targets.cameras, **stacks}.items():
        if stack is not None and len(stack) != count:
            raise ValueError(f"{len(stack)} {name} for {count} azimuths")
    writers = {"rgb": write_rgb, "normal": write_normals, "mask": write_mask}
    for kind, stack in stacks.items():
        if stack is None:
            continue
        write = writers.get(kind, write_mask)
        for azimuth, image in zip(targets.azimuths, stack, strict=True):
            write(folder / kind / f"{azimuth:03d}.png", image)
    views = [
        {"azimuth": int(azimuth), "camera": camera}
        for azimuth, camera in zip(targets.azimuths, targets.cameras, strict=True)
    ]
    # Last: a folder with this file is a complete one.
    write_json(folder / "cameras.json", {"views": views})


def load_targets(folder: str | Path) -> Targets:
    """Read a target folder; kinds whose subfolder is absent are None.

    Raises:
        InputError: `cameras.json` is missing or malformed, a view's picture is missing, or pictures
            differ in size.
    """
    folder = Path(folder)
    where = str(folder / "cameras.json")
    views = read_json(where, what="the cameras of target views").get("views")
    if not isinstance(views, list) or not all(
        isinstance(view, dict)
        and isinstance(view.get("azimuth"), int)
        and isinstance(view.get("camera"), dict)
        for view in views
    ):
        raise InputError(
            "'views' must be a list of objects with 'azimuth' (whole degrees) and 'camera'",
            where=where,
            mend="write the folder again",
        )
    azimuths = tuple(view["azimuth"] for view in views)
    readers = {"rgb": read_rgb, "normal": read_normals, "mask": read_mask}

    def stack(kind: str, reader: Any) -> np.ndarray:
        return _stack([folder / kind / f"{azimuth:03d}.png" for azimuth in azimuths], reader)

    stacks = {kind: stack(kind, readers[kind]) for kind in KINDS if (folder / kind).is_dir()}
    parts = sorted(path.name for path in folder.glob(f"{_PART}*") if path.is_dir())
    return Targets(
        azimuths=azimuths,
        cameras=tuple(view["camera"] for view in views),
        parts={name.removeprefix(_PART): stack(name, read_mask) for name in parts},
        **stacks,
    )


def _stack(paths: Sequence[Path], reader: Any) -> np.ndarray:
    pictures = [reader(path) for path in paths]
    for path, picture in zip(paths, pictures, strict=True):
        if picture.shape != pictures[0].shape:
            raise InputError(
                f"is {picture.shape[1]}x{picture.shape[0]}, the first view is "
                f"{pictures[0].shape[1]}x{pictures[0].shape[0]}",
                where=str(path),
                mend="give all views the same size",
            )
    return np.stack(pictures)


def _unit_range(image: np.ndarray, *, channels: int) -> np.ndarray:
    image = np.asarray(image, dtype=np.float64)
    if image.ndim != (3 if channels else 2) or (channels and image.shape[-1] != channels):
        raise ValueError(f"a picture has shape {image.shape}")
    # Rounding of single precision may leave the range by an ulp; anything more is a fault.
    slack = 1e-5
    if not np.isfinite(image).all() or image.min() < -slack or image.max() > 1.0 + slack:
        raise ValueError(f"pixels run from {image.min():.3g} to {image.max():.3g}, not 0 to 1")
    return np.round(255.0 * image).astype(np.uint8)


def _write(path: str | Path, pixels: np.ndarray) -> None:
    with atomic_path(path) as temporary:
        Image.fromarray(pixels).save(temporary, format="PNG")


def opened(path: str | Path) -> Image.Image:
    """A picture as it is in its file, with its own mode.

    Raises:
        InputError: the file is missing or no picture.
    """
    try:
        image = Image.open(path)
        image.load()
    except FileNotFoundError as error:
        raise InputError("there is no such picture", where=str(path), mend="add it") from error
    except (UnidentifiedImageError, OSError) as error:
        raise InputError(
            "cannot be read as a picture", where=str(path), mend="save it as PNG again"
        ) from error
    return image
