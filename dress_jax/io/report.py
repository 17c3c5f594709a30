"""`report.json`: what was run, with which versions, how it ended and what it cost."""

import importlib.metadata
import platform
import resource
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dress_jax import __version__
from dress_jax.io.documents import to_plain, write_json

PACKAGES = ("jax", "jaxlib", "numpy", "scipy", "h5py")


def environment() -> dict[str, Any]:
    """Versions and machine, for the report's `environment`."""
    versions = {}
    for package in PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = None
    return {
        "dress_jax": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "machine": platform.machine(),
        "packages": versions,
    }


def peak_memory_mb() -> float:
    """Largest resident memory of this process so far [MB]."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak / 1e3  # bytes there, kB elsewhere


def write_report(
    path: str | Path, content: Mapping[str, Any], *, nonfinite_to_null: bool = False
) -> None:
    """Write a report with sorted keys, adding `environment` and `peak_memory_mb`.

    Args:
        path: the file, replaced atomically.
        content: results; numpy and JAX values are allowed.
        nonfinite_to_null: write NaN and infinities as null; otherwise they are refused, so that a
            failed number is not mistaken for a missing one.

    Raises:
        ValueError: a number is not finite, or a type has no JSON form; the message names the key.
        InputError: the place cannot be written to.
    """
    document = {
        **to_plain(content, nonfinite_to_null=nonfinite_to_null),
        "environment": environment(),
        "peak_memory_mb": peak_memory_mb(),
    }
    write_json(path, document, sort_keys=True)
