"""Plays a scene and looks at every state through which the cloth passes."""

import dataclasses
import hashlib
import time
from collections.abc import Callable

import numpy as np

from .scene import Scene

Clean = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], bool]


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What was seen.

    Attributes:
        states: number of states through which the cloth passed.
        intersecting: how many of them intersect.
        moved: the longest way of a vertex from start to end [m].
        digest: of all states, bit by bit; equal digests are equal runs.
        seconds: of the run, the test of the states included.
    """

    states: int
    intersecting: int
    moved: float
    digest: str
    seconds: float


def play(make: Callable[[], Scene], clean: Clean) -> Outcome:
    """One run of a scene, made anew.

    Args:
        make: makes the scene.
        clean: (cloth, its faces, body, its faces) -> whether nothing intersects; body with body
            does not count.
    """
    started = time.perf_counter()
    scene = make()
    faces = np.asarray(scene.simulator.cloth.faces).T
    body_faces = scene.simulator.body_faces
    digest = hashlib.sha256()
    verdicts: list[bool] = []

    def look(positions: np.ndarray, body: np.ndarray) -> None:
        digest.update(np.ascontiguousarray(positions).tobytes())
        digest.update(np.ascontiguousarray(body).tobytes())
        verdicts.append(clean(positions, faces, body, body_faces))

    look(scene.positions, np.asarray(scene.parameters.body_vertices))
    scene.simulator.observer = look
    end = scene.act(scene.simulator, scene.parameters, scene.positions)
    return Outcome(
        states=len(verdicts),
        intersecting=verdicts.count(False),
        moved=float(np.max(np.linalg.norm(end - scene.positions, axis=1))),
        digest=digest.hexdigest(),
        seconds=time.perf_counter() - started,
    )
