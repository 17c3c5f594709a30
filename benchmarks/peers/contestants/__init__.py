"""The contestants by name; each is imported in its own process only."""

import importlib

from benchmarks.peers.record import Contestant

NAMES = {
    "dress_jax": "dress",
    "ipctk": "ipctk_baseline",
    "warp": "warp_baseline",
    "newton-style3d": "newton_style3d",
    "newton-vbd": "newton_vbd",
}


def make(name: str) -> Contestant:
    """A contestant.

    Raises:
        ImportError: a package that it needs is not installed.
    """
    return importlib.import_module(f"{__name__}.{NAMES[name]}").make()
