"""Style3D: projective dynamics with penalty contact."""

from typing import Any

import numpy as np

from benchmarks.peers.newton_physics import NewtonCloth
from benchmarks.peers.scenes import Scene


class Style3D(NewtonCloth):
    """`SolverStyle3D`, with the iterations of Newton's example."""

    iterations = 4

    def build(self, scene: Scene) -> tuple[Any, Any]:
        """Model and solver."""
        newton, wp = self._newton, self._wp
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=(0.0, scene.gravity, 0.0))
        solver = newton.solvers.SolverStyle3D
        solver.register_custom_attributes(builder)
        newton.solvers.style3d.add_cloth_mesh(
            builder,
            pos=wp.vec3(0.0, 0.0, 0.0),
            rot=wp.quat_identity(),
            vel=wp.vec3(0.0, 0.0, 0.0),
            vertices=scene.start.tolist(),
            indices=scene.faces.ravel().tolist(),
            panel_verts=scene.rest.tolist(),
            panel_indices=scene.faces.ravel().tolist(),
            density=scene.density,
            particle_radius=scene.dhat,
            tri_aniso_ke=wp.vec3(2.0 * scene.stretching, 2.0 * scene.stretching, scene.stretching),
            edge_aniso_ke=wp.vec3(*np.full(3, scene.bending)),
        )
        model = self.finish(builder, scene)
        return model, solver(model, config=solver.Config(iterations=self.iterations))


def make() -> Style3D:
    """The contestant."""
    return Style3D("Style3D")
