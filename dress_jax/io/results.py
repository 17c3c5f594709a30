"""A result folder: a draped garment as meshes, pictures, pattern and exact state.

garment.obj   welded garment, texture coordinates = panel coordinates [m], one group a panel
body.obj      the body it hangs on
garment.glb   both, to look at
preview.png   front, side, back
pattern.json  the pattern, pattern.svg its drawing
drape.h5      everything that `read_result` needs, in double precision
report.json   numbers; written last, so a folder that has it is complete
"""

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image

from dress_jax.core.errors import InputError
from dress_jax.io.atomic import atomic_path, write_text
from dress_jax.io.documents import to_plain
from dress_jax.io.meshes import GarmentMesh, write_body_obj, write_garment_obj, write_glb
from dress_jax.io.patterns import load_pattern, save_pattern
from dress_jax.io.report import environment, write_report
from dress_jax.pattern.drawing import drawing
from dress_jax.pattern.model import Pattern

FORMAT = 1
_ARRAYS = ("weld_map", "seam_vertices", "seam_offset", "pins", "pin_targets")


@dataclasses.dataclass(frozen=True)
class DrapedState:
    """A draped garment on a body, exactly.

    Args:
        garment: the welded mesh with its flat panels.
        weld_map: vertex of each panel vertex, shape (p,).
        seam_vertices: pairs of panel vertices that are sewn, stitches in turn, shape (s, 2).
        seam_offset: first pair of each stitch, and s, shape (stitches + 1,).
        pins: vertices that are held, shape (k,).
        pin_targets: where [m], shape (k, 3).
        body_vertices: [m], shape (b, 3).
        body_faces: shape (g, 3).
        settings: what the drape was made with (edge length, fabric, body, pose).
    """

    garment: GarmentMesh
    weld_map: Int[np.ndarray, " p"]
    seam_vertices: Int[np.ndarray, "s 2"]
    seam_offset: Int[np.ndarray, " stitches_plus_1"]
    pins: Int[np.ndarray, " k"]
    pin_targets: Float[np.ndarray, "k 3"]
    body_vertices: Float[np.ndarray, "b 3"]
    body_faces: Int[np.ndarray, "g 3"]
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)


def prepare_folder(folder: str | Path) -> None:
    """Make a folder and see that it can be written to: before hours of work, not after.

    Raises:
        InputError: it cannot.
    """
    with atomic_path(Path(folder) / "writable"):
        pass
    (Path(folder) / "writable").unlink()


def write_result(
    folder: str | Path,
    state: DrapedState,
    *,
    pattern: Pattern,
    preview: UInt8[np.ndarray, "h w 3"],
    report: Mapping[str, Any],
) -> None:
    """Write a result folder; every file is replaced atomically, the report last.

    Args:
        folder: made where it is missing.
        state: the draped garment.
        pattern: its pattern.
        preview: picture for `preview.png`.
        report: numbers for `report.json`, which gets the versions as well; infinities become null.

    Raises:
        InputError: the folder cannot be written to.
    """
    folder = Path(folder)
    # A report that is there already belongs to what is about to be replaced.
    (folder / "report.json").unlink(missing_ok=True)
    write_meshes(folder, state)
    write_picture(folder / "preview.png", preview)
    save_pattern(pattern, folder / "pattern.json")
    write_text(folder / "pattern.svg", drawing(pattern))
    write_state(folder / "drape.h5", state)
    write_report(folder / "report.json", {**report, "versions": versions()}, nonfinite_to_null=True)


def write_meshes(folder: str | Path, state: DrapedState) -> None:
    """Write `garment.obj`, `body.obj` and `garment.glb`."""
    folder = Path(folder)
    write_garment_obj(folder / "garment.obj", state.garment)
    write_body_obj(folder / "body.obj", state.body_vertices, state.body_faces)
    write_glb(
        folder / "garment.glb",
        garments=[state.garment],
        body=(state.body_vertices, state.body_faces),
    )


def write_picture(path: str | Path, pixels: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write 8-bit pixels as PNG, atomically."""
    with atomic_path(path) as temporary:
        Image.fromarray(np.asarray(pixels, np.uint8)).save(temporary, format="PNG")


def versions() -> dict[str, Any]:
    """Versions of this package, Python and the numerical packages by name."""
    known = environment()
    return {
        "dress_jax": known["dress_jax"],
        "python": known["python"],
        **known["packages"],
    }


def write_state(path: str | Path, state: DrapedState) -> None:
    """Write a state bit for bit as HDF5."""
    garment = state.garment
    with atomic_path(path) as temporary, h5py.File(temporary, "w") as file:
        file.attrs["format"] = FORMAT
        file.attrs["panels"] = json.dumps(list(garment.panels))
        file.attrs["settings"] = json.dumps(to_plain(state.settings), sort_keys=True)
        for name in ("vertices", "faces", "rest_positions", "rest_faces", "face_panels"):
            file[f"garment/{name}"] = np.asarray(getattr(garment, name))
        for name in _ARRAYS:
            file[f"garment/{name}"] = np.asarray(getattr(state, name))
        file["body/vertices"] = np.asarray(state.body_vertices, np.float64)
        file["body/faces"] = np.asarray(state.body_faces)


def read_state(path: str | Path) -> DrapedState:
    """Read what `write_state` wrote.

    Raises:
        InputError: the file is missing, damaged or of another format.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(
            "there is no such file", where=str(path), mend="give a folder that `drape` has written"
        )
    try:
        with h5py.File(path, "r") as file:
            version = int(np.asarray(file.attrs["format"]))
            panels = tuple(json.loads(str(file.attrs["panels"])))
            settings = json.loads(str(file.attrs["settings"]))
            arrays = {name: _array(file, f"garment/{name}") for name in _group(file, "garment")}
            body = _array(file, "body/vertices"), _array(file, "body/faces")
        if version != FORMAT:
            raise InputError(
                f"has format {version}, this version reads {FORMAT}",
                where=str(path),
                mend="drape again",
            )
        own = {name: arrays.pop(name) for name in _ARRAYS}
        garment = GarmentMesh(panels=panels, **arrays)
    except (OSError, KeyError, TypeError, json.JSONDecodeError) as error:
        raise InputError(
            "is no draped garment, or is damaged", where=str(path), mend="drape again"
        ) from error
    return DrapedState(
        garment=garment, body_vertices=body[0], body_faces=body[1], settings=settings, **own
    )


def read_result(folder: str | Path) -> tuple[DrapedState, Pattern]:
    """The state and the pattern of a result folder.

    Raises:
        InputError: the folder or one of the two files is missing or damaged.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(
            "there is no such folder", where=str(folder), mend="give one that `drape` has written"
        )
    return read_state(folder / "drape.h5"), load_pattern(folder / "pattern.json")


def _group(file: h5py.File, key: str) -> list[str]:
    group: Any = file[key]
    return list(group)


def _array(file: h5py.File, key: str) -> np.ndarray:
    dataset: Any = file[key]
    return dataset[()]
