"""The derivatives of a garment's drape against finite differences of the drape itself (S2.8)."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from dress_jax.application.drape import FABRIC, DrapeOptions
from dress_jax.application.progress import Progress, silent
from dress_jax.core.precision import require_float64
from dress_jax.energy.cloth import Parameters
from dress_jax.energy.membrane import MembraneModel
from dress_jax.energy.panels import FacePanels
from dress_jax.io.results import DrapedState
from dress_jax.sim import Simulator, make_cloth, make_simulation, static_solve
from dress_jax.sim.certificate import Certificate, certify
from dress_jax.solver import NewtonOptions

TOLERANCE = 1e-5  # of the adjoint against differences, with contact
AGREEMENT = 1e-8  # of forward and reverse mode on garments of any size
_NEWTON = NewtonOptions(tolerance=1e-11, iteration_limit=200)
# How far the differences move the vertex that moves furthest [m]: far against what a solve leaves
# undone, near against the gaps of contact. The best one is found by the differences themselves.
_REACHES = (3e-5, 3e-6, 3e-7)
_NO_EFFECT_STEP = 1e-3  # of a parameter without a derivative, relative to its size


@dataclasses.dataclass(frozen=True)
class DerivativeRow:
    """One parameter, along one direction; derivatives of a weighted sum of all coordinates.

    Attributes:
        name: leaf of `Parameters`.
        reverse: by the adjoint.
        forward: by forward mode.
        difference: by fourth-order central differences of converged drapes.
        uncertainty: how much second-order differences of the same drapes differ from it, relative.
        reach: the furthest way of a vertex in the differences [m].
    """

    name: str
    reverse: float
    forward: float
    difference: float
    uncertainty: float
    reach: float

    @property
    def error(self) -> float:
        """Of the adjoint against the differences, relative; 0 where both are 0."""
        return _relative(self.reverse, self.difference)

    @property
    def disagreement(self) -> float:
        """Of forward and reverse mode, relative."""
        return _relative(self.forward, self.reverse)


@dataclasses.dataclass(frozen=True)
class GradientReport:
    """All parameters of one drape.

    Attributes:
        rows: one per parameter.
        certificate: of the drape.
        converged: whether the drape and every one next to it did.
        smallest_distance: of the drape [m]; contact is active below dhat.
        dhat: reach of contact, thickness included [m].
    """

    rows: list[DerivativeRow]
    certificate: Certificate
    converged: bool
    smallest_distance: float
    dhat: float

    def good(self, tolerance: float = TOLERANCE) -> bool:
        """Every derivative agrees with the differences, and both modes with each other."""
        return self.converged and all(
            row.error <= tolerance and row.disagreement <= AGREEMENT for row in self.rows
        )


def simulation_of(
    state: DrapedState, newton: NewtonOptions, *, friction: bool | None = None
) -> tuple[Simulator, Parameters]:
    """A simulator and parameters for what a result folder holds.

    Args:
        state: from `io.results.read_result`.
        newton: stopping rule.
        friction: whether friction acts; None for what the drape was made with.

    Raises:
        InputError: the fabric that it names is unknown.
    """
    garment, settings = state.garment, state.settings
    options = DrapeOptions(
        fabric=str(settings.get("fabric", FABRIC)),
        panel_fabrics=tuple(map(tuple, settings.get("panel_fabrics", ()))),
        strain_limit=settings.get("strain_limit"),
        friction=bool(settings.get("friction", False)) if friction is None else friction,
    )
    cloth = make_cloth(
        garment.faces,
        garment.rest_faces,
        rest_positions=garment.rest_positions,
        vertex_count=len(garment.vertices),
        pins=np.asarray(state.pins, np.int32),
        membrane=MembraneModel(settings.get("membrane", MembraneModel.ARAP.value)),
    )
    return make_simulation(
        cloth,
        garment.vertices,
        garment.rest_positions,
        fabric=options.fabrics(garment.panels),
        panels=FacePanels(garment.panels, garment.face_panels),
        body_vertices=state.body_vertices,
        body_faces=state.body_faces,
        pin_targets=state.pin_targets,
        strain_limit=options.strain_limit,
        friction=options.friction,
        newton=newton,
    )


def check_gradients(
    state: DrapedState, *, seed: int = 0, progress: Progress = silent
) -> GradientReport:
    """Compare adjoint, forward mode and finite differences, one parameter after the other.

    The drape is one step of 1 s from where the result ended, with the strain limit and the friction
    that it was made with.

    Args:
        state: from `io.results.read_result`.
        seed: of the directions and weights.
        progress: told about every parameter.

    Raises:
        InputError: the state cannot be simulated: it intersects, or its fabric is unknown.
        RuntimeError: 64-bit arrays are off.
    """
    require_float64("check_gradients")
    simulator, parameters = simulation_of(state, _NEWTON)
    progress("settle", 0, 1)
    start = jnp.asarray(state.garment.vertices)
    start = static_solve(simulator, parameters, start).positions
    base = static_solve(simulator, parameters, start)
    rng = np.random.default_rng(seed)
    weights = jnp.asarray(rng.normal(size=start.shape))
    reports = [base.report.converged]

    def loss(p: Parameters) -> Array:
        drape = static_solve(simulator, p, start)
        reports.append(drape.report.converged)
        return jnp.sum(weights * drape.positions)

    gradient = jax.grad(loss)(parameters)
    leaves, tree = jax.tree_util.tree_flatten_with_path(parameters)
    slopes = jax.tree.leaves(gradient)
    rows = []
    for number, (path, leaf) in enumerate(leaves):
        progress("differences", number, len(leaves))
        if not leaf.size:
            continue
        direction = jnp.asarray(rng.normal(size=leaf.shape))

        def moved(t, number=number, direction=direction):
            values = [value for _, value in leaves]
            values[number] = values[number] + t * direction
            return jax.tree.unflatten(tree, values)

        def positions(t, moved=moved):
            return static_solve(simulator, moved(t), start).positions

        _, rate = jax.jvp(positions, (0.0,), (1.0,))
        reverse = float(jnp.sum(slopes[number] * direction))
        forward = float(jnp.sum(weights * rate))
        size = _NO_EFFECT_STEP * max(float(jnp.max(jnp.abs(leaf))), 1.0)
        difference = _best_difference(lambda t, m=moved: float(loss(m(t))), rate, size)
        name = jax.tree_util.keystr(path).lstrip(".")
        rows.append(DerivativeRow(name, reverse, forward, *difference))
    progress("differences", len(leaves), len(leaves))
    settings = simulator.settings
    return GradientReport(
        rows=rows,
        certificate=certify(simulator, parameters, np.asarray(base.positions)),
        converged=all(reports),
        smallest_distance=float(base.report.smallest_distance),
        dhat=float(settings.dhat + settings.thickness),
    )


def _best_difference(
    loss: Callable[[float], float], rate: Float[Array, "n 3"], size: float
) -> tuple[float, float, float]:
    """The difference that second and fourth order agree on best, its uncertainty, its reach [m].

    Args:
        loss: of a step along the direction.
        rate: of the vertices [m].
        size: step where nothing moves.
    """
    fastest = float(jnp.max(jnp.linalg.norm(rate, axis=1)))
    if fastest == 0.0:
        return (loss(size) - loss(-size)) / (2.0 * size), 0.0, 0.0
    found = []
    for reach in _REACHES:
        step = 0.5 * reach / fastest
        one, two = (loss(k * step) - loss(-k * step) for k in (1, 2))
        fourth = (8.0 * one - two) / (12.0 * step)
        found.append((fourth, _relative(one / (2.0 * step), fourth), reach))
    return min(found, key=lambda candidate: candidate[1])


def _relative(value: float, reference: float) -> float:
    if value == reference:
        return 0.0
    return abs(value - reference) / max(abs(reference), np.finfo(float).tiny)
