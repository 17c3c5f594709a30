"""The table, and what it was measured on."""

import importlib.metadata
import os
import platform
from collections.abc import Iterable
from pathlib import Path
from typing import Any

OWN = "dress_jax"
_HEAD = (
    f"{'scene':7s} {'contestant':15s} {'steps':>5s} {'iter.':>6s} {'ms/iter.':>9s} {'ratio':>6s} "
    f"{'seconds':>8s} {'ratio':>6s} {'cpu s':>7s} {'MB':>5s} {'contacts':>8s} "
    f"{'energy J':>11s} {'mm':>7s} {'crossings':>9s} {'gradient':>8s} {'forward':>7s}  note"
)


def head(vertices: int) -> str:
    """Of a table."""
    return f"\n{vertices} vertices\n{_HEAD}"


def machine() -> dict[str, Any]:
    """What the times belong to."""
    model = platform.processor() or platform.machine()
    information = Path("/proc/cpuinfo")
    if information.exists():
        lines = information.read_text().splitlines()
        model = next((s.split(":", 1)[1].strip() for s in lines if s.startswith("model name")), "")
    return {
        "processor": model,
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None,
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "system": platform.platform(),
        "python": platform.python_version(),
    }


def versions(packages: Iterable[str]) -> dict[str, str]:
    """Of the packages that are installed."""
    found = {}
    for package in sorted(set(packages)):
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def per_iteration(row: dict[str, Any]) -> float:
    """Seconds of a Newton iteration."""
    return row["seconds"] / max(row["iterations"], 1)


def line(row: dict[str, Any], own: dict[str, Any] | None) -> str:
    """One row; ratios to dress_jax where both did the same.

    Args:
        row: of a contestant.
        own: the row of dress_jax on the same scene, if there is one.
    """
    left = f"{row['scene']:7s} {row['contestant']:15s}"
    if "fault" in row:
        return f"{left} {row['fault']}"
    own = None if own is None or "fault" in own else own
    newton = not row["contestant"].startswith("newton")
    each = f"{1e3 * per_iteration(row):9.1f}" if newton else f"{'':9s}"
    each_ratio = f"{per_iteration(row) / per_iteration(own):6.2f}" if newton and own else f"{'':6s}"
    comparable = own is not None and own["converged"] and row["converged"]
    total_ratio = f"{row['seconds'] / own['seconds']:6.2f}" if comparable and own else f"{'':6s}"
    gradient, share = f"{'':8s}", f"{'':7s}"
    if row["gradient_seconds"] is not None:
        gradient = f"{row['gradient_seconds']:7.2f}s"
        share = f"{100.0 * row['gradient_seconds'] / row['seconds']:6.1f}%"
    return (
        f"{left} {row['steps']:5d} {row['iterations']:6d} {each} {each_ratio} "
        f"{row['seconds']:8.2f} {total_ratio} {row['cpu_seconds']:7.2f} "
        f"{row['peak_memory_mb']:5.0f} "
        f"{row['contacts']:8d} {row['energy']:11.7f} {1e3 * row['smallest_distance']:7.4f} "
        f"{row['self_intersections']:4d}+{row['body_intersections']:<4d} {gradient} {share}  "
        f"{row['note']}"
    )
