"""The true garments: draped once, and photographed."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import scipy.ndimage
from PIL import Image

from benchmarks.recovery.cases import BODIES, View
from dress_jax.application.drape import DrapeOptions, drape_pattern, draped_state, picture
from dress_jax.application.targets import draw_targets, write_targets
from dress_jax.application.wearer import Wearer, static_wearer
from dress_jax.core.errors import InputError
from dress_jax.io.bodies import body_from_argument
from dress_jax.io.images import Targets
from dress_jax.io.results import DrapedState, read_state, write_state
from dress_jax.optimisation import Observation, observe
from dress_jax.pattern import Pattern
from dress_jax.render.cameras import stack_cameras
from dress_jax.render.rings import frame_body, ring_cameras

HELD_OUT = 10
"""Views that no fit sees: half-way between every other pair of the twenty."""

SIZE = 512
"""Of the held-out pictures [px]."""


def wearer(body: str, data: Path) -> Wearer:
    """The body in the A pose, its feet on the floor."""
    options = BODIES[body]
    if options["body"] != "default":
        found = body_from_argument(str(data / "bodies" / options["body"]), pose="t")
        return static_wearer(found.vertices, found.faces, body=options["body"])
    found = body_from_argument("default", pose=options["pose"], shape=options["shape"])
    floor = found.vertices[:, 1].min()
    return static_wearer(found.vertices - [0.0, floor, 0.0], found.faces, **options)


def make_truth(folder: Path, pattern: Pattern, body: Wearer, options: DrapeOptions) -> DrapedState:
    """The true drape, from the folder or made now.

    Raises:
        InputError: it does not drape.
    """
    path = folder / "truth.h5"
    if path.is_file():
        return read_state(path)
    folder.mkdir(parents=True, exist_ok=True)
    result = drape_pattern(pattern, body, options=options)
    if not (result.report.converged and result.report.intersection_free):
        raise InputError("the true pattern does not drape", where=pattern.source)
    state = draped_state(result)
    Image.fromarray(picture(state)).save(folder / "truth.png")
    write_state(path, state)
    return state


def make_targets(folder: Path, truth: DrapedState, view: View, *, seed: int = 0) -> Path:
    """The folder of target views, made unless it is there."""
    name = f"targets-{view.views}-{view.size}-{view.erosion}-{view.normal_noise:g}"
    if not (folder / name / "cameras.json").is_file():
        targets = draw_targets(truth, views=view.views, size=view.size)
        write_targets(folder / name, degraded(targets, view, seed), truth.garment)
    return folder / name


def degraded(targets: Targets, view: View, seed: int) -> Targets:
    """Targets with smaller masks and tilted normals."""
    mask, normal = targets.mask, targets.normal
    if view.erosion:
        mask = np.stack(
            [scipy.ndimage.grey_erosion(m, size=2 * view.erosion + 1) for m in np.asarray(mask)]
        )
    if view.normal_noise:
        rng = np.random.default_rng(seed)
        tilt = np.deg2rad(view.normal_noise) * rng.normal(size=np.shape(normal))
        covered = np.linalg.norm(normal, axis=-1, keepdims=True) > 0.0
        tilted = np.asarray(normal) + tilt * covered
        length = np.linalg.norm(tilted, axis=-1, keepdims=True)
        normal = tilted / np.where(length > 0.0, length, 1.0)
    return Targets(
        azimuths=targets.azimuths,
        cameras=targets.cameras,
        rgb=targets.rgb,
        normal=normal,
        mask=mask,
        parts=targets.parts,
    )


def held_out(truth: DrapedState) -> Observation:
    """What cameras between those of the fit see."""
    everything = np.concatenate([truth.garment.vertices, truth.body_vertices])
    center, half_extent = frame_body(everything)
    azimuths = [-9.0 - 360.0 * k / HELD_OUT for k in range(HELD_OUT)]
    cameras = ring_cameras(azimuths, size=SIZE, center=center, half_extent=half_extent)
    return observe(
        stack_cameras(cameras),
        jnp.asarray(truth.garment.vertices),
        truth.garment.faces,
        body_vertices=truth.body_vertices,
        body_faces=truth.body_faces,
    )
