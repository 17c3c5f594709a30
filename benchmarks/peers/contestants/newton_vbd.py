"""VBD: vertex block descent with self-contact."""

from typing import Any

import numpy as np

from benchmarks.peers.newton_physics import NewtonCloth
from benchmarks.peers.scenes import Scene


class Vbd(NewtonCloth):
    """`SolverVBD`, with the iterations and the buffers of Newton's example."""

    iterations = 4

    def build(self, scene: Scene) -> tuple[Any, Any]:
        """Model and solver."""
        newton, wp = self._newton, self._wp
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=(0.0, scene.gravity, 0.0))
        corners = scene.rest[scene.faces]
        edge = float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)))
        builder.add_cloth_mesh(
            pos=wp.vec3(0.0, 0.0, 0.0),
            rot=wp.quat_identity(),
            scale=1.0,
            vel=wp.vec3(0.0, 0.0, 0.0),
            vertices=[wp.vec3(*vertex) for vertex in scene.start],
            indices=scene.faces.ravel().tolist(),
            density=scene.density,
            tri_ke=scene.stretching,
            tri_ka=0.0,
            tri_kd=2.0e-4,
            edge_ke=scene.bending / edge,
            edge_kd=1.0e-2,
            particle_radius=scene.dhat,
        )
        model = self.finish(builder, scene)
        solver = newton.solvers.SolverVBD(
            model,
            iterations=self.iterations,
            particle_enable_self_contact=True,
            particle_self_contact_margin=2.0 * scene.dhat,
            particle_self_contact_gap=scene.dhat,
            particle_vertex_contact_buffer_size=64,
            particle_edge_contact_buffer_size=128,
        )
        return model, solver


def make() -> Vbd:
    """The contestant."""
    return Vbd("VBD")
