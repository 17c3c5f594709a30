"""One implicit step as a differentiable function (S2.1-S2.11): backward, forward, and twice.

The end x of a step is where the force F(x, theta) = dE/dx vanishes, H = dF/dx. Its derivatives are

    rate:  along a change of theta,     dx = -H^-1 (dF/dtheta) dtheta,
    pull:  of a cotangent w of x,       -(dF/dtheta)^T lambda  with  H lambda = w,

linear functions of dtheta and w, and each other's transpose. Their own derivatives along a change
of everything they depend on make products with second derivatives: with K(v) = d(H v)/d(x, theta)
along (dx, dtheta),

    d lambda = H^-1 (dw - K(lambda)),
    d pull   = -(dF/dtheta)^T d lambda - d[(dF/dtheta)^T] lambda.

The Newton loop and the linear solves run on the host, so all four are primitives of JAX with
derivative, transposition and batching rules, each a call of compiled pieces. Nothing but the
inputs and the end of a step is kept for a backward pass, whatever the number of Newton iterations.

Each works in lanes as well, on several ends at once (`lane_primitives`); the rules are the same.
"""

import functools
import operator
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.interpreters import ad
from jaxtyping import Array, Float

from dress_jax.sim.adjoint import Linearization
from dress_jax.sim.equilibrium import Report, solve_step
from dress_jax.sim.inputs import StepInputs
from dress_jax.sim.kernels import make_frame
from dress_jax.sim.lane_primitives import lane_primitive
from dress_jax.sim.objective import StepObjective
from dress_jax.sim.simulator import Simulator

Indices = tuple[int, ...]

_NO_JIT = (
    "the cloth simulator runs its Newton loop on the host and cannot be traced by jit, scan or "
    "checkpoint; call it outside of them (jax.grad, jax.vjp, jax.jvp and jax.vmap work), and jit "
    "what comes before and after it"
)
_NO_REVERSE = (
    "second derivatives of the cloth simulator are forward over reverse, or forward over forward; "
    "use jax.jvp of jax.grad, or jax.jacfwd of jax.grad"
)


def advance(simulator: Simulator, inputs: StepInputs) -> tuple[Float[Array, "n 3"], Report]:
    """Positions at the end of one implicit step [m], and how the solve went.

    Differentiable in every leaf of the inputs: `jax.grad`, `jax.vjp`, `jax.jvp`, `jax.linearize`,
    and `jax.jvp` of each. `jax.vmap` over inputs solves several at once, `simulator.workers` at a
    time; many right-hand sides at one end share one factorization.

    Args:
        simulator: host object.
        inputs: what the step depends on.

    Raises:
        RuntimeError: double precision is off.
        TypeError: called under jit, or differentiated in reverse twice.
        InputError: arrays that do not fit the simulator or are not finite, or a start state closer
            than the thickness.
    """
    leaves, tree = jax.tree.flatten(inputs)
    leaves = [jnp.asarray(leaf) for leaf in leaves]
    positions, *report = _solve.bind(*leaves, simulator=simulator, tree=tree, lanes=None)
    return positions, Report(*report)


# The solve


def _solve_impl(*leaves, simulator: Simulator, tree) -> list[Array]:
    inputs = jax.tree.unflatten(tree, leaves)
    positions, report, linearization = solve_step(simulator, inputs)
    simulator.last_end.keep(linearization)
    return [positions, *jax.tree.leaves(report)]


def _solve_jvp(primals, tangents, *, simulator: Simulator, tree, lanes):
    options = dict(simulator=simulator, tree=tree, lanes=lanes)
    ends = _solve.bind(*primals, **options)
    changes = [_no_change(end) for end in ends]
    moved, rates = _nonzero(tangents)
    if moved:
        changes[0] = _rate.bind(ends[0], *primals, *rates, moved=moved, **options)
    return ends, changes


def _untraceable(*avals, **_):
    raise TypeError(_NO_JIT)


# First derivatives. Operands: the end, the leaves of the inputs, and what the result is linear in.


def _rate_impl(x, *operands, simulator: Simulator, tree, moved):
    leaves, rates = operands[: tree.num_leaves], operands[tree.num_leaves :]
    end = _End(simulator, tree, x, leaves)
    return jnp.asarray(-end.solve(end.force_rate(moved, end.rates(moved, rates))))


