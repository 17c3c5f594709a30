"""A draped garment on its wearer in motion (S15): bodies, implicit steps, and exact resume.

`work/` in the result folder holds what a run needs to go on: `bodies.h5` with the bodies of all
frames and digests of the inputs, and the state at the end of every frame. Nothing else of a run
enters the next frame, so a resumed run repeats an uninterrupted one bit by bit on the same machine.
"""

import dataclasses
import time
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from dress_jax.application.fit_session import fingerprint
from dress_jax.application.gradcheck import simulation_of
from dress_jax.application.moving_body import (
    MotionOptions,
    find_motion,
    find_rig,
    freed_report,
    moving_bodies,
)
from dress_jax.application.progress import Progress, silent
from dress_jax.core.errors import InputError
from dress_jax.core.precision import require_float64
from dress_jax.geometry.topology import connected_components
from dress_jax.io.checkpoints import checkpoint_metadata, load_checkpoint, save_checkpoint
from dress_jax.io.results import DrapedState
from dress_jax.motion.clip import Motion
from dress_jax.motion.repulsion import RepulsionOptions
from dress_jax.sim.animation import (
    NEWTON,
    AnimationOptions,
    FrameRecord,
    advance_frame,
    renewed,
)
from dress_jax.sim.riding import Carrier, make_riders
from dress_jax.sim.solve import State
from dress_jax.solver import NewtonOptions

WORK, BODIES, FRAME = "work", "bodies.h5", "frame_{:05d}.h5"
SLIPPED = 0.10
"""Way of a component along the body from which it counts as slipping off [m]."""
_ON_BODY = 0.02  # cloth this close to the body at first tells how a garment slips [m]


@dataclasses.dataclass(frozen=True)
class AnimateOptions:
    """How a garment is animated.

    Attributes:
        motion: which part of the motion is played.
        repulsion: how bodies are freed of self-intersection; None leaves them as they are.
        friction: whether friction acts, with the fabric's coefficient.
        steps: implicit steps of a frame.
        newton: stopping rule of a step.
    """

    motion: MotionOptions = dataclasses.field(default_factory=MotionOptions)
    repulsion: RepulsionOptions | None = dataclasses.field(default_factory=RepulsionOptions)
    friction: bool = True
    steps: int = 1
    newton: NewtonOptions = NEWTON


@dataclasses.dataclass(frozen=True)
class Animation:
    """A garment in motion.

    Attributes:
        state: the drape that it began with.
        motion: of the body.
        frames: cloth positions [m], (t, n, 3).
        bodies: of all frames [m], (t, b, 3).
        records: one per frame after the first, as plain values.
        report: numbers for `report.json`.
    """

    state: DrapedState
    motion: Motion
    frames: Float[np.ndarray, "t n 3"]
    bodies: Float[np.ndarray, "t b 3"]
    records: list[dict[str, Any]]
    report: dict[str, Any]

    @property
    def good(self) -> bool:
        """Every frame free of intersections, every step converged."""
        return all(
            not (r["self_intersections"] or r["body_intersections"] or r["unconverged"])
            for r in self.records
        )


def animate(
    state: DrapedState,
    motion: str | Path,
    folder: str | Path,
    *,
    options: AnimateOptions | None = None,
    resume: bool = False,
    progress: Progress = silent,
) -> Animation:
    """Move the wearer of a draped garment; every frame is free of intersections.

    Args:
        state: from `io.results.read_result`.
        motion: "walk", "turn", "sway", or an AMASS, AIST++ or BVH file.
        folder: for `work/`.
        options: see `AnimateOptions`.
        resume: go on where an earlier run in the folder stopped.
        progress: told about every body and every frame.

    Raises:
        InputError: the body or the motion cannot be used, there is nothing to resume, or it had
            other inputs; or the body cannot move on, with the frame and the panels.
        RuntimeError: 64-bit arrays are off.
    """
    require_float64("animate")
    options = AnimateOptions() if options is None else options
    work = Path(folder) / WORK
    rig = find_rig(state)
    clip = find_motion(motion, rig, options.motion)
    identity = {
        "garment": fingerprint(state.garment.vertices, state.garment.faces, dict(state.settings)),
        "motion": fingerprint(clip.pose, clip.root, clip.fps),
        "options": fingerprint([repr(dataclasses.replace(options, motion=MotionOptions()))]),
    }
    if resume:
        bodies, body_report = _resumed_bodies(
            work, identity, (clip.frames, *state.body_vertices.shape)
        )
    else:
        _clear(work)
        bodies, freed = moving_bodies(state, rig, clip, options.repulsion, progress=progress)
        body_report = freed_report(freed)
        save_checkpoint(
            work / BODIES,
            {"bodies": bodies},
            metadata={"identity": identity, "report": body_report},
        )
    frames, records = _run(state, clip, bodies, work, options, resume, progress)
    report = _report(state, clip, frames, bodies, records, body_report, options)
    return Animation(state, clip, frames, bodies, records, report)


