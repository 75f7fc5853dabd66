"""A torch module as a force law: its operators to ONNX, and ONNX to the equations.

The module maps `twin.physics.residual_force.INPUTS`, shape (n, 12), to specific force, m/s2, and
angular acceleration, rad/s2, body FRD, shape (n, 6). ONNX is the interface: a file from elsewhere
is as good, if it has one input and one output of these shapes and the operators below. As an
expression of CasADi it is integrated, differentiated and written as C along with the airframe.
"""

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import helper, numpy_helper
from torch import nn
from torch.fx import Node

from twin.errors import ModelError
from twin.physics.residual_force import INPUTS, OUTPUTS

from ..export.graph import Graph

Array = NDArray[np.float64]
INPUT, OUTPUT = "motion", "accelerations"
"""Of the ONNX model."""
_ATEN = {
    **{f"{n}.Tensor": n.title() for n in ("add", "sub", "mul", "div")},
    **{f"{n}.default": n.title() for n in ("tanh", "relu", "sigmoid", "exp", "sqrt", "abs", "neg")},
    **{f"{n}.default": n.title() for n in ("sin", "cos")},
}
"""Operators of ATen and their names in ONNX."""
_EXPRESSIONS: dict[str, Callable[..., Any]] = {
    "Add": lambda a, b: a + b,
    "Sub": lambda a, b: a - b,
    "Mul": lambda a, b: a * b,
    "Div": lambda a, b: a / b,
    "MatMul": ca.mtimes,
    "Tanh": ca.tanh,
    "Relu": lambda a: ca.fmax(a, 0),
    "Sigmoid": lambda a: 1 / (1 + ca.exp(-a)),
    "Exp": ca.exp,
    "Sqrt": ca.sqrt,
    "Abs": ca.fabs,
    "Neg": lambda a: -a,
    "Sin": ca.sin,
    "Cos": ca.cos,
    "Concat": ca.horzcat,
}
"""Operators of ONNX on rows."""


def module_onnx(module: nn.Module) -> onnx.ModelProto:
    """The ONNX model of a module.

    Args:
        module: Of linear layers, `torch.cat(..., dim=1)` and the operators of `_ATEN`.

    Raises:
        ModelError: It has another operator, or other shapes.
    """
    example = torch.zeros(2, len(INPUTS))
    program = torch.export.export(module.eval(), (example,))
    with torch.no_grad():
        shape = tuple(module(example).shape)
    if shape != (2, len(OUTPUTS)):
        raise ModelError(
            f"{type(module).__name__}: makes {shape} of (2, {len(INPUTS)}), not "
            f"(2, {len(OUTPUTS)}): a row of six accelerations for each row of {len(INPUTS)} inputs."
        )
    graph, signature = Graph("force"), program.graph_signature
    stored = {**program.state_dict, **program.constants}
    names = {**signature.inputs_to_parameters, **signature.inputs_to_buffers}
    arrays = {n: stored[name].detach().numpy() for n, name in names.items()}
    values: dict[str, str] = {}
    for node in program.graph.nodes:
        if node.op == "placeholder" and node.name not in arrays:
            values[node.name] = graph.input(INPUT, len(INPUTS))
        elif node.op == "call_function":
            values[node.name] = _operator(graph, node, values, arrays)
        elif node.op == "output":
            graph.output(OUTPUT, len(OUTPUTS), "Identity", values[node.args[0][0].name])
    return graph.model("Specific force, m/s2, and angular acceleration, rad/s2, body FRD")


def _operator(
    graph: Graph, node: Node, values: Mapping[str, str], arrays: Mapping[str, NDArray[Any]]
) -> str:
    """One operator of ATen in ONNX; the name of its result.

    Args:
        graph: To which it is added.
        node: The operator.
        values: Names of results so far.
        arrays: Parameters of the module.
    """

    def given(value: Any) -> str:
        """An argument: a result, a parameter, or a number."""
        if not isinstance(value, Node):
            return graph.floats([[float(value)]])
        return values.get(value.name) or graph.floats(np.atleast_2d(arrays[value.name]))

    kind, arguments = str(node.target).removeprefix("aten."), list(node.args)
    if kind == "linear.default":
        x, weight, *bias = arguments
        product = graph.op("MatMul", given(x), graph.floats(arrays[weight.name].T))  # type: ignore[union-attr, index]
        return graph.op("Add", product, given(bias[0])) if bias else product
    if kind == "cat.default":
        return graph.concat(*(given(v) for v in arguments[0]), axis=1)  # type: ignore[union-attr]
    if kind not in _ATEN or node.kwargs:
        raise ModelError(
            f"the module's operator aten.{kind} is none that a force law may have: linear layers, "
            f"torch.cat along dimension 1, {', '.join(sorted(_ATEN.values()))}."
        )
    return graph.op(_ATEN[kind], *(given(v) for v in arguments))


def law_function(content: bytes) -> ca.Function:
    """`INPUTS` to six accelerations, columns, of an ONNX file.

    Raises:
        ModelError: It is none, or has other operators or shapes.
    """
    try:
        model = onnx.load_from_string(content)
        onnx.checker.check_model(model, full_check=True)
    except Exception as error:  # whatever protobuf and the checker raise
        raise ModelError(f"force law: the file is no ONNX model ({error}).") from None
    x = ca.SX.sym("x", len(INPUTS))
    (given,), (wanted,) = model.graph.input, model.graph.output
    values = {given.name: x.T}
    for constant in model.graph.initializer:
        values[constant.name] = ca.SX(np.atleast_2d(numpy_helper.to_array(constant).astype(float)))
    for node in model.graph.node:
        arguments = [values[name] for name in node.input]
        values[node.output[0]] = _expression(node, arguments)
    result = values[wanted.name]
    if result.shape != (1, len(OUTPUTS)):
        raise ModelError(
            f"force law: the ONNX model gives {result.shape}, not a row of {len(OUTPUTS)}."
        )
    return ca.Function("module", [x], [ca.densify(result.T)])


def _expression(node: onnx.NodeProto, arguments: list[ca.SX]) -> ca.SX:
    """What a node of ONNX says."""
    if node.op_type == "Identity":
        return arguments[0]
    if node.op_type == "Gemm":
        about = {a.name: helper.get_attribute_value(a) for a in node.attribute}
        a, b, *c = arguments
        a, b = (v.T if about.get(n) else v for v, n in ((a, "transA"), (b, "transB")))
        product: ca.SX = about.get("alpha", 1.0) * ca.mtimes(a, b)
        if c:
            product = product + about.get("beta", 1.0) * c[0]
        return product
    if node.op_type not in _EXPRESSIONS:
        raise ModelError(
            f"force law: ONNX operator {node.op_type} is none that a force law may have: Gemm, "
            f"{', '.join(sorted(_EXPRESSIONS))}."
        )
    result: ca.SX = _EXPRESSIONS[node.op_type](*arguments)
    return result