def _rate_jvp(primals, tangents, *, simulator: Simulator, tree, lanes, moved):
    count = 1 + tree.num_leaves
    options = dict(simulator=simulator, tree=tree, lanes=lanes, moved=moved)
    out = _rate.bind(*primals, **options)
    total = _no_change(out)
    if not all(type(t) is ad.Zero for t in tangents[count:]):
        rates = [ad.instantiate_zeros(t) for t in tangents[count:]]
        total = _rate.bind(*primals[:count], *rates, **options)
    swept, sweeps = _nonzero(tangents[:count])
    if swept:
        bent = _rate_change.bind(*primals, out, *sweeps, swept=swept, **options)
        total = bent if type(total) is ad.Zero else total + bent
    return out, total


def _rate_transpose(cotangent, x, *operands, simulator: Simulator, tree, lanes, moved):
    leaves = operands[: tree.num_leaves]
    none = [None] * (1 + tree.num_leaves)
    if type(cotangent) is ad.Zero:
        return none + [None] * len(moved)
    options = dict(simulator=simulator, tree=tree, lanes=lanes, moved=moved)
    pulled = _pull.bind(x, *leaves, cotangent, **options)
    return none + list(pulled)


def _pull_impl(x, *operands, simulator: Simulator, tree, moved):
    leaves, cotangent = operands[:-1], operands[-1]
    end = _End(simulator, tree, x, leaves)
    return end.pull(moved, end.solve(np.asarray(cotangent)))


def _pull_jvp(primals, tangents, *, simulator: Simulator, tree, lanes, moved):
    options = dict(simulator=simulator, tree=tree, lanes=lanes, moved=moved)
    out = _pull.bind(*primals, **options)
    swept, sweeps = _nonzero(tangents)
    if not swept:
        return out, [_no_change(o) for o in out]
    return out, _pull_change.bind(*primals, *sweeps, swept=swept, **options)


def _pull_transpose(cotangents, x, *operands, simulator: Simulator, tree, lanes, moved):
    rates = [ad.instantiate_zeros(cotangent) for cotangent in cotangents]
    options = dict(simulator=simulator, tree=tree, lanes=lanes, moved=moved)
    back = _rate.bind(x, *operands[: tree.num_leaves], *rates, **options)
    return [None] * (1 + tree.num_leaves) + [back]


# Second derivatives. The last operands are changes of those before that `swept` counts.


def _rate_change_impl(x, *operands, simulator: Simulator, tree, moved, swept):
    """Change of a rate `out` as the end and the inputs change, the rates of the inputs fixed."""
    n = tree.num_leaves
    leaves, rates, out = operands[:n], operands[n : n + len(moved)], operands[n + len(moved)]
    end = _End(simulator, tree, x, leaves)
    sweeps = end.sweeps(swept, operands[n + len(moved) + 1 :])
    along = [end.vectors(out), *end.rates(moved, rates)]
    return jnp.asarray(-end.solve(end.force_change(moved, swept, along, sweeps)))


def _pull_change_impl(x, *operands, simulator: Simulator, tree, moved, swept):
    n = tree.num_leaves
    leaves, cotangent, sweeps = operands[:n], np.asarray(operands[n]), list(operands[n + 1 :])
    end = _End(simulator, tree, x, leaves)
    adjoint = end.solve(cotangent)
    change = np.zeros_like(cotangent)
    if n + 1 in swept:
        change = np.asarray(sweeps.pop())
        swept = swept[:-1]
    if not swept:
        return end.pull(moved, end.solve(change))
    bent, own = end.work_change(moved, swept, adjoint, end.sweeps(swept, sweeps))
    pulled = end.pull(moved, end.solve(change - bent))
    return [a - b for a, b in zip(pulled, own, strict=True)]


def _no_reverse(*_, **__):
    raise TypeError(_NO_REVERSE)


