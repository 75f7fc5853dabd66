"""A torch module as a force law: conversion of its operators to ONNX, and of ONNX to CasADi.

The module maps `twin.physics.residual_force.INPUTS`, shape (n, 12), to specific force, m/s2, and
angular acceleration, rad/s2, body FRD, shape (n, 6). ONNX is the interface: any file with one input
and one output of these shapes and the operators below can be used. As a CasADi expression it is
integrated, differentiated and written as C together with the airframe.
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
from torch.export import ExportedProgram
from torch.fx import Node

from twin.errors import ModelError
from twin.physics.residual_force import INPUTS, OUTPUTS

from ..export.graph import Graph, Value

Array = NDArray[np.float64]
INPUT, OUTPUT = "motion", "accelerations"
"""Input and output names of the ONNX model."""
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
"""CasADi expressions of the ONNX operators, on rows."""


def module_onnx(module: nn.Module) -> onnx.ModelProto:
    """The ONNX model of a module.

    Args:
        module: Module of linear layers, `torch.cat(..., dim=1)` and the operators of `_ATEN`.

    Raises:
        ModelError: The module cannot be traced, or has another operator or other shapes.
    """
    program = _program(module)
    graph, signature = Graph("force"), program.graph_signature
    stored = {**program.state_dict, **program.constants}
    names = {
        **signature.inputs_to_parameters,
        **signature.inputs_to_buffers,
        **signature.inputs_to_lifted_tensor_constants,
    }
    values: dict[str, Value] = {}
    for node in program.graph.nodes:
        if node.op == "call_function":
            values[node.name] = _operator(graph, node, values)
        elif node.name in signature.user_inputs:
            values[node.name] = graph.input(INPUT, len(INPUTS))
        elif node.op == "placeholder" and node.users:
            array = stored[names[node.name]].detach().float().numpy()
            values[node.name] = graph.floats(np.atleast_2d(array))
    graph.output(OUTPUT, len(OUTPUTS), "Identity", values[signature.user_outputs[0]])
    return graph.model("Specific force, m/s2, and angular acceleration, rad/s2, body FRD")


def _program(module: nn.Module) -> ExportedProgram:
    """A module traced to operators of ATen on two rows.

    Raises:
        ModelError: The module cannot be traced, or gives other shapes.
    """
    kind, example = type(module).__name__, torch.zeros(2, len(INPUTS))
    try:
        with torch.no_grad():
            made = module.eval()(example)
        program = torch.export.export(module, (example,))
    except Exception as error:  # any error of forward or torch
        why = str(error).strip().partition("\n")[0]
        raise ModelError(
            f"{kind}: cannot be traced with float32 rows of shape (2, {len(INPUTS)}) ({why}). A "
            f"force law takes them on the CPU (`module.cpu().float()`), its first layer is "
            f"{len(INPUTS)} wide, and it does not branch on their values."
        ) from error
    shape = tuple(made.shape) if isinstance(made, torch.Tensor) else f"a {type(made).__name__}"
    if shape != (2, len(OUTPUTS)):
        raise ModelError(
            f"{kind}: makes {shape} of (2, {len(INPUTS)}), not (2, {len(OUTPUTS)}): a row of six "
            f"accelerations for each row of {len(INPUTS)} inputs."
        )
    return program


def _operator(graph: Graph, node: Node, values: Mapping[str, Value]) -> Value:
    """One operator of ATen in ONNX; returns its result.

    Args:
        graph: Graph to which it is added.
        node: The operator.
        values: Parameters, and earlier results, by name.
    """

    def given(value: Any) -> Value:
        """An argument: a result, a parameter, or a number."""
        return values[value.name] if isinstance(value, Node) else graph.floats([[float(value)]])

    kind, arguments = str(node.target).removeprefix("aten."), list(node.args)
    if kind == "linear.default":
        return graph.op("Gemm", *(given(v) for v in arguments), transB=1)
    if kind == "cat.default":
        return graph.concat(*(given(v) for v in arguments[0]), axis=1)  # type: ignore[union-attr]
    if kind not in _ATEN or node.kwargs:
        raise ModelError(
            f"the module's operator aten.{kind} is none that a force law may have: linear layers, "
            f"torch.cat along dimension 1, {', '.join(sorted(_ATEN.values()))}."
        )
    return graph.op(_ATEN[kind], *(given(v) for v in arguments))


def law_function(content: bytes) -> ca.Function:
    """CasADi function from `INPUTS` to six accelerations, columns, of an ONNX file.

    Raises:
        ModelError: The content is no ONNX file, or has other operators or shapes.
    """
    try:
        model = onnx.load_from_string(content)
        onnx.checker.check_model(model, full_check=True)
    except Exception as error:  # any error of protobuf or the checker
        raise ModelError(f"force law: the file is no ONNX model ({error}).") from None
    x = ca.SX.sym("x", len(INPUTS))
    constants = {c.name: c for c in model.graph.initializer}
    # Below version 4 of the format, constants are inputs too.
    inputs = [i.name for i in model.graph.input if i.name not in constants]
    outputs = [o.name for o in model.graph.output]
    if len(inputs) != 1 or len(outputs) != 1:
        raise ModelError(
            f"force law: the ONNX model has inputs {inputs} and outputs {outputs}, not one of each."
        )
    try:
        arrays = {n: numpy_helper.to_array(c).astype(float) for n, c in constants.items()}
        values = {inputs[0]: x.T, **{n: ca.SX(np.atleast_2d(a)) for n, a in arrays.items()}}
        for node in model.graph.node:
            # An empty name is an optional argument that is left out.
            arguments = [values[name] for name in node.input if name]
            values[node.output[0]] = _expression(node, arguments)
    except RuntimeError as error:
        raise ModelError(
            f"force law: the ONNX model cannot be evaluated on a row of {len(INPUTS)} ({error})."
        ) from error
    result = values[outputs[0]]
    if result.shape != (1, len(OUTPUTS)):
        raise ModelError(
            f"force law: the ONNX model gives {result.shape}, not a row of {len(OUTPUTS)}."
        )
    return ca.Function("module", [x], [ca.densify(result.T)])


def _expression(node: onnx.NodeProto, arguments: list[ca.SX]) -> ca.SX:
    """CasADi expression of an ONNX node."""
    if node.op_type == "Identity":
        return arguments[0]
    about = {a.name: helper.get_attribute_value(a) for a in node.attribute}
    if node.op_type == "Concat" and about["axis"] not in (1, -1):
        raise ModelError(
            f"force law: ONNX operator Concat joins rows (axis {about['axis']}). Join what belongs "
            f"to one row, axis 1."
        )
    if node.op_type == "Gemm":
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
