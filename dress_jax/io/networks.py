"""The embedded networks; their origins and licences stand beside them in `vision/data`."""

import functools
import importlib.resources
import json
from pathlib import Path

import numpy as np

from dress_jax.core.errors import InputError
from dress_jax.io.arrays import read_npz
from dress_jax.vision.networks import Network, graph_from_document

MATTING = "u2netp.npz"
LANDMARKS = "blazepose_full.npz"


@functools.cache
def load_matting_network() -> Network:
    """U^2-Net p: a picture of 320 x 320 px to the coverage by what stands out (Qin et al. 2020)."""
    return _embedded(MATTING)


@functools.cache
def load_landmark_network() -> Network:
    """BlazePose GHUM full: a square of 256 x 256 px around a person to 39 landmarks."""
    return _embedded(LANDMARKS)


def read_network(path: str | Path) -> Network:
    """A network as `vision.bake` writes it: its graph as JSON, and one array per weight.

    Raises:
        InputError: the file is missing or no such archive.
    """
    arrays = read_npz(path)
    try:
        document = json.loads(arrays.pop("graph").tobytes())
    except (KeyError, ValueError) as error:
        raise InputError(
            "holds no network",
            where=str(path),
            mend="make it with `python -m dress_jax.vision.bake`",
        ) from error
    weights = {name: array.astype(np.float32) for name, array in arrays.items()}
    return Network(graph_from_document(document), weights)


def _embedded(name: str) -> Network:
    resource = importlib.resources.files("dress_jax.vision") / "data" / name
    with importlib.resources.as_file(resource) as path:
        return read_network(path)
