"""Compiles what a solve is made of, several programs at once, before the solve asks for them.

XLA compiles a program on one processor, and Newton's method needs some twenty, one after the
other. They are known beforehand: each is run once on the start state, in as many threads as the
simulator has workers. Sizes of pair lists that the solve meets later are compiled then.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from dress_jax.contact.ccd import step_bound
from dress_jax.contact.potential import PairKind
from dress_jax.sim import matrices
from dress_jax.sim.objective import StepObjective
from dress_jax.solver.block_matrix import empty_values

_FEWEST = 2  # workers; a single one gains nothing

# What has been compiled in this process, by shapes. Whoever drops the compiled programs has them
# compiled one by one afterwards.
_known: set[Any] = set()


def compile_ahead(
    objective: StepObjective, positions: Float[np.ndarray, "n 3"], *, exact: bool
) -> None:
    """Run every program of a solve once, unless all of its shapes are known.

    Args:
        objective: of the solve.
        positions: its start [m].
        exact: whether the solve may use the exact Hessian.
    """
    workers = objective.simulator.workers
    if workers < _FEWEST:
        return
    shapes = _shapes((objective.fixed, objective.pairs(positions), objective.contacts(positions)))
    missing = {kind for kind in (False, exact) if (kind, shapes) not in _known}
    if not missing:
        return
    device = jax.config.jax_default_device
    tasks = list(_tasks(objective, positions, exact=missing == {True}))
    if True in missing and False in missing:
        tasks = [*_tasks(objective, positions, exact=True), *tasks]

    def run(task: Callable[[], Any]) -> None:
        with jax.enable_x64(True), jax.default_device(device):
            jax.block_until_ready(task())

    with ThreadPoolExecutor(workers, thread_name_prefix="compile") as pool:
        list(pool.map(run, tasks))
    _known.update((kind, shapes) for kind in missing)


def _shapes(tree: Any) -> Any:
    leaves, structure = jax.tree.flatten(tree)
    return structure, tuple((jnp.shape(leaf), jnp.result_type(leaf)) for leaf in leaves)


def _tasks(
    objective: StepObjective, positions: Float[np.ndarray, "n 3"], *, exact: bool
) -> Iterator[Callable[[], Any]]:
    """Programs that can run beside each other, the longest to compile first."""
    pairs, contacts = objective.pairs(positions), objective.contacts(positions)
    x = objective.padded(positions)
    yield from _assembly(objective, x, contacts, positions, exact=exact)
    if exact:
        return
    for term, own in objective.terms(contacts):
        yield lambda term=term, own=own: term.gradient(x, *objective.fixed, *own)
    start = objective.together(positions)
    for family in objective.candidates(positions).apart():
        yield lambda family=family: step_bound(
            jnp.asarray(start),
            jnp.zeros_like(start),
            family,
            min_distance=objective.simulator.settings.thickness,
        )
    for term, own in objective.terms(pairs):
        yield lambda term=term, own=own: term.value(x, *objective.fixed, *own)


def _assembly(objective, x, contacts, positions, *, exact: bool) -> Iterator[Callable[[], Any]]:
    kinds = matrices.EXACT if exact else matrices.PROJECTED
    simulator, (parameters, cloth, frame) = objective.simulator, objective.fixed
    families = [(kinds.barrier, pairs) for pairs in contacts]
    if exact:
        (edges,) = (pairs for pairs in contacts if pairs.kind is PairKind.EDGE_EDGE)
        families.append((kinds.mollified, objective.by_angle(positions, edges)[1]))
    slots = objective.contact_slots([pairs for _, pairs in families], positions)
    capacity = simulator.pattern.capacity
    yield lambda: kinds.elastic(x, parameters, cloth, frame, simulator.slots, capacity=capacity)
    for (kernel, pairs), target in zip(families, slots, strict=True):
        yield lambda kernel=kernel, pairs=pairs, target=target: kernel(
            empty_values(capacity), x, parameters, frame, pairs, target
        )
