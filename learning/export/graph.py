"""A small builder of ONNX graphs: operators as calls, constants as arrays, reproducible bytes."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
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

    def input(self, name: str, width: int) -> str:
        """Add an input of shape (batch, width)."""
        self._inputs.append(self._row(name, width))
        return name

    def output(self, name: str, width: int, kind: str, *inputs: str, **attributes: Any) -> None:
        """Add an operator whose single output, of shape (batch, width), is a named output of the
        graph."""
        node = helper.make_node(kind, inputs, [name], name=name, **attributes)
        self._nodes.append(node)
        self._outputs.append(self._row(name, width))

    def floats(self, values: ArrayLike) -> str:
        """Add a float32 constant."""
        return self._constant(np.asarray(values, dtype=np.float32))

    def integers(self, *values: int) -> str:
        """Add a constant vector of int64: sizes, indices, axes."""
        return self._constant(np.asarray(values, dtype=np.int64))

    def op(self, kind: str, *inputs: str, **attributes: Any) -> str:
        """Add an operator with one output."""
        return self._node(kind, inputs, 1, attributes)[0]

    def split(self, value: str, sizes: list[int], axis: int) -> list[str]:
        """Split a tensor along an axis; parts of size 0 are ""."""
        present = [n for n in sizes if n]
        if len(present) == 1:
            parts = iter([value])
        else:
            names = self._node(
                "Split", (value, self.integers(*present)), len(present), {"axis": axis}
            )
            parts = iter(names)
        return [next(parts) if n else "" for n in sizes]

    def concat(self, *values: str, axis: int) -> str:
        """Concatenate tensors; empty names are ignored."""
        present = [v for v in values if v]
        return present[0] if len(present) == 1 else self.op("Concat", *present, axis=axis)

    def columns(self, value: str, first: int, last: int) -> str:
        """Columns first to last - 1 of a matrix."""
        return self.op("Slice", value, self.integers(first), self.integers(last), self.integers(1))

    def reshape(self, value: str, *shape: int) -> str:
        """Reshape a tensor; 0 keeps the size of an axis, -1 is the remaining size."""
        return self.op("Reshape", value, self.integers(*shape))

    def transpose(self, value: str, *axes: int) -> str:
        """Transpose a tensor."""
        return self.op("Transpose", value, perm=list(axes))

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

    def _constant(self, values: NDArray[Any]) -> str:
        key = (values.tobytes(), values.dtype.name, values.shape)
        if key not in self._constants:
            self._constants[key] = name = f"constant_{len(self._constants)}"
            self._initializers.append(numpy_helper.from_array(values, name))
        return self._constants[key]

    def _node(
        self, kind: str, inputs: tuple[str, ...], outputs: int, attributes: Mapping[str, Any]
    ) -> list[str]:
        name = ".".join([*self._scope, f"{kind}_{len(self._nodes)}"])
        names = [f"{name}_{i}" for i in range(outputs)]
        self._nodes.append(helper.make_node(kind, inputs, names, name=name, **attributes))
        return names

    def _row(self, name: str, width: int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, [self._batch, width])
