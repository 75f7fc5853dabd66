"""The graph of an ONNX file from anywhere: judged before anything is made of it.

What is refused could run for ever, read other files, need memory without end or put somebody's text
into C: control flow, functions and operators of other domains, numbers in other files, tensors
without a fixed size, sizes and counts beyond bounds, numbers that are not finite, names that are no
identifiers. `onnx.checker` judges none of that.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import FmuError, install_command

from ..names import LONGEST_NAME, check_name, shown

Shape = tuple[int, ...]

INPUTS = ("virtual", "command", "phase", "measured", "valid", "state")
OUTPUTS = ("correction", "spread", "anomaly", "inside", "state_out")
MAX_FILE_BYTES = 256 * 2**20
"""The largest preset has 8 MB."""
MAX_NODES = 10_000
MAX_NUMBERS = 2**18
"""Of a tensor that is made at each sample: 1 MiB of the caller's stack. The largest preset has
5,218 in its state."""
_OPERATOR_DOMAINS = ("", "ai.onnx")
_WAY_OUT = "Use a file that uavtwin train wrote"


def parse_network(path: Path, content: bytes) -> Any:
    """The ONNX model in the bytes of a file, not judged yet.

    Raises:
        FmuError: It is no ONNX file, it is too large, or the package onnx is missing.
    """
    try:
        import onnx
        from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
    except ModuleNotFoundError as error:
        raise missing_package(error) from error
    if len(content) > MAX_FILE_BYTES:
        raise FmuError(
            f"{path}: {len(content)} bytes, at most {MAX_FILE_BYTES} are read. {_WAY_OUT}."
        )
    try:
        return onnx.load_model_from_string(content)
    except DecodeError as error:
        raise FmuError(f"{path}: damaged, or no ONNX file: {error}") from error


def take_one_sample(model: Any) -> None:
    """Let a model that takes any number of samples in a call take one, as an FMU does: the first
    axis of its inputs and outputs, where it has a name, gets the size 1."""
    for value in (*model.graph.input, *model.graph.output):
        shape = value.type.tensor_type.shape.dim
        if shape and shape[0].HasField("dim_param"):
            shape[0].dim_value = 1


def check_graph(path: Path, model: Any) -> None:
    """Whether the graph of a parsed file is one that can become an FMU.

    Raises:
        FmuError: It is not; the text says what of it.
    """
    import onnx

    _check_structure(path, model)
    for tensor in _tensors(model.graph):
        _check_numbers(path, tensor)
    for value in (*model.graph.input, *model.graph.output):
        _check_row(path, value)
    try:
        onnx.checker.check_model(model)
        inferred = onnx.shape_inference.infer_shapes(
            model, check_type=True, strict_mode=True, data_prop=True
        )
    except (onnx.checker.ValidationError, onnx.shape_inference.InferenceError) as error:
        raise FmuError(f"{path}: damaged, or no ONNX file: {error}") from error
    graph = inferred.graph
    known = {v.name for v in (*graph.input, *graph.output, *graph.value_info)}
    for value in graph.value_info:
        _check_size(path, value.name, _shape(value))
    for name in (name for node in graph.node for name in node.output):
        if name and name not in known:
            raise _refusal(path, f"tensor {name}", "unknown shape", "every shape must be fixed")


def row_widths(values: Any) -> dict[str, int]:
    """Inputs or outputs of a judged graph by name: each is one row of so many numbers."""
    return {v.name: _shape(v)[-1] for v in values}


def plain_copy(model: Any) -> Any:
    """The same operators and numbers without any text of its author.

    Tensors between inputs and outputs are numbered. Names of nodes, metadata and descriptions are
    left out: the C generator writes all of them into comments as they are.
    """
    import onnx

    names: dict[str, str] = {"": ""} | {n: n for n in (*INPUTS, *OUTPUTS)}
    for node in model.graph.node:
        for name in (*node.input, *node.output):
            names.setdefault(name, f"tensor_{len(names)}")
    nodes = []
    for node in model.graph.node:
        attributes = []
        for attribute in node.attribute:
            copy = onnx.AttributeProto()
            copy.CopyFrom(attribute)
            copy.ClearField("doc_string")
            if copy.HasField("t"):
                array = onnx.numpy_helper.to_array(attribute.t)
                copy.t.CopyFrom(onnx.numpy_helper.from_array(array))
            attributes.append(copy)
        fresh = onnx.NodeProto(op_type=node.op_type, domain=node.domain, attribute=attributes)
        fresh.input.extend(names[name] for name in node.input)
        fresh.output.extend(names[name] for name in node.output)
        nodes.append(fresh)
    numbers = []
    for tensor in (t for t in model.graph.initializer if t.name in names):
        array = onnx.numpy_helper.to_array(tensor)
        numbers.append(onnx.numpy_helper.from_array(array, names[tensor.name]))

    def row(value: Any) -> Any:
        """An input or output, its name and shape alone."""
        return onnx.helper.make_tensor_value_info(
            value.name, onnx.TensorProto.FLOAT, list(_shape(value))
        )

    graph = onnx.helper.make_graph(
        nodes,
        "network",
        [row(v) for v in model.graph.input],
        [row(v) for v in model.graph.output],
        numbers,
    )
    opsets = [onnx.helper.make_opsetid("", o.version) for o in model.opset_import]
    return onnx.helper.make_model(graph, opset_imports=opsets, ir_version=model.ir_version)


def check_names(path: Path, graph: Any) -> None:
    """Whether all names and texts in a graph are identifiers.

    Raises:
        FmuError: One is not.
    """
    for node in graph.node:
        check_name(f"{path}: operator", node.op_type)
        for name in filter(None, (node.name, *node.input, *node.output)):
            check_name(f"{path}: name in the graph", name)
        for attribute in node.attribute:
            where = f"{path}: attribute of {node.op_type}"
            check_name(where, attribute.name)
            for text in filter(None, (attribute.s, *attribute.strings)):
                check_name(where, text.decode("ascii", "replace"))
    for named in (*graph.initializer, *graph.input, *graph.output, *graph.value_info):
        check_name(f"{path}: name in the graph", named.name)


def missing_package(error: ModuleNotFoundError) -> FmuError:
    """What to say where a package is not installed."""
    return FmuError(
        f"a compensator needs the package {error.name}: {install_command('learn')}. To export one "
        f"that is trained, onnx and emx-onnx-cgen are enough."
    )


# -- one thing each -------------------------------------------------------------------------


def _check_structure(path: Path, model: Any) -> None:
    """Operators of ONNX alone, in one flat graph."""
    graph = model.graph
    for what, found, most in (
        ("functions", len(model.functions), 0),
        ("training graphs", len(model.training_info), 0),
        ("sparse tensors", len(graph.sparse_initializer), 0),
        ("operators", len(graph.node), MAX_NODES),
        ("inputs", len(graph.input), len(INPUTS)),
        ("outputs", len(graph.output), len(OUTPUTS)),
    ):
        if found > most:
            raise _refusal(path, what, found, f"there may be {most}")
    check_names(path, graph)
    domains = [*(o.domain for o in model.opset_import), *(n.domain for n in graph.node)]
    for domain in domains:
        if domain not in _OPERATOR_DOMAINS:
            raise _refusal(path, "domain of an operator", domain, "only those of ONNX are run")
    for node in graph.node:
        for attribute in node.attribute:
            if attribute.ref_attr_name or attribute.type not in _attribute_types():
                raise _refusal(
                    path,
                    f"attribute of {node.op_type}",
                    attribute.name,
                    "numbers, tensors and names alone may stand there, no graphs",
                )
            if not all(map(math.isfinite, (attribute.f, *attribute.floats))):
                raise _refusal(path, attribute.name, "not finite", "numbers must be finite")


def _attribute_types() -> tuple[int, ...]:
    from onnx import AttributeProto as Kind

    return (Kind.FLOAT, Kind.INT, Kind.STRING, Kind.TENSOR, Kind.FLOATS, Kind.INTS, Kind.STRINGS)


def _tensors(graph: Any) -> Iterator[Any]:
    """Every tensor of numbers: weights, and constants among the attributes of operators."""
    yield from graph.initializer
    for node in graph.node:
        yield from (a.t for a in node.attribute if a.HasField("t"))


def _check_numbers(path: Path, tensor: Any) -> None:
    """In the file itself, of a type that networks have, as many as said, finite."""
    import onnx

    kind = onnx.TensorProto
    where = f"tensor {tensor.name}"
    if tensor.data_location != kind.DEFAULT or tensor.external_data:
        raise _refusal(path, where, "in another file", "all numbers must be in this one")
    known = ("FLOAT", "INT64", "INT32", "INT8", "UINT8", "BOOL")
    if tensor.data_type not in [kind.DataType.Value(name) for name in known]:
        name = kind.DataType.Name(tensor.data_type) if tensor.data_type in _types() else "unknown"
        raise _refusal(path, f"type of {where}", name, f"{', '.join(known)} are known")
    if any(d < 0 for d in tensor.dims):
        raise _refusal(path, f"shape of {where}", tuple(tensor.dims), "no size may be negative")
    try:
        values = onnx.numpy_helper.to_array(tensor)
    except (ValueError, TypeError) as error:
        raise FmuError(f"{path}: damaged: {where}, shape {tuple(tensor.dims)}: {error}.") from error
    if not np.isfinite(values).all():
        bad = values[~np.isfinite(values)]
        raise _refusal(path, where, f"{bad[0]} in {bad.size} places", "weights must be finite")


def _types() -> list[int]:
    from onnx import TensorProto

    return list(TensorProto.DataType.values())


def _check_row(path: Path, value: Any) -> None:
    """An input or output: one row of float32."""
    import onnx

    if value.type.tensor_type.elem_type != onnx.TensorProto.FLOAT:
        raise _refusal(path, f"type of {value.name}", "not float32", "it must be FLOAT")
    shape = _shape(value)
    if len(shape) != 2 or shape[0] != 1:
        raise _refusal(path, f"shape of {value.name}", shape, "it must be one row, (1, n)")
    _check_size(path, value.name, shape)


def _check_size(path: Path, name: str, shape: Shape) -> None:
    if any(d < 1 for d in shape):
        raise _refusal(path, f"shape of {name}", shape, "every size must be fixed and 1 or more")
    if math.prod(shape) > MAX_NUMBERS:
        raise _refusal(path, f"size of {name}", shape, f"at most {MAX_NUMBERS} numbers are held")


def _shape(value: Any) -> Shape:
    """Sizes of a tensor, 0 where one is not fixed."""
    return tuple(d.dim_value for d in value.type.tensor_type.shape.dim)


def _refusal(path: Path, quantity: str, value: object, need: str) -> FmuError:
    return FmuError(
        f"{path}: refused: {quantity[: 2 * LONGEST_NAME]} = {shown(value)}; {need}. {_WAY_OUT}."
    )
