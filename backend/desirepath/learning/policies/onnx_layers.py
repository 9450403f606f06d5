"""Linear layers as ONNX, and back: which plain graphs are layers one after another, alone or behind two branches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

ONNX_OPSET = 17
IR_VERSION = 10  # what onnxruntime >= 1.18 reads
ACTIVATIONS = ("Relu", "Tanh", "Elu", "LeakyRelu", "Sigmoid")
Floats = NDArray[np.float32]


class Layer(NamedTuple):
    """weight (inputs, outputs), bias (outputs,), ONNX's name of the activation behind it or nothing."""

    weight: Floats
    bias: Floats
    activation: str


class TwoBranches(NamedTuple):
    """The first `split` inputs through one branch, the others through another, then both through the head."""

    split: int
    task: Sequence[Layer]
    lidar: Sequence[Layer]
    head: Sequence[Layer]


def onnx_of_layers(found: Sequence[Layer] | TwoBranches) -> onnx.ModelProto:
    """A graph `observation (n, obs) -> action (n, 2)`; what no activation ends is clipped to [-1, 1]."""
    nodes: list[onnx.NodeProto] = []
    weights: list[onnx.TensorProto] = []

    def through(x: str, layers: Sequence[Layer], named: str) -> str:
        for number, one in enumerate(layers):
            parameters = [f"p{len(weights)}", f"p{len(weights) + 1}"]
            arrays = zip(parameters, one[:2], strict=True)
            weights.extend(numpy_helper.from_array(np.ascontiguousarray(array), name) for name, array in arrays)
            nodes.append(helper.make_node("Gemm", [x, *parameters], [x := f"{named}_{number}_linear"]))
            if one.activation:
                nodes.append(helper.make_node(one.activation, [x], [x := f"{named}_{number}"]))
        return x

    if isinstance(found, TwoBranches):
        inputs = found.task[0].weight.shape[0] + found.lidar[0].weight.shape[0]
        sizes = np.array([found.split, inputs - found.split], dtype=np.int64)
        nodes.append(helper.make_node("Split", ["observation", "split_sizes"], ["task", "lidar"], axis=1))
        parts = [through("task", found.task, "task"), through("lidar", found.lidar, "lidar")]
        nodes.append(helper.make_node("Concat", parts, ["features"], axis=1))
        last = through("features", found.head, "head")
        weights.append(numpy_helper.from_array(sizes, "split_sizes"))
    else:
        inputs = found[0].weight.shape[0]
        last = through("observation", found, "layer")
    if nodes[-1].op_type == "Gemm":
        for name, bound in (("lowest", -1.0), ("highest", 1.0)):
            weights.append(numpy_helper.from_array(np.array(bound, dtype=np.float32), name))
        nodes.append(helper.make_node("Clip", [last, "lowest", "highest"], ["action"]))
    else:
        nodes[-1].output[0] = "action"
    graph = helper.make_graph(
        nodes,
        "desirepath_policy",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["n", inputs])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["n", 2])],
        weights,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", ONNX_OPSET)], producer_name="desirepath")
    model.ir_version = IR_VERSION
    onnx.checker.check_model(model)
    return model


@dataclass(frozen=True)
class _Value:
    """What a name in the graph stands for: layers behind inputs `first` to `last`, or behind two such values."""

    first: int
    last: int
    layers: tuple[Layer, ...] = ()
    joined: tuple[_Value, _Value] | None = None

    @property
    def raw(self) -> bool:
        return not self.layers and self.joined is None


def layers_of(model: Any, inputs: int) -> list[Layer] | TwoBranches | None:
    """The layers of a graph that `onnx_bounds.py` has checked, None where it is made of anything else."""
    graph = model.graph
    constants = {one.name: numpy_helper.to_array(one) for one in graph.initializer}
    (given,) = [one.name for one in graph.input if one.name not in constants]
    values = {given: _Value(0, inputs)}
    try:
        for node in graph.node:
            _apply(node, values, constants)
        found = values[graph.output[0].name]
        if found.joined is None:
            return list(found.layers) if (found.first, found.last) == (0, inputs) else None
        task, lidar = found.joined
    except (KeyError, ValueError, IndexError, TypeError):  # an operator, or a use of one, that layers do not have
        return None
    whole = task.first == 0 and task.last == lidar.first and lidar.last == inputs and not (task.joined or lidar.joined)
    return TwoBranches(task.last, task.layers, lidar.layers, found.layers) if whole else None


def _apply(node: Any, values: dict[str, _Value], constants: dict[str, NDArray[Any]]) -> None:
    """Say what the node's outputs stand for. Raises KeyError or ValueError for what layers do not do."""
    options = {one.name: helper.get_attribute_value(one) for one in node.attribute}
    if node.op_type == "Constant":
        constants[node.output[0]] = numpy_helper.to_array(options["value"])
        return
    x = values[node.input[0]] if node.input[0] in values else values[node.input[1]]
    match node.op_type:
        case "Gemm" | "MatMul":
            if (
                node.input[0] not in values
                or options.get("transA")
                or {options.get(k, 1.0) for k in ("alpha", "beta")} != {1.0}
            ):
                raise ValueError
            weight = constants[node.input[1]]
            weight = _plain(weight.T if options.get("transB") else weight, 2)
            bias = constants[node.input[2]] if len(node.input) > 2 else np.zeros(1, np.float32)
            bias = np.broadcast_to(_plain(bias.reshape(-1), 1), weight.shape[1:])
            made = replace(x, layers=(*x.layers, Layer(weight, bias, "")))
        case "Add":
            added = constants[node.input[1] if node.input[0] in values else node.input[0]]
            *before, last = x.layers
            if last.activation:
                raise ValueError
            bias = last.bias + np.broadcast_to(_plain(added.reshape(-1), 1), last.bias.shape)
            made = replace(x, layers=(*before, last._replace(bias=bias)))
        case "Relu" | "Tanh":
            *before, last = x.layers
            if last.activation:
                raise ValueError
            made = replace(x, layers=(*before, last._replace(activation=node.op_type)))
        case "Identity":
            made = x
        case "Flatten" if options.get("axis", 1) == 1:
            made = x
        case "Split" if x.raw and options.get("axis", 0) in (1, -1):
            first = x.first
            for name, size in zip(node.output, constants[node.input[1]].tolist(), strict=True):
                values[name] = _Value(first, first + size)
                first += size
            return
        case "Slice" if x.raw:
            starts, ends, axes, *steps = (constants[name].tolist() for name in node.input[1:])
            if axes not in ([1], [-1]) or steps not in ([], [[1]]):
                raise ValueError
            size = x.last - x.first
            first, last_ = (max(0, min(one if one >= 0 else one + size, size)) for one in (starts[0], ends[0]))
            made = _Value(x.first + first, x.first + last_)
        case "Concat" if len(node.input) == 2 and options["axis"] in (1, -1):
            made = _Value(0, 0, (), (values[node.input[0]], values[node.input[1]]))
        case _:
            raise ValueError
    values[node.output[0]] = made


def _plain(array: NDArray[Any], dimensions: int) -> Floats:
    if array.ndim != dimensions or array.dtype.kind != "f":
        raise ValueError
    return array.astype(np.float32)