def _run(
    state: DrapedState,
    clip: Motion,
    bodies: np.ndarray,
    work: Path,
    options: AnimateOptions,
    resume: bool,
    progress: Progress,
) -> tuple[np.ndarray, list[dict[str, Any]]]:
    garment = state.garment
    simulator, parameters = simulation_of(state, options.newton, friction=options.friction)
    rest = garment.rest_positions[garment.rest_faces]
    edges = np.linalg.norm(rest - np.roll(rest, 1, axis=1), axis=2)
    carrier = Carrier(garment.faces, state.body_faces, float(edges.mean()))
    riders = make_riders(state.pin_targets, state.body_vertices, state.body_faces)
    start = jnp.asarray(garment.vertices)
    now = State(start, jnp.zeros_like(start))
    frames, records = [np.asarray(garment.vertices)], []
    last = len(bodies) - 1
    for number in range(1, len(bodies)):
        path = work / FRAME.format(number)
        if resume and path.is_file():
            now, metadata = load_checkpoint(path, now)
            record = metadata["record"]
        else:
            resume = False  # later frames in the folder belong to another run
            began = time.monotonic()
            try:
                now, found = advance_frame(
                    renewed(simulator),
                    parameters,
                    now,
                    bodies[number - 1],
                    bodies[number],
                    seconds=1.0 / clip.fps,
                    carrier=carrier,
                    riders=riders,
                    options=AnimationOptions(steps=options.steps),
                )
            except InputError as error:
                raise InputError(
                    f"frame {number} of {last}: {error.problem}",
                    where=error.where,
                    mend=error.mend,
                ) from error
            record = {
                **dataclasses.asdict(found),
                "smallest_distance": _finite(found),
                "seconds": time.monotonic() - began,
            }
            save_checkpoint(path, now, metadata={"record": record})
        frames.append(np.asarray(now.positions))
        records.append(record)
        progress("animate", number, last)
    return np.stack(frames), records


def _finite(record: FrameRecord) -> float | None:
    distance = record.smallest_distance
    return float(distance) if np.isfinite(distance) else None


def _clear(work: Path) -> None:
    """Remove what an earlier run has left; the bodies last are the ones that make it resumable."""
    for path in sorted(work.glob("*.h5")):
        path.unlink()


def _resumed_bodies(
    work: Path, identity: dict[str, str], shape: tuple[int, ...]
) -> tuple[np.ndarray, dict[str, Any]]:
    path = work / BODIES
    if not path.is_file():
        raise InputError(
            "there is nothing to resume", where=str(work.parent), mend="leave --resume out"
        )
    kept = checkpoint_metadata(path).get("identity", {})
    different = sorted(name for name in identity if kept.get(name) != identity[name])
    if different:
        raise InputError(
            f"the run to resume had another {' and '.join(different)}",
            where=str(work.parent),
            mend="give what it was started with, or leave --resume out",
        )
    tree, metadata = load_checkpoint(path, {"bodies": np.zeros(shape)})
    return tree["bodies"], metadata["report"]


def _report(
    state: DrapedState,
    clip: Motion,
    frames: np.ndarray,
    bodies: np.ndarray,
    records: list[dict[str, Any]],
    body_report: dict[str, Any],
    options: AnimateOptions,
) -> dict[str, Any]:
    def total(name: str) -> int:
        return sum(record[name] for record in records)

    per_frame = {name: [record[name] for record in records] for name in records[0]}
    return {
        "motion": clip.name,
        "fps": clip.fps,
        "frames": len(frames),
        "vertices": len(state.garment.vertices),
        "faces": len(state.garment.faces),
        "intersections": {"self": total("self_intersections"), "body": total("body_intersections")},
        "steps": total("steps"),
        "halved_steps": {"body": total("blocked"), "newton": total("halved")},
        "unconverged_steps": total("unconverged"),
        "squeezed_steps": total("squeezed"),
        "newton_iterations": total("newton_iterations"),
        "simulation_seconds": total("seconds"),
        "per_frame": per_frame,
        "body": body_report,
        "waist": _waist(state),
        "slip": slip_along_body(state, frames[-1], bodies[-1]),
        "friction": options.friction,
        "steps_per_frame": options.steps,
        "settings": dict(state.settings),
    }


def _waist(state: DrapedState) -> dict[str, Any]:
    """How the garment is held in motion."""
    count = len(state.pins)
    held = "pins that ride on the body" if count else "nothing but the body's shape and friction"
    return {"held_by": held, "vertices": count}


def slip_along_body(
    state: DrapedState, cloth: Float[np.ndarray, "n 3"], body: Float[np.ndarray, "b 3"]
) -> list[dict[str, Any]]:
    """How far every component of a garment has moved along the body it was draped on.

    Of the vertices that lay on the body at first, how far each is from where it would be had it
    stayed there; the median tells a garment that slips off from one that swings.

    Args:
        state: the drape.
        cloth, body: later [m].

    Returns:
        One row per component: its panels, vertices on the body, median and largest way [m], and
        whether it counts as slipped; the ways are None where nothing lay on the body.
    """
    garment = state.garment
    riders = make_riders(garment.vertices, state.body_vertices, state.body_faces)
    on_body = np.linalg.norm(riders.offsets, axis=1) < _ON_BODY
    way = np.linalg.norm(riders.places(body) - cloth, axis=1)
    component = connected_components(garment.faces, len(garment.vertices))
    rows = []
    for number in np.unique(component):
        own = component == number
        panels = np.unique(garment.face_panels[own[garment.faces[:, 0]]])
        chosen = way[own & on_body]
        median = float(np.median(chosen)) if len(chosen) else None
        rows.append(
            {
                "panels": [garment.panels[panel] for panel in panels],
                "vertices": len(chosen),
                "median_m": median,
                "largest_m": float(chosen.max()) if len(chosen) else None,
                "slipped": median is not None and median > SLIPPED,
            }
        )
    return rows
