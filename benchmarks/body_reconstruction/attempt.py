"""One body: photographed, reconstructed, and compared with the truth."""

import dataclasses
import time

import jax.numpy as jnp
import numpy as np

from benchmarks.body_reconstruction.scene import (
    Scene,
    make_scene,
    random_truth,
    wrong_estimate,
)
from dress_jax.body.model import BodyModel
from dress_jax.core.pytree import replace
from dress_jax.io.timing import stopwatch
from dress_jax.reconstruction import (
    BodyParameters,
    Reconstruction,
    ReconstructionOptions,
    body_in_world,
    reconstruct,
)

BODY_JOINTS = 22
"""Joints of trunk, head, arms and legs; the error of the fingers is listed apart."""


@dataclasses.dataclass(frozen=True)
class Case:
    """What a body is reconstructed from.

    Attributes:
        name: of the case.
        noise: of landmarks that clothes do not hide [px]; hidden ones have twice that, at least
            2 px.
        estimate: whether there is an estimate, see `scene.wrong_estimate`.
    """

    name: str
    noise: float
    estimate: bool


CASES = {
    "clean": Case("clean", 0.0, False),
    "noisy": Case("noisy", 3.0, False),
    "estimate": Case("estimate", 0.0, True),
    "noisy-estimate": Case("noisy-estimate", 3.0, True),
}


def attempt(
    model: BodyModel, case: Case, seed: int, *, views: int, size: int, iterations: int
) -> tuple[dict, Scene, Reconstruction]:
    """Reconstruct the body of a seed; errors of every stage, and the seconds."""
    truth = random_truth(model, seed)
    scene = make_scene(
        model,
        truth,
        views=views,
        size=size,
        noise=case.noise,
        hidden_noise=max(2.0, 2.0 * case.noise),
        seed=seed,
    )
    estimate = wrong_estimate(model, truth, seed) if case.estimate else None
    marks: dict[str, float] = {}
    begin = time.perf_counter()

    def listen(stage: str, done: int, total: int, loss: float | None) -> None:
        if done == total:
            marks[stage] = time.perf_counter() - begin

    with stopwatch() as seconds:
        found = reconstruct(
            model,
            scene.views,
            estimate=estimate,
            options=ReconstructionOptions(fine_iterations=iterations),
            listen=listen,
        )
    row = {
        "case": case.name,
        "seed": seed,
        "hidden": scene.hidden,
        "stages": {
            name: errors(model, parameters, truth)
            for name, parameters in (
                ("coarse", found.coarse),
                ("landmarks", found.by_landmarks),
                ("fine", found.parameters),
            )
        },
        "landmark_error_px": found.landmark_error,
        "iterations": {
            "coarse": found.coarse_fit.iterations,
            "landmarks": found.landmark_fit.iterations,
            "fine": len(found.fine_terms),
        },
        "loss": {
            name: None if terms is None else terms._asdict()
            for name, terms in (("start", found.fine_start), ("end", found.fine_end))
        },
        "seconds": {"total": seconds.total, "compile": seconds.compile, "until": marks},
    }
    return row, scene, found


def errors(model: BodyModel, found: BodyParameters, truth: BodyParameters) -> dict[str, float]:
    """Distances to the true body [cm], of scale and stature [%], of the rotation [degrees]."""
    from scipy.spatial.transform import Rotation

    here, there = body_in_world(model, found), body_in_world(model, truth)
    joints = 100.0 * np.linalg.norm(np.asarray(here.joints - there.joints), axis=1)
    vertices = 100.0 * np.linalg.norm(np.asarray(here.vertices - there.vertices), axis=1)
    turns = [Rotation.from_rotvec(np.array(p.pose[0])) for p in (found, truth)]
    return {
        "joints_cm": float(joints[:BODY_JOINTS].mean()),
        "fingers_cm": float(joints[25:].mean()),
        "vertices_cm": float(vertices.mean()),
        "largest_cm": float(vertices.max()),
        "scale_percent": 100.0 * (found.scale / truth.scale - 1.0),
        "stature_percent": 100.0 * (stature(model, found) / stature(model, truth) - 1.0),
        "rotation_degrees": float(np.degrees((turns[0] * turns[1].inv()).magnitude())),
    }


def stature(model: BodyModel, parameters: BodyParameters) -> float:
    """Height of the body standing straight in the world [m]: scale and shape together."""
    straight = replace(
        parameters, pose=jnp.zeros_like(parameters.pose), translation=jnp.zeros(3, jnp.float64)
    )
    height = np.asarray(body_in_world(model, straight).vertices)[:, 1]
    return float(np.ptp(height))
