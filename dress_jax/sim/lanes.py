"""Several solves at once: the lanes of a batch, each worker thread with a twin of the simulator.

A solve waits for compiled programs, box trees and factorizations, all of which let other threads
run, so lanes share the processors better than one solve uses them alone: each factorizes in its own
thread. What a solve leaves in a
simulator (sparsity, symbolic factorization, box trees, the last end) is each twin's own. Which lane
is solved by which twin, and after which other lane, depends on their numbers alone, so a batch is
repeated bit by bit.
"""

import copy
import dataclasses
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import jax

from dress_jax.sim.clean_state import CleanState
from dress_jax.sim.last_end import LastEnd
from dress_jax.sim.simulator import Simulator
from dress_jax.solver.linear import one_thread

_Result = TypeVar("_Result")

# What a solve changes. A twin keeps its own; everything else follows the simulator.
_OWN = frozenset(
    ("linear_solver", "pattern", "slots", "broad_phase", "clean_state", "last_end", "twins")
)


def run_lanes(
    simulator: Simulator, count: int, solve: Callable[[Simulator, int], _Result]
) -> list[_Result]:
    """Results of all lanes, in their order.

    Args:
        simulator: its `workers` threads share the lanes in runs of neighbours, as equal as they
            can be: neighbours that have the same state share its factorization.
        count: number of lanes.
        solve: called with a twin of the simulator and the number of a lane, in a thread.

    Raises:
        Exception: what the first failed lane raised, after all threads have ended.
    """
    workers = min(count, max(1, simulator.workers))
    twins = _twins(simulator, workers)
    device = jax.config.jax_default_device
    bounds = [worker * count // workers for worker in range(workers + 1)]

    def work(worker: int) -> list[_Result]:
        # Precision and device may have been set for the calling thread alone.
        with jax.enable_x64(True), jax.default_device(device), one_thread():
            lanes = range(bounds[worker], bounds[worker + 1])
            return [solve(twins[worker], lane) for lane in lanes]

    if workers == 1:
        return [solve(twins[0], lane) for lane in range(count)]
    with ThreadPoolExecutor(workers, thread_name_prefix="lanes") as pool:
        runs = list(pool.map(work, range(workers)))
    return [result for run in runs for result in run]


def _twins(simulator: Simulator, count: int) -> list[Simulator]:
    """The first twins, made where there are none yet, and brought up to date."""
    twins = simulator.twins
    while len(twins) < count:
        twins.append(
            dataclasses.replace(
                simulator,
                linear_solver=type(simulator.linear_solver)(),
                broad_phase=copy.deepcopy(simulator.broad_phase),
                clean_state=CleanState(),
                last_end=LastEnd(),
            )
        )
    followed = [f.name for f in dataclasses.fields(Simulator) if f.name not in _OWN]
    for twin in twins[:count]:
        for name in followed:
            setattr(twin, name, getattr(simulator, name))
    return twins[:count]
