"""Primitives of JAX that know lanes, several states at once.

Each has a simulator and a number of lanes: None for one state, or the length of the leading axis
that all operands and results have.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching

from dress_jax.sim.lanes import run_lanes
from dress_jax.sim.simulator import Simulator


def lane_primitive(
    name: str,
    implementation: Callable[..., Any],
    shapes: Callable[..., Any],
    derivative: Callable[..., Any],
    transposition: Callable[..., Any],
    *,
    states: Callable[..., int],
    many: bool,
) -> Primitive:
    """A primitive with its rules.

    Args:
        implementation: of one state, with the simulator among its options.
        shapes, derivative, transposition: rules; `lanes` is one of their options.
        states: how many of the first operands make a state, from the primitive's options.
        many: whether it has several results.
    """
    made = Primitive(name)
    made.multiple_results = many
    made.def_impl(_in_lanes(implementation, many))
    made.def_abstract_eval(shapes)
    ad.primitive_jvps[made] = derivative
    ad.primitive_transposes[made] = transposition
    batching.primitive_batchers[made] = _batching(made, states)
    return made


def _in_lanes(single: Callable[..., Any], many: bool) -> Callable[..., Any]:
    """The implementation of a primitive: itself, or in all lanes at once."""

    def implementation(*operands, simulator: Simulator, lanes: int | None, **options):
        if lanes is None:
            return single(*operands, simulator=simulator, **options)

        def solve(twin: Simulator, lane: int):
            return single(*(operand[lane] for operand in operands), simulator=twin, **options)

        results = run_lanes(simulator, lanes, solve)
        if not many:
            return jnp.stack(results)
        return [jnp.stack(parts) for parts in zip(*results, strict=True)]

    return implementation


def _batching(primitive: Primitive, states: Callable[..., int]) -> Callable[..., Any]:
    """The batching rule: of states, lanes; of right-hand sides at one state, one after the other.

    Args:
        states: how many of the first operands make a state, from the primitive's options.
    """

    def rule(operands, axes, *, simulator, lanes: int | None, **options):
        size = next(
            operand.shape[axis]
            for operand, axis in zip(operands, axes, strict=True)
            if axis is not batching.not_mapped
        )
        shared = all(axis is batching.not_mapped for axis in axes[: states(**options)])
        bind = functools.partial(primitive.bind, simulator=simulator, **options)
        if shared and lanes is None:
            results = [bind(*_pick_lane(operands, axes, k), lanes=None) for k in range(size)]
            if not primitive.multiple_results:
                return jnp.stack(results), 0
            stacked = [jnp.stack(parts) for parts in zip(*results, strict=True)]
            return stacked, [0] * len(stacked)
        # A batch of batches is one of all lanes; those that may share a state are neighbours.
        place = 0 if lanes is None else 1
        moved = [
            batching.bdim_at_front(operand, axis, size)
            for operand, axis in zip(operands, axes, strict=True)
        ]
        if lanes is not None:
            moved = [jnp.moveaxis(o, 0, 1).reshape(lanes * size, *o.shape[2:]) for o in moved]
        results = bind(*moved, lanes=size * (lanes or 1))

        def apart(result):
            return result if lanes is None else result.reshape(lanes, size, *result.shape[1:])

        if not primitive.multiple_results:
            return apart(results), place
        return [apart(result) for result in results], [place] * len(results)

    return rule


def _pick_lane(operands, axes, lane: int) -> list:
    return [
        operand
        if axis is batching.not_mapped
        else jax.lax.index_in_dim(operand, lane, axis, keepdims=False)
        for operand, axis in zip(operands, axes, strict=True)
    ]
