"""A fit that can be stopped and resumed: what is kept on disk, and whether it still belongs (S9).

    start.h5        the initial drape: mesh, pins, body
    mesh_1.h5 ...   the garment as it was put on again with a new mesh (S13), if it was
    checkpoint.h5   state of the fit after some iteration, and its history

All are exact, and nothing else of a run enters the next iteration, so a resumed fit repeats an
uninterrupted one bit by bit on the same machine.
"""

import dataclasses
import hashlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dress_jax.application.targets import TargetViews
from dress_jax.application.wearer import Wearer
from dress_jax.core.errors import InputError
from dress_jax.io.checkpoints import checkpoint_metadata, load_checkpoint, save_checkpoint
from dress_jax.io.results import DrapedState, read_state, write_state
from dress_jax.optimisation import AnyState, FitInfo, FitProblem, blank_state
from dress_jax.pattern import Pattern, PatternParameters

START, CHECKPOINT, MESH = "start.h5", "checkpoint.h5", "mesh_{}.h5"

History = list[dict[str, Any]]


@dataclasses.dataclass(frozen=True)
class Course:
    """What happened in a fit, as plain values.

    Attributes:
        history: one record per iteration.
        remeshed: one record per attempt at a new mesh.
        refreshed: how many of them followed a rest.
        mesh: number of the mesh in use; 0 is the first.
        borne: distortion up to which no new mesh is asked for; None for the option's.
    """

    history: History = dataclasses.field(default_factory=list)
    remeshed: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    refreshed: int = 0
    mesh: int = 0
    borne: float | None = None


def fingerprint(*parts: Any) -> str:
    """A short digest of everything a fit depends on: texts, numbers, arrays, trees of them."""
    digest = hashlib.sha256()
    leaves, structure = jax.tree.flatten(parts)
    digest.update(str(structure).encode())
    for leaf in leaves:
        if isinstance(leaf, (jax.Array, np.ndarray)):
            array = np.ascontiguousarray(leaf)
            digest.update(f"{array.dtype}{array.shape}".encode())
            digest.update(array.tobytes())
        else:
            digest.update(repr(leaf).encode())
    return digest.hexdigest()[:16]


def fit_fingerprint(
    pattern: Pattern, wearer: Wearer, views: TargetViews, *options: Any
) -> dict[str, str]:
    """Digests of the inputs of a fit by name, so that a difference can be named."""
    shape = [(p.name, p.vertices, [(e.kind, e.controls) for e in p.edges]) for p in pattern.panels]
    seams = [repr(stitch) for stitch in pattern.stitches]
    scan = None if views.scan is None else (views.scan.points, views.scan.complete)
    landmarks = [repr(mark) for mark in views.landmarks]
    return {
        "pattern": fingerprint(shape, seams),
        "body": fingerprint(wearer.start, wearer.way, wearer.faces),
        "targets": fingerprint(views.observation, scan, landmarks),
        "options": fingerprint([repr(option) for option in options]),
    }


def save_start(folder: Path, state: DrapedState, identity: dict[str, str]) -> None:
    """Write the initial drape; a checkpoint of an earlier fit is removed."""
    (folder / CHECKPOINT).unlink(missing_ok=True)
    settings = {**state.settings, "identity": identity}
    write_state(folder / START, _with_settings(state, settings))


def load_start(folder: Path, identity: dict[str, str]) -> DrapedState:
    """Read the initial drape of a fit that is resumed.

    Raises:
        InputError: there is none, or it belongs to other inputs.
    """
    if not (folder / START).is_file():
        raise InputError("there is nothing to resume", where=str(folder), mend="leave --resume out")
    state = read_state(folder / START)
    kept = state.settings.get("identity", {})
    different = sorted(name for name in identity if kept.get(name) != identity[name])
    if different:
        raise InputError(
            f"the fit to resume had another {' and '.join(different)}",
            where=str(folder),
            mend="give what it was started with, or leave --resume out",
        )
    settings = {key: value for key, value in state.settings.items() if key != "identity"}
    return _with_settings(state, settings)