class _End:
    """The end of a step, with the compiled pieces of its derivatives on padded arrays."""

    def __init__(self, simulator: Simulator, tree: Any, x: Array, leaves: Sequence[Array]):
        inputs, self._x = jax.tree.unflatten(tree, leaves), np.asarray(x)
        found = simulator.last_end.find(simulator, inputs, self._x)
        if found is None:
            found = Linearization(StepObjective(simulator, inputs), self._x)
            simulator.last_end.keep(found)
        self.solve = found.solve
        self._found, self._tree, self._padding = found, tree, simulator.padding
        self._true = [np.zeros(np.shape(leaf)) for leaf in leaves]
        padding = simulator.padding
        self._state = padding.positions(self._x), jax.tree.leaves(padding.inputs(inputs))
        areas = padding.body(np.asarray(simulator.body_areas))
        self._fixed = padding.cloth, areas, simulator.settings

    def _each(self, piece: Callable[..., Any], chosen: Sequence[Indices], *arguments: Any) -> list:
        """A piece of all energies."""
        objective = self._found.objective
        return [
            piece(term.energy, self._tree, *chosen, self._state, self._fixed, pairs, *arguments)
            for term, pairs in objective.terms(objective.contacts(self._x))
        ]

    def vectors(self, v: np.ndarray | Array) -> np.ndarray:
        """Vectors of the cloth, padded."""
        return self._padding.vectors(np.asarray(v))

    def rates(self, moved: Indices, rates: Sequence[Array]) -> list[Array | np.ndarray]:
        """Changes of the leaves that `moved` counts, padded."""
        true = list(self._true)
        for index, rate in zip(moved, rates, strict=True):
            true[index] = np.asarray(rate)
        padded = jax.tree.leaves(self._padding.rates(jax.tree.unflatten(self._tree, true)))
        return [padded[index] for index in moved]

    def sweeps(self, swept: Indices, sweeps: Sequence[Array]) -> list[Array | np.ndarray]:
        """Changes of the end (counted 0) and of the leaves (from 1), padded."""
        ends = [self.vectors(sweep) for k, sweep in zip(swept, sweeps, strict=True) if k == 0]
        moved = tuple(k - 1 for k in swept if k > 0)
        return [*ends, *self.rates(moved, sweeps[len(ends) :])]

    def force_rate(self, moved: Indices, rates: Sequence) -> np.ndarray:
        """Change of the force along changes of the leaves."""
        return self._sum(self._each(_force_rate, [moved], rates))

    def force_change(
        self, moved: Indices, swept: Indices, along: Sequence, sweeps: Sequence
    ) -> np.ndarray:
        """Change of the change of the force along changes of the end and the leaves."""
        return self._sum(self._each(_force_change, [moved, swept], along, sweeps))

    def pull(self, moved: Indices, adjoint: np.ndarray) -> list[Array]:
        """Minus the slope of the adjoint's work in the leaves."""
        parts = self._each(_work_slope, [moved], self.vectors(adjoint))
        return [-part for part in self._cut(moved, parts)]

    def work_change(
        self, moved: Indices, swept: Indices, adjoint: np.ndarray, sweeps: Sequence
    ) -> tuple[np.ndarray, list[Array]]:
        """Changes of H times the adjoint, and of the slope of its work in the leaves."""
        parts = self._each(_work_change, [moved, swept], self.vectors(adjoint), sweeps)
        return self._sum([bent for bent, _ in parts]), self._cut(moved, [own for _, own in parts])

    def _sum(self, parts: Sequence[Array]) -> np.ndarray:
        return np.sum([np.asarray(part) for part in parts], axis=0)[: len(self._x)]

    def _cut(self, moved: Indices, parts: Sequence[Sequence[Array]]) -> list[Array]:
        """Sums over the energies, per moved leaf."""
        totals = [functools.reduce(operator.add, own) for own in zip(*parts, strict=True)]
        return [_resized(t, self._true[k].shape) for k, t in zip(moved, totals, strict=True)]


def _resized(padded: Array, shape: tuple[int, ...]) -> Array:
    """The first rows; zeros follow where there are more of them than padded ones."""
    if not shape:
        return padded
    rows = np.asarray(padded)[: shape[0]]
    return jnp.asarray(np.concatenate([rows, np.zeros((shape[0] - len(rows), *shape[1:]))]))


# Compiled pieces, each for one energy. `state` is the end and the leaves of the inputs, `fixed` the
# cloth, the areas of the body and the settings of contact; all padded.


def _of_positions(energy, tree, fixed, pairs, leaves):
    """The energy as a function of the positions."""
    inputs: StepInputs = jax.tree.unflatten(tree, leaves)
    cloth, body_areas, settings = fixed
    parameters, others = inputs.parameters, (inputs.body_start, body_areas, settings)
    frame = make_frame(parameters, cloth, inputs.step, *others)
    return lambda x: energy(x, parameters, cloth, frame, *pairs)


def _force(energy, tree, fixed, pairs, x, leaves):
    """dE/dx."""
    return jax.grad(_of_positions(energy, tree, fixed, pairs, leaves))(x)


def _work(energy, tree, fixed, pairs, x, leaves, direction):
    """The force times a direction."""
    return jax.jvp(_of_positions(energy, tree, fixed, pairs, leaves), (x,), (direction,))[1]


