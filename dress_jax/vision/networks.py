"""Convolutional networks as data: a list of operations and an archive of weights, run by JAX.

Only the operations that the embedded networks use exist. Pixels are channels-last, weights are
(rows, columns, inputs per group, outputs), everything is single precision.
"""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from dress_jax.core.errors import InputError

Pair = tuple[int, int]
ACTIVATIONS = ("none", "relu", "relu6", "sigmoid")
OPERATIONS = ("conv", "add", "concat", "pad", "resize", "max_pool", "reshape", "activate")


@dataclasses.dataclass(frozen=True)
class Node:
    """One operation.

    Args:
        operation: one of `OPERATIONS`.
        inputs: names of earlier outputs.
        output: its own name.
        weights: names of the kernel and the bias of a convolution.
        activation: applied to the result, one of `ACTIVATIONS`.
        stride, dilation: of a convolution; the stride of a pooling window [px].
        padding: zeros before and after rows and columns [px].
        groups: of channels; as many as inputs in a depthwise convolution.
        size: rows and columns of a resized picture or a pooling window; the shape, without the
            batch, of a reshaped array.
    """

    operation: str
    inputs: tuple[str, ...]
    output: str
    weights: tuple[str, ...] = ()
    activation: str = "none"
    stride: Pair = (1, 1)
    dilation: Pair = (1, 1)
    padding: tuple[Pair, Pair] = ((0, 0), (0, 0))
    groups: int = 1
    size: tuple[int, ...] = ()


@dataclasses.dataclass(frozen=True)
class Graph:
    """The operations in the order in which they run; hashable, so that it compiles once.

    Args:
        nodes: each uses the input or what stands before it.
        input: name of the picture.
        input_size: its rows and columns [px].
        outputs: names of what `run_network` returns.
    """

    nodes: tuple[Node, ...]
    input: str
    input_size: Pair
    outputs: tuple[str, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Network:
    """A graph and its weights.

    Raises:
        InputError: an operation is unknown, or uses what is not there.
    """

    graph: Graph
    weights: Mapping[str, Float[np.ndarray, "..."]]

    def __post_init__(self) -> None:
        known = {self.graph.input}
        for node in self.graph.nodes:
            where = f"network, '{node.output}'"
            if node.operation not in OPERATIONS or node.activation not in ACTIVATIONS:
                raise InputError(
                    f"is {node.operation} with {node.activation}, which are not known", where=where
                )
            absent = [name for name in node.inputs if name not in known]
            absent += [name for name in node.weights if name not in self.weights]
            if absent:
                raise InputError(f"uses {', '.join(absent)}, which is not there", where=where)
            known.add(node.output)
        absent = [name for name in self.graph.outputs if name not in known]
        if absent:
            raise InputError(f"lacks its output {', '.join(absent)}", where="network")


def graph_from_document(document: Mapping[str, Any]) -> Graph:
    """A graph out of what `graph_document` made.

    Raises:
        InputError: it is no such document.
    """
    try:
        return Graph(
            nodes=tuple(Node(**{k: _frozen(v) for k, v in n.items()}) for n in document["nodes"]),
            input=document["input"],
            input_size=tuple(document["input_size"]),
            outputs=tuple(document["outputs"]),
        )
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError("is no description of a network", where="network") from error


def graph_document(graph: Graph) -> dict[str, Any]:
    """The graph as plain lists and dictionaries; what has its default value is left out."""
    defaults = {field.name: field.default for field in dataclasses.fields(Node)}
    nodes = [
        {k: v for k, v in dataclasses.asdict(node).items() if v != defaults[k]}
        for node in graph.nodes
    ]
    return {**dataclasses.asdict(graph), "nodes": nodes}


def run_network(network: Network, pictures: Float[np.ndarray, "b h w 3"]) -> tuple[np.ndarray, ...]:
    """The outputs of a network, in single precision whatever the precision of the program.

    Args:
        network: see `Network`.
        pictures: in the range that the network was trained with, shape (b, h, w, 3).

    Raises:
        InputError: the pictures have another size than the network's.
    """
    pictures = np.asarray(pictures, np.float32)
    if pictures.ndim != 4 or pictures.shape[1:] != (*network.graph.input_size, 3):
        raise InputError(
            f"have shape {pictures.shape}, the network takes (b, "
            f"{', '.join(map(str, network.graph.input_size))}, 3)",
            where="pictures",
        )
    weights = {name: np.asarray(array, np.float32) for name, array in network.weights.items()}
    return tuple(np.asarray(output) for output in _run(network.graph, weights, pictures))


@functools.partial(jax.jit, static_argnums=0)
def _run(
    graph: Graph, weights: Mapping[str, Float[Array, "..."]], pictures: Float[Array, "b h w 3"]
) -> tuple[Float[Array, "..."], ...]:
    values: dict[str, Array] = {graph.input: pictures}
    for node in graph.nodes:
        operands = [values[name] for name in node.inputs]
        result = _apply(node, operands, [weights[name] for name in node.weights])
        values[node.output] = _activate(node.activation, result)
    return tuple(values[name] for name in graph.outputs)


def _apply(node: Node, operands: Sequence[Array], weights: Sequence[Array]) -> Array:
    first = operands[0]
    match node.operation:
        case "conv":
            kernel, bias = weights
            result = jax.lax.conv_general_dilated(
                first,
                kernel,
                window_strides=node.stride,
                padding=node.padding,
                rhs_dilation=node.dilation,
                dimension_numbers=("NHWC", "HWIO", "NHWC"),
                feature_group_count=node.groups,
            )
            return result + bias[None, None, None]
        case "add":
            return operands[0] + operands[1]
        case "concat":
            return jnp.concatenate(operands, axis=-1)
        case "pad":
            return jnp.pad(first, ((0, 0), *node.padding, (0, 0)))
        case "resize":
            # Bilinear with half-pixel centres, as both networks were trained.
            shape = (first.shape[0], *node.size, first.shape[-1])
            return jax.image.resize(first, shape, "linear", antialias=False)
        case "max_pool":
            return jax.lax.reduce_window(
                first,
                -jnp.inf,
                jax.lax.max,
                (1, *node.size, 1),
                (1, *node.stride, 1),
                ((0, 0), *node.padding, (0, 0)),
            )
        case "reshape":
            return first.reshape(first.shape[0], *node.size)
    return first


def _activate(kind: str, values: Array) -> Array:
    match kind:
        case "relu":
            return jnp.maximum(values, 0.0)
        case "relu6":
            return jnp.clip(values, 0.0, 6.0)
        case "sigmoid":
            return jax.nn.sigmoid(values)
    return values


def _frozen(value: Any) -> Any:
    return tuple(_frozen(item) for item in value) if isinstance(value, list) else value
