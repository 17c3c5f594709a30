"""The incremental potential of a step in Warp.

Gradients come from Warp's tape, Hessians from kernels in closed form, sums of blocks from
`warp.sparse`.
"""

import numpy as np
import scipy.sparse
import warp as wp
import warp.sparse
from jaxtyping import Float

from benchmarks.peers.descent import Positions
from benchmarks.peers.mesh import body_areas, edges, hinges
from benchmarks.peers.scenes import Scene
from benchmarks.peers.warp_simulator import candidates, energies, hessians, rest

_FIRST_CAPACITY = 1 << 16
# Of the longest vertex in the difference below [m]: far below a gap, and far enough that the
# rounding of the energy does not show.
_STEP = 1e-7


class _Tree:
    """A hierarchy over the boxes of primitives, refitted at every step."""

    def __init__(self, primitives: np.ndarray, device: str):
        self.primitives = wp.array(primitives, dtype=int, device=device)
        count = len(primitives)
        self.lowers = wp.zeros(count, dtype=wp.vec3, device=device)
        self.uppers = wp.zeros(count, dtype=wp.vec3, device=device)
        self.bvh: wp.Bvh | None = None

    def fit(self, x: wp.array, motion: wp.array, margin: float) -> None:
        """Boxes around the motion, larger by the margin [m]."""
        inputs = [x, motion, self.primitives, margin, self.lowers, self.uppers]
        wp.launch(candidates.swept_boxes, len(self.lowers), inputs, device=x.device)
        if self.bvh is None:
            self.bvh = wp.Bvh(self.lowers, self.uppers)
        else:
            self.bvh.refit()


