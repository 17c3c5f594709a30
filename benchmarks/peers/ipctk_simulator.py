"""The simulator that a user can assemble today: numpy, ipctk and a direct solver.

ipctk gives collision sets, the barrier potential with its Hessians, and continuous collision
detection. Its area weights are set to those of dress_jax, so that the energies are the same but for
the mollifier of nearly parallel edges, which ipctk measures with rest lengths.
"""

import numpy as np
import scipy.sparse

from benchmarks.peers import numpy_cloth
from benchmarks.peers.assembly import FixedPattern, scatter
from benchmarks.peers.descent import Positions
from benchmarks.peers.mesh import body_areas, edges, hinges, rest_shape
from benchmarks.peers.scenes import Scene


class IpctkObjective:
    """The incremental potential of one step, and what does not change from step to step."""

    def __init__(self, scene: Scene):
        import ipctk

        ipctk.set_logger_level(ipctk.LoggerLevel.error)
        self._ipctk = ipctk
        self.scene = scene
        n = len(scene.start)
        self.hinge = hinges(scene.faces)
        self.rest = rest_shape(scene.rest, scene.faces, self.hinge)
        self._masses = scene.density * self.rest.vertex_areas
        self._pattern = FixedPattern(n, [scene.faces, self.hinge[:, :4]])
        self._mesh = self._collision_mesh()
        stretch = scene.dhat**2 + 2.0 * scene.dhat * scene.thickness
        self._barrier = ipctk.BarrierPotential(
            scene.dhat, scene.barrier * scene.dhat / stretch**2, use_physical_barrier=False
        )
        self._candidates, self._found = ipctk.Candidates(), None
        self.begin(scene.start, np.zeros_like(scene.start))

    def _collision_mesh(self):
        """Cloth and body; body primitives do not meet each other."""
        scene, n = self.scene, len(self.scene.start)
        faces = np.concatenate([scene.faces, scene.body_faces + n])
        edge = edges(faces)
        flat = np.stack([scene.rest[:, 0], np.zeros(n), -scene.rest[:, 1]], axis=1)
        mesh = self._ipctk.CollisionMesh(
            np.asfortranarray(np.concatenate([flat, scene.body_vertices])),
            np.asfortranarray(edge),
            np.asfortranarray(faces.astype(np.int32)),
        )
        areas = np.concatenate(
            [self.rest.vertex_areas, body_areas(scene.body_vertices, scene.body_faces)]
        )
        # ipctk counts a quarter of a vertex, and of the sum over two edges; here it is a half of
        # the vertex and an eighth of the four ends.
        mesh.vertex_areas = 2.0 * areas
        mesh.edge_areas = 0.5 * areas[edge].sum(axis=1)
        mesh.can_collide = self._ipctk.make_static_obstacle_filter(n)
        return mesh

    def begin(self, start: Positions, velocity: Positions) -> None:
        """Begin a step.

        Args:
            start: [m], (n, 3).
            velocity: [m/s], (n, 3).
        """
        self._start, self._velocity = start, velocity

    def _all(self, x: Positions):
        return np.asfortranarray(np.concatenate([x, self.scene.body_vertices]))

    def collisions(self, x: Positions):
        """The pairs closer than dhat."""
        if self._found is not None and np.array_equal(self._found[0], x):
            return self._found[1]
        found = self._ipctk.NormalCollisions()
        found.use_area_weighting = True
        scene = self.scene
        found.build(self._candidates, self._mesh, self._all(x), scene.dhat, scene.thickness)
        self._found = x.copy(), found
        return found

    def step_bound(self, x: Positions, displacement: Positions) -> float:
        """By additive continuous collision detection."""
        scene, before, after = self.scene, self._all(x), self._all(x + displacement)
        radius = 0.5 * (scene.dhat + scene.thickness)
        self._candidates.build(self._mesh, before, after, radius, self._ipctk.LBVH())
        self._found = None
        if not np.any(displacement):
            return 1.0
        return self._candidates.compute_collision_free_stepsize(
            self._mesh, before, after, scene.thickness, self._ipctk.AdditiveCCD()
        )

    def _motion(self, x: Positions) -> Positions:
        return (x - self._start) / self.scene.time_step - self._velocity

    def elastic_energy(self, x: Positions) -> float:
        """All terms but contact [J]."""
        scene = self.scene
        motion = self._motion(x)
        pull = x[scene.pins] - scene.pin_targets
        inertia = 0.5 * self._masses @ np.einsum("ni,ni->n", motion, motion)
        weight = -scene.gravity * (self._masses @ (x - self._start)[:, 1])
        return float(
            inertia
            + weight
            + 0.5 * scene.pin_stiffness * np.vdot(pull, pull)
            + numpy_cloth.membrane_energy(x, scene.faces, self.rest, scene.stretching)
            + numpy_cloth.bending_energy(x, self.hinge, self.rest, scene.bending)
        )

    def contact_energy(self, x: Positions) -> float:
        """[J]."""
        return self._barrier(self.collisions(x), self._mesh, self._all(x))

    def energy(self, x: Positions) -> float:
        """[J]."""
        return self.elastic_energy(x) + self.contact_energy(x)

    def elastic_gradient(self, x: Positions) -> Positions:
        """Of all terms but contact [N]."""
        scene, rest = self.scene, self.rest
        n = len(x)
        total = self._masses[:, None] * self._motion(x) / scene.time_step
        total[:, 1] -= scene.gravity * self._masses
        total[scene.pins] += scene.pin_stiffness * (x[scene.pins] - scene.pin_targets)
        forces = numpy_cloth.membrane_gradient(x, scene.faces, rest, scene.stretching)
        total += scatter(n, scene.faces, forces)
        forces = numpy_cloth.bending_gradient(x, self.hinge, rest, scene.bending)
        return total + scatter(n, self.hinge[:, :4], forces)

    def contact_gradient(self, x: Positions) -> Positions:
        """[N]."""
        forces = self._barrier.gradient(self.collisions(x), self._mesh, self._all(x))
        return forces.reshape(-1, 3)[: len(x)]

    def gradient(self, x: Positions) -> Positions:
        """[N]."""
        return self.elastic_gradient(x) + self.contact_gradient(x)

    def hessian(self, x: Positions, *, exact: bool) -> scipy.sparse.csr_matrix:
        """Upper triangle [N/m]."""
        scene, rest = self.scene, self.rest
        diagonal = np.repeat(self._masses / scene.time_step**2, 3)
        diagonal.reshape(-1, 3)[scene.pins] += scene.pin_stiffness
        blocks = [
            numpy_cloth.membrane_hessian(x, scene.faces, rest, scene.stretching, exact=exact),
            numpy_cloth.bending_hessian(x, self.hinge, rest, scene.bending, exact=exact),
        ]
        methods = self._ipctk.PSDProjectionMethod
        contact = self._barrier.hessian(
            self.collisions(x),
            self._mesh,
            self._all(x),
            methods.NONE if exact else methods.CLAMP,
        )
        size = x.size
        upper = scipy.sparse.triu(contact[:size, :size], format="csr")
        return self._pattern.sum(blocks, diagonal) + upper
