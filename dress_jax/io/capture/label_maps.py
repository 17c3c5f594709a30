"""Label maps of clothes: one for the photograph, or a folder with one per view (S10.3)."""

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from dress_jax.capture.bundle import Bundle
from dress_jax.capture.labels import convert_labels, label_table
from dress_jax.capture.views import View, with_labels
from dress_jax.core.errors import InputError
from dress_jax.io.capture.fields import within
from dress_jax.io.capture.pictures import read_ids

SUFFIXES = (".png", ".npy")


def read_labels(path: str | Path, table: str) -> UInt8[np.ndarray, "h w"]:
    """Our labels out of a palette PNG, a grey PNG of ids, or an npy array.

    Args:
        path: the file.
        table: whose ids they are, a key of `capture.labels.TABLES`.

    Raises:
        InputError: the file cannot be read as ids, or the table lacks one of them.
    """
    label_table(table)  # before the file: it may not be the file's fault
    ids = read_ids(path)
    with within(path):
        return convert_labels(ids, table)


def read_label_map(path: str | Path, table: str) -> Bundle:
    """A bundle that holds the labels of the photograph.

    Raises:
        InputError: see `read_labels`.
    """
    return Bundle(labels=read_labels(path, table), sources={"labels": f"label map ({table})"})


def label_views(bundle: Bundle, folder: str | Path, table: str) -> Bundle:
    """Give every view of a bundle its masks, from files named like the views (`018.png`).

    Args:
        bundle: with views.
        folder: one label map per view.
        table: see `read_labels`.

    Raises:
        InputError: the bundle has no views, a map is missing or of another size, or ids are
            unknown.
    """
    folder = Path(folder)
    if not bundle.views:
        raise InputError(
            "holds one label map per view, but there are no views",
            where=str(folder),
            mend="add the views first, or give one file for the photograph",
        )
    views = tuple(_labelled(view, folder, table) for view in bundle.views)
    source = f"{bundle.sources.get('views', 'views')}, label maps ({table})"
    return dataclasses.replace(bundle, views=views, sources={**bundle.sources, "views": source})


def _labelled(view: View, folder: Path, table: str) -> View:
    for suffix in SUFFIXES:
        path = folder / f"{view.name}{suffix}"
        if path.is_file():
            return with_labels(view, read_labels(path, table))
    raise InputError(
        f"holds no label map of view '{view.name}'",
        where=str(folder),
        mend=f"add {view.name}{SUFFIXES[0]} or {view.name}{SUFFIXES[1]}",
    )
