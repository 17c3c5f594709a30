"""The folder of an animation: trajectory, caches, GLB, film, report (S15)."""

import dataclasses
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from dress_jax.application.animate import WORK, Animation
from dress_jax.application.progress import Progress, silent
from dress_jax.io.animated import write_animated_glb
from dress_jax.io.atomic import atomic_path
from dress_jax.io.meshes import write_body_obj, write_garment_obj
from dress_jax.io.point_caches import write_mdd, write_pc2
from dress_jax.io.report import write_report
from dress_jax.io.results import versions
from dress_jax.io.trajectory import write_trajectory
from dress_jax.io.video import video_suffix, write_video
from dress_jax.render.rings import frame_body, ring_cameras
from dress_jax.render.shading import BODY_COLOR, label_colors, shade

VIEWS = (25.0, 115.0)
"""Azimuths of the film's two pictures [degrees]: from the front and the wearer's left."""


def save_animation(
    folder: str | Path,
    animation: Animation,
    report: dict[str, Any],
    *,
    size: int = 384,
    progress: Progress = silent,
) -> list[Path]:
    """Write an animation; the report comes last, then what a resume needs is removed.

    Args:
        folder: where to.
        animation: the frames.
        report: `animation.report`, with whatever else belongs into the file.
        size: height and width of a view of the film [px], even; 0 for no film.
        progress: told about the pictures of the film.

    Returns:
        The files, the film and the report last.

    Raises:
        InputError: the folder cannot be written to.
    """
    folder = Path(folder)
    state, garment = animation.state, animation.state.garment
    (folder / "report.json").unlink(missing_ok=True)
    fps, bodies = animation.motion.fps, animation.bodies
    write_garment_obj(folder / "garment.obj", garment)
    write_body_obj(folder / "body.obj", state.body_vertices, state.body_faces)
    faces = {"cloth": garment.faces, "body": state.body_faces}
    with write_trajectory(folder / "trajectory.h5", faces) as append:
        for number, (cloth, body) in enumerate(zip(animation.frames, bodies, strict=True)):
            append(number / fps, {"cloth": cloth, "body": body})
    write_pc2(folder / "garment.pc2", animation.frames)
    write_mdd(folder / "garment.mdd", animation.frames, fps=fps)
    write_animated_glb(
        folder / "animation.glb",
        garment,
        animation.frames,
        fps=fps,
        body=(bodies, state.body_faces),
    )
    with atomic_path(folder / "motion.npz") as temporary:
        motion = animation.motion
        np.savez(temporary, allow_pickle=False, poses=motion.pose, root=motion.root, fps=fps)
    names = ["garment.obj", "body.obj", "trajectory.h5", "garment.pc2", "garment.mdd"]
    names += ["animation.glb", "motion.npz"]
    if size:
        names.append(f"preview{video_suffix()}")
        write_video(folder / names[-1], pictures(animation, size=size, progress=progress), fps=fps)
    files = {"files": names}
    write_report(
        folder / "report.json", {**report, **files, "versions": versions()}, nonfinite_to_null=True
    )
    shutil.rmtree(folder / WORK, ignore_errors=True)
    return [folder / name for name in (*names, "report.json")]


def pictures(
    animation: Animation, *, size: int, progress: Progress = silent
) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
    """Two views of every frame side by side; the cameras go along with the body.

    Args:
        animation: the frames.
        size: height and width of a view [px].
        progress: told about every frame.
    """
    garment = animation.state.garment
    colors = label_colors(garment.face_panels)
    along = animation.motion.root * [1.0, 0.0, 1.0]
    still = dataclasses.replace(
        animation,
        frames=animation.frames - along[:, None],
        bodies=animation.bodies - along[:, None],
    )
    everything = np.concatenate([still.frames.reshape(-1, 3), still.bodies.reshape(-1, 3)])
    center, half_extent = frame_body(everything)
    cameras = ring_cameras(VIEWS, size=size, center=center, half_extent=half_extent)
    for number, (cloth, body) in enumerate(zip(still.frames, still.bodies, strict=True)):
        meshes = [
            (cloth, garment.faces, colors),
            (body, animation.state.body_faces, np.asarray(BODY_COLOR)),
        ]
        yield np.concatenate([shade(camera, meshes) for camera in cameras], axis=1)
        progress("film", number + 1, len(still.frames))
