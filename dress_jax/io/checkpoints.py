"""Checkpoints: any pytree of arrays, bit for bit, in one HDF5 file."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import h5py
import jax
import jax.numpy as jnp
import numpy as np

from dress_jax.core.errors import InputError
from dress_jax.io.atomic import atomic_path
from dress_jax.io.documents import to_plain

T = TypeVar("T")
FORMAT = 1


def save_checkpoint(
    path: str | Path, tree: Any, *, metadata: Mapping[str, Any] | None = None
) -> None:
    """Write every leaf of a pytree; an earlier file stays until the new one is complete.

    Args:
        path: the `.h5` file.
        tree: leaves are arrays or numbers.
        metadata: small values that JSON can hold (iteration, options).

    Raises:
        ValueError: a leaf is no array of numbers, or the metadata has no JSON form.
        InputError: the place cannot be written to.
    """
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    arrays = [(jax.tree_util.keystr(key), np.asarray(leaf)) for key, leaf in leaves]
    for name, array in arrays:
        if array.dtype.kind not in "biufc":
            raise ValueError(f"leaf {name or 'at the top'} holds {array.dtype}, not numbers")
    text = json.dumps(to_plain(metadata or {}), sort_keys=True, allow_nan=False)
    with atomic_path(path) as temporary, h5py.File(temporary, "w") as file:
        file.attrs["format"] = FORMAT
        file.attrs["metadata"] = text
        for number, (name, array) in enumerate(arrays):
            dataset = file.create_dataset(f"leaf_{number:05d}", data=array)
            dataset.attrs["path"] = name


def checkpoint_metadata(path: str | Path) -> dict[str, Any]:
    """A checkpoint's metadata alone, which may say what its tree looks like.

    Raises:
        InputError: the file is missing, damaged or no checkpoint.
    """
    return _read(Path(path))[1]


def load_checkpoint(path: str | Path, like: T) -> tuple[T, dict[str, Any]]:
    """Read a checkpoint into the structure of `like`.

    Args:
        path: the file.
        like: a pytree of the same structure, shapes and types; its values are not used.

    Returns:
        The tree with the stored values (JAX arrays where `like` has them, numpy otherwise), and the
        metadata.

    Raises:
        InputError: the file is missing, no checkpoint, or its structure differs from `like`; names
            the first leaf that does.
    """
    path = Path(path)
    stored, metadata = _read(path)
    expected, structure = jax.tree_util.tree_flatten_with_path(like)
    names = [jax.tree_util.keystr(key) for key, _ in expected]
    _check(path, stored, names, [leaf for _, leaf in expected])
    leaves = [
        jnp.asarray(array) if isinstance(leaf, jax.Array) else _as(leaf, array)
        for (_, array), (_, leaf) in zip(stored, expected, strict=True)
    ]
    return jax.tree_util.tree_unflatten(structure, leaves), metadata


def _read(path: Path) -> tuple[list[tuple[str, Any]], dict[str, Any]]:
    """Leaves with their places in the tree, and the metadata."""
    if not path.is_file():
        raise InputError("there is no such checkpoint", where=str(path), mend="check the path")
    try:
        with h5py.File(path, "r") as file:
            version = file.attrs.get("format")
            stored = [(str(d.attrs["path"]), d[()]) for _, d in sorted(file.items())]
            metadata = json.loads(str(file.attrs["metadata"]))
    except (OSError, KeyError, AttributeError, json.JSONDecodeError) as error:
        raise InputError(
            "is not a checkpoint, or is damaged", where=str(path), mend="start without it"
        ) from error
    if version != FORMAT:
        raise InputError(
            f"has checkpoint format {version}, this version reads {FORMAT}",
            where=str(path),
            mend="start without it",
        )
    return stored, metadata


def _as(leaf: Any, array: Any) -> Any:
    return np.asarray(array) if isinstance(leaf, np.ndarray) else type(leaf)(array)


def _check(path: Path, stored: list[tuple[str, Any]], names: list[str], leaves: list[Any]) -> None:
    mend = "use the pattern, body and options that the checkpoint was written with"
    stored_names = [name for name, _ in stored]
    if stored_names != names:
        missing = [name for name in names if name not in stored_names]
        surplus = [name for name in stored_names if name not in names]
        raise InputError(
            f"has another structure (missing: {missing or 'nothing'}, "
            f"not expected: {surplus or 'nothing'})",
            where=str(path),
            mend=mend,
        )
    for (name, array), leaf in zip(stored, leaves, strict=True):
        found, wanted = np.asarray(array), np.asarray(leaf)
        if found.shape != wanted.shape or found.dtype != wanted.dtype:
            raise InputError(
                f"holds {found.dtype} of shape {found.shape}, expected {wanted.dtype} of shape "
                f"{wanted.shape}",
                where=f"{path}, {name or 'top'}",
                mend=mend,
            )
