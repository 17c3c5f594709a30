"""Bundles as one HDF5 file, or as a folder of PNG, JSON and npz files.

A folder holds
    bundle.json    names, sources, cameras, the body; written last, so a folder that has it is
                   complete
    pattern.json   the pattern, for every program that reads specifications
    image.png, matte.png, labels.png, views/NAME/rgb.png ...   every 8-bit picture
    arrays.npz     landmarks, surfaces, normals; plain arrays, nothing is pickled
"""

import json
import zipfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from dress_jax.capture.bundle import Bundle
from dress_jax.core.errors import InputError
from dress_jax.io.atomic import atomic_path
from dress_jax.io.capture.pictures import write_pixels
from dress_jax.io.capture.records import from_record, to_record
from dress_jax.io.documents import read_json, write_json
from dress_jax.io.images import opened

HDF5_SUFFIXES = (".h5", ".hdf5")
DOCUMENT, PATTERN, ARRAYS = "bundle.json", "pattern.json", "arrays.npz"
_MARK = "dress_jax observation bundle"


def is_bundle(path: str | Path) -> bool:
    """Whether a path is a saved bundle of either form, going by its name and its marker."""
    path = Path(path)
    return path.suffix.lower() in HDF5_SUFFIXES or (path / DOCUMENT).is_file()


def save_bundle(path: str | Path, bundle: Bundle) -> None:
    """Write a bundle: HDF5 where the name ends in .h5 or .hdf5, a folder otherwise.

    A file is replaced at once. In a folder every file is, and its document comes last: until then
    the folder is no bundle.

    Raises:
        InputError: the place cannot be written to.
    """
    path = Path(path)
    document, arrays = to_record(bundle)
    if path.suffix.lower() in HDF5_SUFFIXES:
        with atomic_path(path) as temporary, h5py.File(temporary, "w") as file:
            file.attrs["kind"] = _MARK
            # A dataset, because attributes are limited to 64 KiB.
            file["document"] = json.dumps(document, allow_nan=False)
            for name, array in arrays.items():
                packed = {"compression": "gzip", "shuffle": True} if array.size else {}
                file.create_dataset(f"arrays/{name}", data=array, **packed)
        return
    if path.is_dir():
        # What it says belongs to the files that are about to be replaced.
        (path / DOCUMENT).unlink(missing_ok=True)
    pictures = {name: array for name, array in arrays.items() if _is_picture(name, array)}
    for name, array in pictures.items():
        write_pixels(path / f"{name}.png", array)
    others = {name: array for name, array in arrays.items() if name not in pictures}
    with atomic_path(path / ARRAYS) as temporary:
        np.savez_compressed(temporary, **others)  # pyright: ignore[reportArgumentType]
    pattern = document.pop("pattern")
    if pattern is not None:
        write_json(path / PATTERN, pattern)
    document |= {"pictures": sorted(pictures), "arrays": sorted(others), "kind": _MARK}
    write_json(path / DOCUMENT, {**document, "has_pattern": pattern is not None})


def load_bundle(path: str | Path) -> Bundle:
    """Read what `save_bundle` wrote, of either form.

    Raises:
        InputError: there is no bundle, it is damaged, or of another format.
    """
    path = Path(path)
    if path.is_dir():
        return _load_folder(path)
    if not path.is_file():
        raise InputError("there is no such bundle", where=str(path), mend="check the path")
    return _load_file(path)


def _load_file(path: Path) -> Bundle:
    arrays: dict[str, np.ndarray] = {}

    def collect(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            arrays[name] = item[()]

    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("kind") != _MARK:
                raise InputError(
                    "is no observation bundle", where=str(path), mend="give one that `bundle` wrote"
                )
            text: Any = file["document"]
            document = json.loads(text.asstr()[()])
            group: Any = file.get("arrays", {})
            if isinstance(group, h5py.Group):
                group.visititems(collect)
    except (OSError, KeyError, AttributeError, json.JSONDecodeError) as error:
        raise InputError(
            "is no observation bundle, or is damaged", where=str(path), mend="make it again"
        ) from error
    return from_record(document, arrays, source=str(path))


def _load_folder(path: Path) -> Bundle:
    if not (path / DOCUMENT).is_file():
        raise InputError(
            f"holds no {DOCUMENT}", where=str(path), mend="give a folder that `bundle` wrote"
        )
    document = read_json(path / DOCUMENT, what="an observation bundle")
    names = document.get("pictures"), document.get("arrays")
    if not all(isinstance(n, list) and all(isinstance(i, str) for i in n) for n in names):
        raise InputError(
            "does not list its pictures and arrays",
            where=str(path / DOCUMENT),
            mend="make the bundle again",
        )
    arrays = {}
    for name in document["pictures"]:
        with opened(path / f"{name}.png") as image:
            arrays[name] = np.array(image)
    try:
        with np.load(path / ARRAYS, allow_pickle=False) as stored:
            arrays |= {name: stored[name] for name in document["arrays"]}
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(
            "is missing, damaged, or lacks an array",
            where=str(path / ARRAYS),
            mend="make the bundle again",
        ) from error
    if document.get("has_pattern"):
        document["pattern"] = read_json(path / PATTERN, what="a sewing pattern")
    return from_record(document, arrays, source=str(path))


def _is_picture(name: str, array: np.ndarray) -> bool:
    return array.dtype == np.uint8 and name.split("/")[0] in ("image", "matte", "labels", "views")
