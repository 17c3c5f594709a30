"""Cloth solvers of Newton physics: frames of 20 ms in substeps, no gradient, no guarantee.

Stiffnesses are those of the scene for small strains; contact, damping, substeps and iterations are
those of Newton's own cloth examples. Pinned vertices are held where they start.
"""

import abc
import time
from typing import Any

import numpy as np

from benchmarks.peers.record import Clock, Run
from benchmarks.peers.scenes import Scene

FRAME = 0.02  # [s]
SUBSTEPS = 10
SETTLE_TIME = 2.0  # longest simulated time of a drape [s]
AT_REST = 0.02  # rms velocity at which a drape ends [m/s]


class NewtonCloth(abc.ABC):
    """A model, a solver, and its loop."""

    packages = ("newton", "warp-lang", "numpy")
    iterations: int

    def __init__(self, solver: str):
        import newton
        import warp as wp

        wp.config.quiet = True
        wp.init()
        self._newton, self._wp = newton, wp
        self.solver = f"{solver}, on {'cuda' if wp.is_cuda_available() else 'cpu'}"

    @abc.abstractmethod
    def build(self, scene: Scene) -> tuple[Any, Any]:
        """Model and solver."""

    def finish(self, builder: Any, scene: Scene) -> Any:
        """The model with the body, contact parameters and pins."""
        newton = self._newton
        body = newton.Mesh(scene.body_vertices, scene.body_faces.ravel())
        builder.add_shape_mesh(body=-1, mesh=body)
        builder.color()
        model = builder.finalize()
        model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = 1.0e3, 1.0e-1, 0.0
        flags = model.particle_flags.numpy()
        flags[scene.pins] &= ~int(newton.ParticleFlags.ACTIVE)
        model.particle_flags = self._wp.array(flags, dtype=model.particle_flags.dtype)
        return model

    def run(self, scene: Scene, seconds: float) -> Run | None:
        """Frames until the steps are done, or for a drape until the cloth is at rest."""
        if scene.name not in ("drop", "settle"):
            return None
        begun = time.perf_counter()
        self._simulate(scene, 1, np.inf)
        compiled = time.perf_counter() - begun
        frames = scene.steps or round(SETTLE_TIME / FRAME)
        run = self._simulate(scene, frames, seconds)
        run.compile_seconds = compiled
        return run

    def _simulate(self, scene: Scene, frames: int, seconds: float) -> Run:
        newton = self._newton
        model, solver = self.build(scene)
        before, after = model.state(), model.state()
        control, pipeline = model.control(), newton.CollisionPipeline(model)
        contacts = pipeline.contacts()
        clock = Clock()
        done, converged, note = 0, not scene.steps, ""
        while done < frames:
            if clock.seconds > seconds:
                converged, note = False, "out of time"
                break
            pipeline.collide(before, contacts)
            if hasattr(solver, "rebuild_bvh"):
                solver.rebuild_bvh(before)
            for _ in range(SUBSTEPS):
                before.clear_forces()
                solver.step(before, after, control, contacts, FRAME / SUBSTEPS)
                before, after = after, before
            done += 1
            velocity = before.particle_qd.numpy()
            speed = float(np.sqrt(np.mean(np.sum(velocity**2, axis=1))))
            if not scene.steps and done > 10 and speed < AT_REST:
                break
        else:
            converged = bool(scene.steps)
            note = "" if converged else "not at rest"
        seconds, cpu = clock.seconds, clock.cpu_seconds
        if not scene.steps:
            note = f"{note + ', ' if note else ''}{speed:.2f} m/s rms"
        positions = before.particle_q.numpy().astype(np.float64)
        count = done * SUBSTEPS * self.iterations
        return Run(positions, seconds, count, done, converged, cpu, note=note)