def _with(values: Sequence[Array], chosen: Indices, others: Sequence[Array]) -> list[Array]:
    """The values with others in the chosen places."""
    changed = list(values)
    for index, other in zip(chosen, others, strict=True):
        changed[index] = other
    return changed


def _pick(values: Sequence[Array], chosen: Indices) -> tuple[Array, ...]:
    return tuple(values[index] for index in chosen)


@functools.partial(jax.jit, static_argnums=(0, 1, 2))
def _force_rate(energy, tree, moved, state, fixed, pairs, rates):
    x, leaves = state

    def force(*own):
        return _force(energy, tree, fixed, pairs, x, _with(leaves, moved, own))

    return jax.jvp(force, _pick(leaves, moved), tuple(rates))[1]


@functools.partial(jax.jit, static_argnums=(0, 1, 2, 3))
def _force_change(energy, tree, moved, swept, state, fixed, pairs, along, sweeps):
    """`along` is the rate of the end, then those of the moved leaves."""
    operands = [state[0], *state[1]]
    rated = (0, *(index + 1 for index in moved))

    def rate(*swept_own):
        base = _with(operands, swept, swept_own)

        def force(*own):
            x, *leaves = _with(base, rated, own)
            return _force(energy, tree, fixed, pairs, x, leaves)

        return jax.jvp(force, _pick(base, rated), tuple(along))[1]

    return jax.jvp(rate, _pick(operands, swept), tuple(sweeps))[1]


@functools.partial(jax.jit, static_argnums=(0, 1, 2))
def _work_slope(energy, tree, moved, state, fixed, pairs, adjoint):
    x, leaves = state

    def work(own):
        return _work(energy, tree, fixed, pairs, x, _with(leaves, moved, own), adjoint)

    return jax.grad(work)(_pick(leaves, moved))


@functools.partial(jax.jit, static_argnums=(0, 1, 2, 3))
def _work_change(energy, tree, moved, swept, state, fixed, pairs, adjoint, sweeps):
    operands = [state[0], *state[1]]

    def change(own):
        """Change of the work along the sweeps; `own` are the end and the moved leaves."""
        base = _with(operands, (0, *(index + 1 for index in moved)), own)

        def work(*swept_own):
            x, *leaves = _with(base, swept, swept_own)
            return _work(energy, tree, fixed, pairs, x, leaves, adjoint)

        return jax.jvp(work, _pick(base, swept), tuple(sweeps))[1]

    bent, *own = jax.grad(change)(_pick(operands, (0, *(index + 1 for index in moved))))
    return bent, own


# The primitives


def _no_change(value: Array) -> ad.Zero:
    return ad.Zero(jax.typeof(value).to_tangent_aval())


def _nonzero(tangents: Sequence[Any]) -> tuple[Indices, list[Array]]:
    """Which tangents are not zero, and those."""
    chosen = tuple(k for k, tangent in enumerate(tangents) if type(tangent) is not ad.Zero)
    return chosen, [tangents[k] for k in chosen]


def _like_the_end(x, *_, **__):
    return x


def _like_the_leaves(x, *operands, moved, **_):
    return [operands[index] for index in moved]


def _inputs(*, tree, **_) -> int:
    return tree.num_leaves


def _end_and_inputs(*, tree, **_) -> int:
    return 1 + tree.num_leaves


_solve = lane_primitive(
    "implicit_step",
    _solve_impl,
    _untraceable,
    _solve_jvp,
    _no_reverse,
    states=_inputs,
    many=True,
)
_rate = lane_primitive(
    "implicit_step_rate",
    _rate_impl,
    _like_the_end,
    _rate_jvp,
    _rate_transpose,
    states=_end_and_inputs,
    many=False,
)
_pull = lane_primitive(
    "implicit_step_pull",
    _pull_impl,
    _like_the_leaves,
    _pull_jvp,
    _pull_transpose,
    states=_end_and_inputs,
    many=True,
)
_rate_change = lane_primitive(
    "implicit_step_rate_change",
    _rate_change_impl,
    _like_the_end,
    _no_reverse,
    _no_reverse,
    states=_end_and_inputs,
    many=False,
)
_pull_change = lane_primitive(
    "implicit_step_pull_change",
    _pull_change_impl,
    _like_the_leaves,
    _no_reverse,
    _no_reverse,
    states=_end_and_inputs,
    many=True,
)