class WarpObjective:
    """The incremental potential of one step, and what does not change from step to step."""

    def __init__(self, scene: Scene, device: str):
        self.scene, self.device = scene, device
        n = len(scene.start)
        self._n = n
        hinge = hinges(scene.faces)[:, :4]
        faces = np.concatenate([scene.faces, scene.body_faces + n])
        vertices = np.arange(n + len(scene.body_vertices))[:, None]
        self._trees = [_Tree(part, device) for part in (vertices, edges(faces), faces)]
        self._faces = self._array(scene.faces, wp.vec3i)
        self._hinges = self._array(hinge, wp.vec4i)
        pins = np.zeros(n)
        pins[scene.pins] = scene.pin_stiffness
        targets = np.zeros((n, 3))
        targets[scene.pins] = scene.pin_targets
        self._pins = self._array(pins, wp.float64)
        self._targets = self._array(targets, wp.vec3d)
        # Parameters, differentiable.
        self.parameters = {
            "rest_positions": self._array(scene.rest, wp.vec2d, grad=True),
            "density": self._array([scene.density], wp.float64, grad=True),
            "stretching_stiffness": self._array([scene.stretching], wp.float64, grad=True),
            "bending_stiffness": self._array([scene.bending], wp.float64, grad=True),
        }
        self._inverse = self._zeros(len(scene.faces), wp.mat22d, grad=True)
        self._areas = self._zeros(len(scene.faces), wp.float64, grad=True)
        self._weights = self._zeros(len(hinge), wp.float64, grad=True)
        body = body_areas(scene.body_vertices, scene.body_faces)
        self._body_areas = np.concatenate([np.zeros(n), body])
        self._vertex_areas = self._zeros(len(body) + n, wp.float64, grad=True)
        self._measure_rest()
        self._candidates = [self._zeros(_FIRST_CAPACITY, wp.vec4i) for _ in range(2)]
        self._candidate_counts = [0, 0]
        self._active_at: np.ndarray | None = None
        self.begin(scene.start, np.zeros_like(scene.start))

    def _array(self, values, dtype, *, grad: bool = False) -> wp.array:
        return wp.array(values, dtype=dtype, device=self.device, requires_grad=grad)

    def _zeros(self, size: int, dtype, *, grad: bool = False) -> wp.array:
        return wp.zeros(size, dtype=dtype, device=self.device, requires_grad=grad)

    def _launch(self, kernel, size: int, inputs: list) -> None:
        wp.launch(kernel, size, inputs, device=self.device)

    def _measure_rest(self) -> None:
        self._vertex_areas.assign(self._body_areas)
        flat = self.parameters["rest_positions"]
        inputs = [flat, self._faces, self._inverse, self._areas, self._vertex_areas]
        self._launch(rest.rest_triangles, len(self._faces), inputs)
        self._launch(rest.rest_hinges, len(self._hinges), [flat, self._hinges, self._weights])

    def begin(self, start: Positions, velocity: Positions) -> None:
        """Begin a step at positions [m] with velocities [m/s]."""
        self._start = self._array(start, wp.vec3d)
        self._velocity = self._array(velocity, wp.vec3d)

    def _all(self, x: Positions, *, grad: bool = False) -> wp.array:
        return self._array(np.concatenate([x, self.scene.body_vertices]), wp.vec3d, grad=grad)

    # Candidates and steps

    def step_bound(self, x: Positions, displacement: Positions) -> float:
        """By additive continuous collision detection."""
        scene = self.scene
        position = self._all(x)
        still = np.zeros_like(scene.body_vertices)
        motion = self._array(np.concatenate([displacement, still]), wp.vec3d)
        self._active_at = None
        for tree in self._trees:
            tree.fit(position, motion, 0.5 * (scene.dhat + scene.thickness))
        vertices, edge, face = self._trees
        families = (
            (candidates.vertex_face_candidates, vertices, face),
            (candidates.edge_edge_candidates, edge, edge),
        )
        earliest = self._array([1.0], wp.float64)
        for family, (kernel, asking, tree) in enumerate(families):
            self._find(family, kernel, asking, tree)
            if np.any(displacement):
                pairs = self._candidates[family]
                inputs = [position, motion, pairs, family, scene.thickness, earliest]
                self._launch(candidates.earliest_contact, self._candidate_counts[family], inputs)
        return float(earliest.numpy()[0])

    def _find(self, family: int, kernel, asking: _Tree, tree: _Tree) -> None:
        """The candidates of a family; a list that is too short is made anew, nothing is lost."""
        assert tree.bvh is not None
        while True:
            pairs, count = self._candidates[family], self._zeros(1, int)
            boxes = [asking.lowers, asking.uppers]
            inputs = [tree.bvh.id, *boxes, tree.primitives, self._n, pairs, count]
            self._launch(kernel, len(asking.lowers), inputs)
            found = int(count.numpy()[0])
            self._candidate_counts[family] = found
            if found <= len(pairs):
                return
            self._candidates[family] = self._zeros(found * 5 // 4, wp.vec4i)

    def _find_active(self, x: Positions, position: wp.array) -> None:
        """The pairs closer than dhat at a state."""
        if self._active_at is not None and np.array_equal(self._active_at, x):
            return
        capacity = max(sum(self._candidate_counts), 1)
        self._active = self._zeros(capacity, wp.vec4i)
        self._is_edge, self._freedom = self._zeros(capacity, int), self._zeros(capacity, int)
        self._closest, count = self._zeros(capacity, wp.vec4d), self._zeros(1, int)
        reach = self.scene.dhat + self.scene.thickness
        outputs = [self._active, self._is_edge, self._closest, self._freedom, count]
        for family, size in enumerate(self._candidate_counts):
            inputs = [position, self._candidates[family], family, reach, *outputs]
            self._launch(candidates.active_pairs, size, inputs)
        self.active_count = int(count.numpy()[0])
        self._active_at = x.copy()

    # Energies

    def _add_elastic(self, position: wp.array, total: wp.array) -> None:
        scene, p = self.scene, self.parameters
        inputs = [position, self._start, self._velocity, self._vertex_areas]
        inputs += [self._pins, self._targets, p["density"], scene.gravity, 1.0 / scene.time_step]
        self._launch(energies.vertex_energy, self._n, [*inputs, total])
        inputs = [position, self._faces, self._inverse, self._areas, p["stretching_stiffness"]]
        self._launch(energies.membrane_energy, len(self._faces), [*inputs, total])
        inputs = [position, self._hinges, self._weights, p["bending_stiffness"]]
        self._launch(energies.bending_energy, len(self._hinges), [*inputs, total])

    @property
    def _contact(self) -> list:
        scene = self.scene
        return [self._vertex_areas, scene.barrier * scene.dhat, scene.dhat, scene.thickness]

    def _add_contact(self, position: wp.array, total: wp.array) -> None:
        inputs = [position, self._active, self._is_edge, self._closest, *self._contact, total]
        self._launch(energies.contact_energy, self.active_count, inputs)

    def energy(self, x: Positions) -> float:
        """[J]."""
        position, total = self._all(x), self._zeros(1, wp.float64)
        self._find_active(x, position)
        self._add_elastic(position, total)
        self._add_contact(position, total)
        return float(total.numpy()[0])

    def gradient(self, x: Positions) -> Positions:
        """By the tape [N]."""
        position, total = self._all(x, grad=True), self._zeros(1, wp.float64, grad=True)
        self._find_active(x, position)
        tape = wp.Tape()
        with tape:
            self._add_elastic(position, total)
            self._add_contact(position, total)
        tape.backward(loss=total)
        gradient = position.grad.numpy()[: self._n].copy()
        tape.zero()
        return gradient

    # Hessians

    def blocks(self, x: Positions, *, exact: bool) -> warp.sparse.BsrMatrix:
        """Upper triangle of 3x3 blocks."""
        position, p = self._all(x), self.parameters
        cloth = position[: self._n]
        self._find_active(x, position)
        offsets = np.cumsum(
            [0, self._n, 6 * len(self._faces), 10 * len(self._hinges), 10 * self.active_count]
        )
        size, flag = int(offsets[-1]), int(exact)
        out = [self._zeros(size, int), self._zeros(size, int), self._zeros(size, wp.mat33d)]
        offset = [int(offset) for offset in offsets]
        inputs = [self._vertex_areas, p["density"], self._pins, 1.0 / self.scene.time_step]
        self._launch(hessians.vertex_blocks, self._n, [*inputs, offset[0], *out])
        inputs = [cloth, self._faces, self._inverse, self._areas, p["stretching_stiffness"]]
        self._launch(hessians.membrane_blocks, len(self._faces), [*inputs, flag, offset[1], *out])
        inputs = [cloth, self._hinges, self._weights, p["bending_stiffness"]]
        self._launch(hessians.bending_blocks, len(self._hinges), [*inputs, flag, offset[2], *out])
        pairs = [self._active, self._is_edge, self._closest, self._freedom]
        inputs = [position, *pairs, *self._contact, self._n, flag, offset[3], *out]
        self._launch(hessians.contact_blocks, self.active_count, inputs)
        return warp.sparse.bsr_from_triplets(self._n, self._n, *out, prune_numerical_zeros=False)

    def hessian(self, x: Positions, *, exact: bool) -> scipy.sparse.csr_matrix:
        """Upper triangle [N/m], on the host."""
        matrix = self.blocks(x, exact=exact)
        count = matrix.nnz_sync()
        shape = (3 * self._n, 3 * self._n)
        blocks = scipy.sparse.bsr_matrix(
            (
                matrix.values.numpy()[:count],
                matrix.columns.numpy()[:count],
                matrix.offsets.numpy()[: self._n + 1],
            ),
            shape=shape,
        )
        return scipy.sparse.triu(blocks.tocsr(), format="csr")

    # Adjoint

    def pulled_back(self, x: Positions, adjoint: Positions) -> dict[str, Float[np.ndarray, "..."]]:
        """Minus the derivative of adjoint . force in the parameters.

        The tape knows first derivatives only; the second is a central difference of its gradient
        in the parameters along the adjoint.
        """
        step = _STEP / np.abs(adjoint).max()
        sides = [self._parameter_gradient(x + sign * step * adjoint) for sign in (1.0, -1.0)]
        return {name: (sides[1][name] - sides[0][name]) / (2.0 * step) for name in sides[0]}

    def _parameter_gradient(self, x: Positions) -> dict[str, np.ndarray]:
        position, total = self._all(x, grad=True), self._zeros(1, wp.float64, grad=True)
        self._find_active(x, position)
        # Outside of the tape: the kernel adds to it.
        self._vertex_areas.assign(self._body_areas)
        tape = wp.Tape()
        with tape:
            flat = self.parameters["rest_positions"]
            inputs = [flat, self._faces, self._inverse, self._areas, self._vertex_areas]
            self._launch(rest.rest_triangles, len(self._faces), inputs)
            self._launch(rest.rest_hinges, len(self._hinges), [flat, self._hinges, self._weights])
            self._add_elastic(position, total)
            self._add_contact(position, total)
        tape.backward(loss=total)
        gradient = {name: array.grad.numpy().copy() for name, array in self.parameters.items()}
        tape.zero()
        return gradient
