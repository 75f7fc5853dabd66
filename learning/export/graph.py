"""A small builder of ONNX graphs: operators as Python's own, constants as arrays, reproducible
bytes."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import onnx
from numpy.typing import ArrayLike, NDArray
from onnx import TensorProto, helper, numpy_helper

OPSET = 17
"""Operator set of ONNX 1.12, 2022; onnxruntime 1.12 and later support it."""
IR_VERSION = 8
"""Version of the file format of ONNX 1.12."""


BATCH = "batch"
"""Name of the first axis of every input and output."""


def _operator(kind: str) -> "Callable[[Value, Operand], Value]":
    """Method that adds an operator with two inputs."""
    return lambda self, other: self.graph.op(kind, self, other)


@dataclass(frozen=True, slots=True, eq=False)
class Value:
    """A tensor of a graph; arithmetic adds an operator, and numbers become constants.

    Attributes:
        graph: Graph of the tensor.
        name: Name of the tensor in the graph.
    """

    graph: "Graph"
    name: str

    __add__ = _operator("Add")
    __sub__ = _operator("Sub")
    __mul__ = _operator("Mul")
    __truediv__ = _operator("Div")
    __matmul__ = _operator("MatMul")
    __gt__ = _operator("Greater")
    __lt__ = _operator("Less")
    __le__ = _operator("LessOrEqual")

    def clip(self, least: "Operand", most: "Operand") -> "Value":
        """Elementwise limits, arrays or numbers."""
        return self.graph.op("Min", self.graph.op("Max", self, least), most)

    def floats(self) -> "Value":
        """Booleans as numbers."""
        return self.graph.op("Cast", self, to=TensorProto.FLOAT)

    def sum(self, axis: int, keep: int = 1) -> "Value":
        """Sum along an axis, which remains with size 1 if `keep`."""
        return self.graph.op("ReduceSum", self, self.graph.integers(axis), keepdims=keep)

    def largest(self, axis: int) -> "Value":
        """Largest number along an axis, which remains with size 1."""
        return self.graph.op("ReduceMax", self, axes=[axis], keepdims=1)

    def columns(self, first: int, last: int) -> "Value":
        """Places first to last - 1 along axis 1."""
        ends = (self.graph.integers(n) for n in (first, last, 1))
        return self.graph.op("Slice", self, *ends)

    def gather(self, *places: int) -> "Value":
        """Places along axis 1."""
        return self.graph.op("Gather", self, self.graph.integers(*places), axis=1)

    def reshape(self, *shape: int) -> "Value":
        """Reshape; 0 keeps the size of an axis, -1 is the remaining size."""
        return self.graph.op("Reshape", self, self.graph.integers(*shape))

    def transpose(self, *axes: int) -> "Value":
        """Permute the axes."""
        return self.graph.op("Transpose", self, perm=list(axes))


Operand = Value | ArrayLike
"""A tensor, or numbers that become a constant: a number has shape (1, 1), a vector is a row."""


class Graph:
    """A graph of float32 tensors that grows by one operator per call.

    Operators and their outputs are named after their layer: "encoder.layer_0.MatMul_12", inside a
    `scope`.

    Args:
        name: Name of the graph.
        batch: Number of samples per call; None: any number, a dynamic axis named "batch".
    """

    def __init__(self, name: str, batch: int | None = None) -> None:
        self.name, self._batch = name, BATCH if batch is None else batch
        self._scope: list[str] = []
        self._nodes: list[onnx.NodeProto] = []
        self._constants: dict[tuple[bytes, str, tuple[int, ...]], str] = {}
        self._initializers: list[onnx.TensorProto] = []
        self._inputs: list[onnx.ValueInfoProto] = []
        self._outputs: list[onnx.ValueInfoProto] = []

    def input(self, name: str, width: int) -> Value:
        """Add an input of shape (batch, width)."""
        self._inputs.append(self._row(name, width))
        return Value(self, name)

    def output(self, name: str, width: int, kind: str, *inputs: Operand, **attributes: Any) -> None:
        """Add an operator whose single output, of shape (batch, width), is a named output of the
        graph."""
        given = [self._named(value) for value in inputs]
        self._nodes.append(helper.make_node(kind, given, [name], name=name, **attributes))
        self._outputs.append(self._row(name, width))

    def floats(self, values: ArrayLike) -> Value:
        """Add a float32 constant."""
        return self._constant(np.asarray(values, dtype=np.float32))

    def integers(self, *values: int) -> Value:
        """Add a constant vector of int64: sizes, indices, axes."""
        return self._constant(np.asarray(values, dtype=np.int64))

    def op(self, kind: str, *inputs: Operand, **attributes: Any) -> Value:
        """Add an operator with one output."""
        return self._node(kind, inputs, 1, attributes)[0]

    def split(self, value: Value, sizes: Sequence[int], axis: int) -> list[Value]:
        """Split a tensor along an axis into parts of 1 or more."""
        if len(sizes) == 1:
            return [value]
        return self._node("Split", (value, self.integers(*sizes)), len(sizes), {"axis": axis})

    def parts(self, row: Value, sizes: Mapping[str, int]) -> dict[str, Value]:
        """Parts of a row by name, without those of size 0."""
        present = {name: size for name, size in sizes.items() if size}
        return dict(zip(present, self.split(row, list(present.values()), 1), strict=True))

    def concat(self, *values: Value | None, axis: int) -> Value:
        """Concatenate tensors; None is ignored."""
        present = [v for v in values if v is not None]
        return present[0] if len(present) == 1 else self.op("Concat", *present, axis=axis)

    @contextmanager
    def scope(self, layer: str) -> Iterator[None]:
        """Put the operators inside into a layer, nested in the enclosing one."""
        self._scope.append(layer)
        try:
            yield
        finally:
            self._scope.pop()

    def model(self, description: str) -> onnx.ModelProto:
        """The finished model, checked.

        Raises:
            onnx.checker.ValidationError: An operator does not fit its inputs.
        """
        graph = helper.make_graph(
            self._nodes, self.name, self._inputs, self._outputs, self._initializers
        )
        model = helper.make_model(
            graph,
            opset_imports=[helper.make_opsetid("", OPSET)],
            ir_version=IR_VERSION,
            producer_name="uavtwin",
            doc_string=description,
        )
        onnx.checker.check_model(model, full_check=True)
        return model

    def _named(self, value: Operand) -> str:
        """Name of a tensor, or of a constant."""
        if isinstance(value, Value):
            return value.name
        array = np.asarray(value)
        return self.floats(array[None] if array.ndim == 1 else np.atleast_2d(array)).name

    def _constant(self, values: NDArray[Any]) -> Value:
        key = (values.tobytes(), values.dtype.name, values.shape)
        if key not in self._constants:
            self._constants[key] = name = f"constant_{len(self._constants)}"
            self._initializers.append(numpy_helper.from_array(values, name))
        return Value(self, self._constants[key])

    def _node(
        self, kind: str, inputs: Sequence[Operand], outputs: int, attributes: Mapping[str, Any]
    ) -> list[Value]:
        given = [self._named(value) for value in inputs]
        name = ".".join([*self._scope, f"{kind}_{len(self._nodes)}"])
        names = [f"{name}_{i}" for i in range(outputs)]
        self._nodes.append(helper.make_node(kind, given, names, name=name, **attributes))
        return [Value(self, n) for n in names]

    def _row(self, name: str, width: int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, [self._batch, width])
