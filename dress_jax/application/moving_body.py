"""The body of a result folder in motion: its rig, the poses of all frames, their surfaces (S15)."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dress_jax.application.progress import Progress, silent
from dress_jax.application.wearer import DEFAULT_BODY
from dress_jax.body.poses import named_pose
from dress_jax.core.errors import InputError
from dress_jax.io.bodies import body_from_argument
from dress_jax.io.motions.read import read_motion
from dress_jax.io.results import DrapedState
from dress_jax.motion.bodies import RiggedBody, posed_bodies
from dress_jax.motion.clip import Motion, eased, heading, lifted, placed
from dress_jax.motion.procedural import Procedure, procedural_motion
from dress_jax.motion.repulsion import Freed, Repulsion, RepulsionOptions
from dress_jax.motion.retarget import retarget

FPS, FRAMES, EASE = 30.0, 100, 0.8
_SAME = 1e-6  # largest distance of a body made again from the one in the folder [m]


@dataclasses.dataclass(frozen=True)
class MotionOptions:
    """Which part of a motion is played, and how it begins.

    Attributes:
        fps: frames per second.
        frames: how many, with the drape's own as the first; None for all of a file, and 100 of a
            motion made here.
        start: where a file is entered [s].
        ease: seconds from the drape's pose at rest into the motion.
    """

    fps: float = FPS
    frames: int | None = None
    start: float = 0.0
    ease: float = EASE

    def __post_init__(self) -> None:
        bad = {
            "--fps": not (np.isfinite(self.fps) and 1.0 <= self.fps <= 240.0),
            "--frames": self.frames is not None and self.frames < 2,
            "--start": not (np.isfinite(self.start) and self.start >= 0.0),
            "--ease": not (np.isfinite(self.ease) and self.ease >= 0.0),
        }
        for name, wrong in bad.items():
            if wrong:
                value = getattr(self, name.removeprefix("--"))
                raise InputError(
                    f"is {value}",
                    where=name,
                    mend="give 1 to 240 frames per second, 2 frames or more, seconds from 0 on",
                )


def find_rig(state: DrapedState) -> RiggedBody:
    """The rig of the body that a garment was draped on.

    Raises:
        InputError: the body is a static mesh, its files are gone, or it is another one now.
    """
    settings = state.settings
    body, pose = str(settings.get("body", "")), str(settings.get("pose", ""))
    loaded = body_from_argument(
        body or DEFAULT_BODY, pose=pose or "t", shape=str(settings.get("shape", "average"))
    )
    if loaded.model is None or loaded.pose is None or loaded.shape is None:
        raise InputError(
            "a static mesh cannot move",
            where=body,
            mend="drape on the default body, or on an SMPL-X .npz file",
        )
    dressing = named_pose(str(settings.get("dressing_pose", "")) or "t")
    rig = RiggedBody(loaded.model, loaded.pose if pose else dressing, loaded.shape, np.zeros(3))
    floor = rig.vertices(dressing, np.zeros(3))[:, 1].min()
    rig = dataclasses.replace(rig, translation=np.array([0.0, -floor, 0.0]))
    found = rig.vertices(rig.pose, np.zeros(3))
    same = found.shape == state.body_vertices.shape
    if not same or np.abs(found - state.body_vertices).max() > _SAME:
        raise InputError(
            "the body of the result is not the one that its settings name",
            where=body or DEFAULT_BODY,
            mend="drape again with the body and pose files as they are now",
        )
    return rig


def find_motion(motion: str | Path, rig: RiggedBody, options: MotionOptions) -> Motion:
    """A motion for a body, from the drape's pose on: a name of ours or a file.

    Args:
        motion: "walk", "turn", "sway", or an AMASS, AIST++ or BVH file.
        rig: the body in the drape's pose.
        options: see `MotionOptions`.

    Raises:
        InputError: an unknown name, an unusable file, or one that is shorter than asked for.
    """
    names = [procedure.value for procedure in Procedure]
    joints = rig.joints()
    if str(motion) in names:
        frames = FRAMES if options.frames is None else options.frames
        clip = procedural_motion(Procedure(str(motion)), joints, frames=frames, fps=options.fps)
    else:
        same_rest = rig.model.posedirs is not None
        clip = retarget(read_motion(motion, same_rest=same_rest), joints)
        if options.start >= clip.seconds:
            raise InputError(
                f"the clip is {clip.seconds:.2f} s long",
                where=str(motion),
                mend=f"give a --start below that, not {options.start}",
            )
        first = int(np.floor(options.start * clip.fps))
        clip = dataclasses.replace(clip, pose=clip.pose[first:], root=clip.root[first:])
        clip = clip.resampled(options.fps)
        lowest = posed_bodies(rig, clip)[:, :, 1].min(axis=1)
        clip = lifted(clip, lowest)
    ease = min(options.ease, 2.0 * clip.seconds)
    clip = eased(placed(clip, facing=heading(rig.pose)), rig.pose, np.zeros(3), seconds=ease)
    if options.frames is None:
        return clip if str(motion) not in names else _first(clip, FRAMES)
    if clip.frames < options.frames:
        raise InputError(
            f"has {clip.frames} frames at {options.fps:g} per second from {options.start:g} s on",
            where=str(motion),
            mend=f"give --frames {clip.frames} or fewer",
        )
    return _first(clip, options.frames)


def _first(clip: Motion, frames: int) -> Motion:
    return dataclasses.replace(clip, pose=clip.pose[:frames], root=clip.root[:frames])


def moving_bodies(
    state: DrapedState,
    rig: RiggedBody,
    motion: Motion,
    repulsion: RepulsionOptions | None,
    *,
    progress: Progress = silent,
) -> tuple[Float[np.ndarray, "t b 3"], list[Freed | None]]:
    """Surfaces of all frames, the first one the drape's own, and what repulsion did to each.

    Args:
        state: the drape.
        rig: its body.
        motion: from `find_motion`.
        repulsion: how bodies are freed of self-intersection; None leaves them as they are.
        progress: told about every frame.
    """
    bodies = posed_bodies(rig, motion)
    # To the bit, because the garment's contact with it is.
    bodies[0] = state.body_vertices
    if repulsion is None:
        return bodies, [None] * len(bodies)
    rest = rig.vertices(np.zeros_like(rig.pose), np.zeros(3))
    freer = Repulsion(rest, rig.faces, repulsion)
    freed: list[Freed | None] = [None]
    for number in range(1, len(bodies)):
        found = freer.free(bodies[number])
        bodies[number] = found.vertices
        freed.append(dataclasses.replace(found, vertices=np.zeros((0, 3))))
        progress("bodies", number, len(bodies) - 1)
    return bodies, freed


def freed_report(freed: list[Freed | None]) -> dict[str, Any]:
    """What repulsion did, as plain lists of numbers per frame; the drape's own body is left out."""
    known = [one for one in freed if one is not None]
    return {
        "frames": len(known),
        "self_intersections_before": [one.before for one in known],
        "self_intersections_left": [one.after for one in known],
        "frames_not_free": sum(one.after > 0 for one in known),
        "largest_displacement_m": [one.largest for one in known],
        "mean_displacement_m": [one.mean for one in known],
        "moved_vertices": [one.moved for one in known],
    }