def save_mesh(folder: Path, number: int, state: DrapedState, meshed: PatternParameters) -> None:
    """Write the garment of a new mesh, and the pattern that was meshed.

    Args:
        folder: of the fit.
        number: of the mesh, from 1.
        state: the garment as it was put on.
        meshed: parameters of the pattern.
    """
    values = {"vertices": meshed.vertices, "controls": meshed.controls}
    settings = {name: np.asarray(array).tolist() for name, array in values.items()}
    write_state(
        folder / MESH.format(number), _with_settings(state, {**state.settings, "meshed": settings})
    )


def load_mesh(folder: Path, number: int) -> tuple[DrapedState, PatternParameters]:
    """The inverse of `save_mesh`.

    Raises:
        InputError: the file is missing or damaged.
    """
    path = folder / MESH.format(number)
    state = read_state(path)
    meshed = state.settings.get("meshed")
    if meshed is None:
        raise InputError("does not say what was meshed", where=str(path), mend="start again")
    settings = {key: value for key, value in state.settings.items() if key != "meshed"}
    parameters = PatternParameters(
        vertices=jnp.asarray(meshed["vertices"]), controls=jnp.asarray(meshed["controls"])
    )
    return _with_settings(state, settings), parameters


def save_progress(folder: Path, begin: AnyState, state: AnyState, course: Course) -> None:
    """Write a checkpoint: the first state (to compare with), the current one, and the course."""
    save_checkpoint(
        folder / CHECKPOINT,
        {"begin": begin, "state": state},
        metadata=dataclasses.asdict(course),
    )


def load_course(folder: Path) -> Course | None:
    """What happened until the checkpoint; None where there is none.

    Raises:
        InputError: the checkpoint is damaged.
    """
    path = folder / CHECKPOINT
    return Course(**checkpoint_metadata(path)) if path.is_file() else None


def load_progress(
    folder: Path, first: FitProblem, current: FitProblem
) -> tuple[AnyState, AnyState]:
    """First and current state of a checkpoint.

    Args:
        folder: of the fit.
        first, current: the problems on the first and on the checkpoint's mesh.

    Raises:
        InputError: the checkpoint is damaged or does not fit the problems.
    """
    like = {"begin": blank_state(first), "state": blank_state(current)}
    tree, _ = load_checkpoint(folder / CHECKPOINT, like)
    return tree["begin"], tree["state"]


def as_record(info: FitInfo, state: AnyState) -> dict[str, Any]:
    """One iteration as plain values; what was not computed is None."""
    return {
        "iteration": info.iteration,
        "outcome": info.outcome.name.lower(),
        "loss": finite_or_none(info.loss),
        "terms": {name: finite_or_none(value) for name, value in info.terms.items()},
        "iou": finite_or_none(info.iou),
        "newton_iterations": info.newton_iterations,
        "remaining_step_m": finite_or_none(info.remaining_step),
        "intersections": info.intersections,
        "guided_rounds": info.guided_rounds,
        "rate_scale": info.rate_scale,
        "cost": finite_or_none(info.cost),
        "outline_m": finite_or_none(info.outline),
        "damping": finite_or_none(info.damping),
        "unfinished_contours": info.unfinished,
        "log_stiffness": np.asarray(state.unknowns.log_stiffness).tolist(),
        "seconds": {name: finite_or_none(value) for name, value in info.seconds.items()},
    }


def last_loss(history: Sequence[dict[str, Any]]) -> float | None:
    """The loss of the last step that had one."""
    return next((h["loss"] for h in reversed(history) if h["loss"] is not None), None)


def finite_or_none(value: float) -> float | None:
    """A value that JSON can hold: None for what is not finite."""
    return float(value) if math.isfinite(value) else None


def _with_settings(state: DrapedState, settings: dict[str, Any]) -> DrapedState:
    return dataclasses.replace(state, settings=settings)
