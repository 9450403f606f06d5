"""Which ONNX networks of others are run at all: plain feed-forward ones of bounded size, all weights inside.

Everything is checked on the parsed file, before any runtime sees it: no reference to another file, no operator that
loops, branches, draws or makes much of little, every size between known and small.
"""

from __future__ import annotations

from typing import Any

from desirepath.learning.errors import LearningError

OPERATORS = frozenset(
    {
        *("Gemm", "MatMul", "Add", "Sub", "Mul", "Div", "Neg", "Abs", "Sqrt", "Exp", "Log", "Clip", "Min", "Max"),
        *("Relu", "LeakyRelu", "PRelu", "Elu", "Selu", "Gelu", "Celu", "Tanh", "Sigmoid", "HardSigmoid", "Softplus"),
        *("Softsign", "HardSwish", "Mish", "Softmax", "LayerNormalization", "BatchNormalization"),
        *("Identity", "Cast", "Constant", "Flatten", "Reshape", "Squeeze", "Unsqueeze", "Transpose", "Concat", "Slice"),
        *("Gather", "Split", "ReduceSum", "ReduceMean"),
    }
)
"""None with a graph inside (Loop, If, Scan), none whose output's size its input's values decide without bound."""
MOST_NODES = 400
MOST_NUMBERS = 4_000_000  # weights
WIDEST = 16_384  # numbers per step between two operators
ROWS = 2048  # steps that are asked at once: their largest intermediate value is 134 MB


def check_network(content: bytes, width: int, named: str, outputs: int = 1) -> bytes:
    """The network with its batch fixed to ROWS rows, for the runtime. width, outputs: numbers per row.

    Raises LearningError that names what is wrong and what would work."""
    import onnx

    try:
        model = onnx.load_model_from_string(content)  # never follows external data
        _check(model, width, outputs)
    except LearningError:
        raise
    except Exception as problem:  # protobuf and onnx raise what they like for files of others
        why = (str(problem) or type(problem).__name__).splitlines()[0][:200]
        raise LearningError(f"{named}: no ONNX network of {width} inputs per step: {why}") from None
    return bytes(model.SerializeToString())


def _check(model: Any, width: int, outputs: int) -> None:
    import onnx

    graph = model.graph
    if model.functions or graph.sparse_initializer or model.training_info:
        raise ValueError("it holds functions, sparse weights or training; export the plain network")
    if len(graph.node) > MOST_NODES:
        raise ValueError(f"{len(graph.node)} operators; at most {MOST_NODES} are run")
    tensors = list(graph.initializer)
    for node in graph.node:
        if node.domain not in ("", "ai.onnx") or node.op_type not in OPERATORS:
            name = f"{node.domain}.{node.op_type}" if node.domain else node.op_type
            raise ValueError(f"operator {name} is not run; allowed are {', '.join(sorted(OPERATORS))}")
        if len({attribute.name for attribute in node.attribute}) < len(node.attribute):
            # Of two, the runtime takes the first and whoever infers sizes the last.
            raise ValueError(f"operator {node.op_type} has an attribute twice")
        for attribute in node.attribute:
            kind = attribute.type
            if kind in (onnx.AttributeProto.GRAPH, onnx.AttributeProto.GRAPHS) or attribute.ref_attr_name:
                raise ValueError(f"operator {node.op_type} holds a graph in {attribute.name!r}")
            if kind in (onnx.AttributeProto.SPARSE_TENSOR, onnx.AttributeProto.SPARSE_TENSORS):
                raise ValueError(f"operator {node.op_type} holds sparse weights")
            tensors += [attribute.t] if kind == onnx.AttributeProto.TENSOR else list(attribute.tensors)
    _check_weights(tensors)
    weights = {tensor.name for tensor in graph.initializer}
    inputs = [one for one in graph.input if one.name not in weights]
    if len(inputs) != 1 or len(graph.output) != 1:
        raise ValueError(f"needed are one input (n, {width}) and one output (n, {outputs}), without a memory")
    _check_sizes(model, inputs[0], width, outputs)


def _check_weights(tensors: list[Any]) -> None:
    import onnx

    numbers = 0
    for tensor in tensors:
        if tensor.data_location == onnx.TensorProto.EXTERNAL or tensor.external_data:
            raise ValueError(f"weights {tensor.name!r} stand in another file; export them inside the network's")
        count = 1
        for size in tensor.dims:
            if not 0 <= size <= MOST_NUMBERS:
                raise ValueError(f"weights {tensor.name!r} have a dimension of {size}")
            count *= size
        numbers += count
        if numbers > MOST_NUMBERS:
            raise ValueError(f"more than {MOST_NUMBERS:,} weights; at most so many are read")
        stored = len(tensor.raw_data) or sum(
            len(getattr(tensor, field))
            for field in ("float_data", "int32_data", "int64_data", "double_data", "uint64_data", "string_data")
        )
        if stored < count or tensor.data_type == onnx.TensorProto.STRING:
            raise ValueError(f"weights {tensor.name!r} have {count:,} numbers and {stored:,} stored")


def _check_sizes(model: Any, given: Any, width: int, outputs: int) -> None:
    """Fix the batch and infer every size between, so that what is too large is refused before it is made."""
    import onnx

    tensor = given.type.tensor_type
    if tensor.elem_type != onnx.TensorProto.FLOAT or len(tensor.shape.dim) not in (0, 2):
        raise ValueError(f"its input must be (n, {width}) float32")
    stated = [one.dim_value for one in tensor.shape.dim]
    if len(stated) == 2 and stated[1] not in (0, width):
        raise ValueError(f"its input is (n, {stated[1]}); the manifest's inputs are {width}")
    del model.graph.value_info[:]
    for one in (given, *model.graph.output):
        one.type.tensor_type.ClearField("shape")
    for size in (ROWS, width):
        tensor.shape.dim.add().dim_value = size
    known = onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True, data_prop=True).graph
    shapes = {one.name: one.type.tensor_type.shape for one in (*known.value_info, *known.output)}
    for node in model.graph.node:
        for name in filter(None, node.output):
            if name not in shapes:
                raise ValueError(f"the size of {name!r} ({node.op_type}) cannot be known beforehand")
            count = 1
            for dim in shapes[name].dim:
                if not dim.HasField("dim_value"):
                    raise ValueError(f"the size of {name!r} ({node.op_type}) cannot be known beforehand")
                count *= dim.dim_value
            if count > ROWS * WIDEST:
                raise ValueError(
                    f"{name!r} ({node.op_type}) has {count // ROWS:,} numbers per step; at most {WIDEST:,}"
                )
    (output,) = model.graph.output
    sizes = [dim.dim_value for dim in shapes[output.name].dim]
    if sizes != [ROWS, outputs] and (outputs > 1 or sizes != [ROWS]):
        raise ValueError(f"needed is an output (n, {outputs}) for n steps; it gives {tuple(sizes)} for {ROWS}")
