"""The incremental potential of one time step, as Newton's method wants it."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Float

from dress_jax.contact.candidates import Candidates
from dress_jax.contact.ccd import step_bound
from dress_jax.contact.potential import CONTACT_PAIRS, ActivePairs, PairKind, Pairs
from dress_jax.core.pytree import replace
from dress_jax.energy.cloth import Cloth, Parameters, vertex_masses
from dress_jax.energy.elastic import TimeStep
from dress_jax.energy.strain_limit import strain_step_bound
from dress_jax.energy.stretching import stretching_rest
from dress_jax.sim import kernels, matrices
from dress_jax.sim.inputs import StepInputs
from dress_jax.sim.kernels import Frame, Kernels, make_frame
from dress_jax.sim.selection import selected, separated
from dress_jax.sim.simulator import Simulator
from dress_jax.sim.sparsity import extended
from dress_jax.solver.block_matrix import (
    BlockSlots,
    element_pairs,
    symmetric_product,
    upper_triangle,
)
from dress_jax.solver.linear import Factorization

Positions = Float[np.ndarray, "n 3"]


# Of candidates, relative to dhat: a wide margin serves many small steps, and makes each of them
# look at many more pairs.
_SMALLEST_MARGIN, _LARGEST_MARGIN = 0.02, 0.25


class SmallestDistances(NamedTuple):
    """The distance of the closest pair, and the smallest of a pair's distance over its scale [m].

    The thickness of a pair is the thickness times its scale, so the latter compares with it.
    """

    plain: float
    scaled: float


class StepObjective:
    """Energy, derivatives and step bound of one implicit step with a body at rest.

    Candidates are found for the whole of a step and reused while every vertex stays within a
    margin of where it was seen; a state outside of it is never evaluated.
    """

    def __init__(self, simulator: Simulator, inputs: StepInputs):
        self.simulator = simulator
        self.inputs = inputs
        self._padding = simulator.padding
        padded = self._padding.inputs(inputs)
        self._padded = padded.parameters
        self.frame = make_frame(
            padded.parameters,
            self._padding.cloth,
            padded.step,
            padded.body_start,
            jnp.asarray(self._padding.body(np.asarray(simulator.body_areas))),
            simulator.settings,
        )
        self._body = np.asarray(self.parameters.body_vertices)
        settings = simulator.settings
        self._reach = float(settings.dhat + settings.thickness)
        self._scales = self._padding.together(simulator.contact_scales)
        self._on_device = simulator.broad_phase.on_device
        self._margin = 0.0
        self._candidates: Candidates | None = None
        self._seen = self._motion = np.zeros((0, 3))
        self._body_moved = True
        self._contacts: list[Pairs] | None = None
        self._contacts_at = np.zeros((0, 3))
        self._exact: scipy.sparse.csr_matrix | None = None
        self._exact_at = np.zeros((0, 3))
        self._sliding = []
        if simulator.friction:
            self._sliding = self._find_friction()

    @property
    def parameters(self) -> Parameters:
        """Of the step."""
        return self.inputs.parameters

    @property
    def masses(self) -> Float[np.ndarray, " n"]:
        """Of the vertices [kg]."""
        return np.asarray(vertex_masses(self.parameters, self.simulator.cloth))

    # Candidates

    def _cover(self, start: Positions, end: Positions) -> None:
        """Make the candidates valid for every state between start and end."""
        if self._candidates is not None and self._covers(start) and self._covers(end):
            return
        self._seen, self._motion = start.copy(), end - start
        # The next step is likely to be as long as this one.
        length = float(np.sqrt(np.max(np.sum(self._motion**2, axis=1), initial=0.0)))
        dhat = float(self.simulator.settings.dhat)
        self._margin = min(max(length, _SMALLEST_MARGIN * dhat), _LARGEST_MARGIN * dhat)
        self._candidates = self.simulator.broad_phase.find(
            np.concatenate([start, self._body]),
            np.concatenate([end, self._body]),
            self._reach * self.simulator.contact_scales + 2.0 * self._margin,
            body_moved=self._body_moved,
            body_offset=self._padding.padded.vertices,
            scales=self._scales,
        )
        self._body_moved = False

    def _covers(self, x: Positions) -> bool:
        """Whether every vertex is within the margin of one common point of the motion seen."""
        offset = x - self._seen
        squared = float(np.vdot(self._motion, self._motion))
        if squared > 0.0:
            part = min(max(float(np.vdot(offset, self._motion)) / squared, 0.0), 1.0)
            offset = offset - part * self._motion
        return bool(np.max(np.sum(offset**2, axis=1), initial=0.0) <= self._margin**2)

    def candidates(self, positions: Positions) -> Candidates:
        """All pairs that may be in contact at a state."""
        self._cover(positions, positions)
        assert self._candidates is not None
        return self._candidates

    def pairs(self, positions: Positions) -> list[Pairs]:
        """The same, by family."""
        found = self.candidates(positions)
        return [
            Pairs(
                found.vertex_face,
                found.vertex_face_count,
                found.vertex_face_scales,
                PairKind.VERTEX_FACE,
            ),
            Pairs(
                found.edge_edge, found.edge_edge_count, found.edge_edge_scales, PairKind.EDGE_EDGE
            ),
        ]

    def padded(self, positions: Positions) -> Positions:
        """Vertices of the cloth as compiled pieces take them [m]."""
        return self._padding.positions(positions)

    def together(self, positions: Positions) -> Float[np.ndarray, "nb 3"]:
        """Vertices of cloth and body as pairs number them: padded [m]."""
        padding = self._padding
        return np.concatenate([padding.positions(positions), padding.body(self._body)])

    def contacts(self, positions: Positions) -> list[Pairs]:
        """The pairs closer than dhat; all others have neither force nor stiffness."""
        if self._contacts is None or not np.array_equal(self._contacts_at, positions):
            found = []
            for pairs in self.pairs(positions):
                mask = self._active(positions, pairs).mask
                found.append(selected(pairs, mask, on_device=self._on_device))
            self._contacts, self._contacts_at = found, positions.copy()
        return self._contacts

    def _find_friction(self) -> list[Pairs]:
        """Pairs in contact at the start of the step, with the body where it was."""
        at_end = self._body, self._padded
        self._body = np.asarray(self.inputs.body_start)
        self._padded = replace(self._padded, body_vertices=self.frame.body_start)
        active = self.contacts(np.asarray(self.inputs.step.start))
        self._body, self._padded = at_end
        self._candidates, self._contacts, self._body_moved = None, None, True
        return active

    def smallest_distances(self, positions: Positions) -> SmallestDistances:
        """Of all candidate pairs [m]; infinite where there are none."""
        found = [self._active(positions, pairs) for pairs in self.pairs(positions)]
        return SmallestDistances(
            float(np.sqrt(min(float(family.smallest) for family in found))),
            float(np.sqrt(min(float(family.smallest_scaled) for family in found))),
        )

    # Energy and derivatives

    def terms(self, contacts: list[Pairs]) -> list[tuple[Kernels, tuple[Pairs, ...]]]:
        """The energies that add up to the objective, with the pairs that each one takes."""
        return [
            (kernels.ELASTIC, ()),
            *((kernels.BARRIER, (pairs,)) for pairs in contacts),
            *((kernels.SLIDING, (pairs,)) for pairs in self._sliding),
        ]

    @property
    def fixed(self) -> tuple[Parameters, Cloth, Frame]:
        """What compiled pieces take beside positions and pairs: padded."""
        return self._padded, self._padding.cloth, self.frame

    def _active(self, positions: Positions, pairs: Pairs) -> ActivePairs:
        x = self._padding.positions(positions)
        return kernels.find_active(x, self._padded, self.frame, pairs)

    def value(self, positions: Positions) -> float:
        """The energy [J]."""
        x = self._padding.positions(positions)
        # All terms are on their way before the first is waited for; likewise below.
        values = [
            term.value(x, *self.fixed, *pairs) for term, pairs in self.terms(self.pairs(positions))
        ]
        return sum(float(value) for value in values)

    def value_and_gradient(self, positions: Positions) -> tuple[float, Positions]:
        """The energy [J] and its gradient [N]."""
        x = self._padding.positions(positions)
        results = [
            term.gradient(x, *self.fixed, *pairs)
            for term, pairs in self.terms(self.contacts(positions))
        ]
        total = sum(float(value) for value, _ in results)
        gradient = sum(np.asarray(part) for _, part in results)
        return total, np.asarray(gradient)[: len(positions)]

    def hessian_product(self, positions: Positions, direction: Positions) -> Positions:
        """The exact Hessian times a direction [N].

        By the assembled matrix, which is kept until the next state: a solve takes several products,
        and each is far cheaper than the derivative of the gradient.
        """
        product = symmetric_product(self._exact_matrix(positions), direction.ravel())
        return product.reshape(-1, 3)

    def derivative_product(self, positions: Positions, direction: Positions) -> Positions:
        """The same as the derivative of the gradient along the direction, without a matrix [N].

        Owes nothing to the closed forms, so it is what checks them.
        """
        x, along = self._padding.positions(positions), self._padding.vectors(direction)
        parts = [
            term.product(x, along, *self.fixed, *pairs)
            for term, pairs in self.terms(self.contacts(positions))
        ]
        return np.asarray(sum(np.asarray(part) for part in parts))[: len(positions)]

    def factorize(
        self, positions: Positions, *, exact: bool = False, shift: float = 0.0
    ) -> Factorization:
        """The Hessian, projected to positive definite or exact, factorized.

        Args:
            shift: [1/s^2]; that many times the masses are added to it.

        Raises:
            LinearSolveError: it is not positive definite or not finite.
        """
        upper = self._exact_matrix(positions) if exact else self._assembled(positions, exact=False)
        if shift:
            upper = upper.copy()
            # The first entry of a row of the upper triangle is the diagonal.
            upper.data[upper.indptr[:-1]] += shift * np.repeat(self.masses, 3)
        return self.simulator.linear_solver.factorize(upper, positions)

    def _exact_matrix(self, positions: Positions) -> scipy.sparse.csr_matrix:
        """The upper triangle of the exact Hessian; the last one is kept."""
        if self._exact is None or not np.array_equal(self._exact_at, positions):
            self._exact = None
            self._exact = self._assembled(positions, exact=True)
            self._exact_at = positions.copy()
        return self._exact

    def _assembled(self, positions: Positions, *, exact: bool) -> scipy.sparse.csr_matrix:
        """The upper triangle of the Hessian."""
        kinds = matrices.EXACT if exact else matrices.PROJECTED
        families = [(kinds.sliding, pairs) for pairs in self._sliding]
        for pairs in self.contacts(positions):
            if exact and pairs.kind is PairKind.EDGE_EDGE:
                pairs, parallel = self._by_angle(positions, pairs)
                families.append((kinds.mollified, parallel))
            families.append((kinds.barrier, pairs))
        slots = self._contact_slots([pairs for _, pairs in families], positions)

        simulator, x = self.simulator, self._padding.positions(positions)
        values = kinds.elastic(x, *self.fixed, simulator.slots, capacity=simulator.pattern.capacity)
        for (kernel, pairs), target in zip(families, slots, strict=True):
            values = kernel(values, x, self._padded, self.frame, pairs, target)
        return upper_triangle(simulator.pattern, values)

    def _by_angle(self, positions: Positions, pairs: Pairs) -> tuple[Pairs, Pairs]:
        """Edge-edge pairs without those that are nearly parallel, and those."""
        mask = kernels.find_parallel(self.together(positions), pairs)
        return separated(pairs, mask, on_device=self._on_device, smallest=256)

    def _contact_slots(self, families: list[Pairs], positions: Positions) -> list[BlockSlots]:
        """Slots of contact pairs; extends the pattern where it lacks a block."""
        simulator = self.simulator
        size = simulator.pattern.size
        wanted = []
        for pairs in families:
            indices = np.asarray(pairs.indices)
            used = np.arange(indices.shape[1]) < int(pairs.count)
            wanted.append(element_pairs(np.where(used, indices, size), CONTACT_PAIRS))
        found = [simulator.pattern.find(first, second) for first, second in wanted]
        if not all(complete for _, _, complete in found):
            # With room for pairs that are about to touch: every new pattern is analysed anew.
            simulator.pattern, simulator.slots = extended(
                self._padding.cloth, simulator.pattern, wanted + self._near_pairs(positions)
            )
            found = [simulator.pattern.find(first, second) for first, second in wanted]
        return [
            BlockSlots(jnp.asarray(slots), jnp.asarray(transposed))
            for slots, transposed, _ in found
        ]

    def _near_pairs(self, positions: Positions) -> list[tuple[np.ndarray, np.ndarray]]:
        """Blocks of the candidates within twice the reach of the barrier."""
        settings = self.simulator.settings
        wide = replace(self.frame, settings=replace(settings, dhat=2.0 * settings.dhat))
        found = []
        for pairs in self.pairs(positions):
            x = self._padding.positions(positions)
            mask = kernels.find_active(x, self._padded, wide, pairs).mask
            near = np.nonzero(np.asarray(mask))[0]
            found.append(element_pairs(np.asarray(pairs.indices)[:, near], CONTACT_PAIRS))
        return found

    # Steps

    def step_bound(self, positions: Positions, displacement: Positions) -> float:
        """How far along the displacement no pair touches and no strain limit is reached, in (0, 1]
        (S1.11).
        """
        self._cover(positions, positions + displacement)
        assert self._candidates is not None
        start = self.together(positions)
        motion = np.zeros_like(start)
        motion[: len(displacement)] = displacement
        bound = float(
            step_bound(
                jnp.asarray(start),
                jnp.asarray(motion),
                self._candidates,
                min_distance=self.simulator.settings.thickness,
            )
        )
        limit = self._padded.strain_limit
        if limit is None:
            return bound
        cloth, padding = self._padding.cloth, self._padding
        rest = stretching_rest(self._padded, cloth)
        x, along = padding.positions(positions), padding.vectors(displacement)
        return min(bound, float(strain_step_bound(x, along, cloth.faces, rest, limit)))


def resting_objective(
    simulator: Simulator, parameters: Parameters, positions: Positions | Float[Array, "n 3"]
) -> StepObjective:
    """The objective of one step of 1 s that begins at rest at the positions [m]."""
    start = jnp.asarray(positions, jnp.float64)
    step = TimeStep(start, jnp.zeros_like(start), jnp.asarray(1.0))
    return StepObjective(simulator, StepInputs(step, parameters, parameters.body_vertices))
