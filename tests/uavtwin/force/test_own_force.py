"""Modules of one's own as force laws: torch, ONNX and the equations say the same; the page runs."""

import re
from typing import Any

import numpy as np
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper
from places import ROOT
from torch import nn

from learning.force.module import law_function, module_onnx
from twin.errors import ModelError
from twin.physics.residual_force import INPUTS, OUTPUTS
from uavtwin.force.train import force_claim

PAGE = ROOT / "docs" / "guide" / "own_force.md"


class Mixed(nn.Module):
    """Several operators, a buffer, a plain tensor and a number."""

    def __init__(self) -> None:
        super().__init__()
        self.one, self.two = nn.Linear(len(INPUTS), 5), nn.Linear(10, len(OUTPUTS), bias=False)
        self.register_buffer("gain", torch.linspace(0.5, 2.0, len(OUTPUTS)))
        self.spread = torch.full((len(INPUTS),), 2.0)

    def forward(self, x: torch.Tensor) -> Any:
        """Rows to rows."""
        x = x / self.spread
        hidden = torch.cat([torch.tanh(self.one(x)), torch.relu(self.one(x)) - 0.25], dim=1)
        return self.two(torch.sigmoid(hidden)) * self.gain / 2.0


@pytest.mark.slow
def test_the_equations_say_what_the_module_says() -> None:
    """To float32, in which the weights are."""
    torch.manual_seed(0)
    module, rows = Mixed(), np.random.default_rng(0).normal(size=(20, len(INPUTS)))
    function = law_function(module_onnx(module).SerializeToString())
    said = np.array([np.asarray(function(row)).ravel() for row in rows])
    with torch.no_grad():
        wanted = module(torch.tensor(rows, dtype=torch.float32)).numpy()
    np.testing.assert_allclose(said, wanted, atol=2e-6)


class Two(nn.Module):
    """Force and moment apart."""

    def forward(self, x: torch.Tensor) -> Any:
        """Rows to two results."""
        return x[:, :3], x[:, 3:6]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "message"),
    [
        (nn.Linear(len(INPUTS), 5), r"makes \(2, 5\)"),
        (nn.Sequential(nn.Linear(len(INPUTS), 6), nn.Softmax(dim=1)), "aten.softmax"),
        (nn.Linear(len(INPUTS), 6).double(), r"Linear: cannot be traced .*float\(\)"),
        (nn.Linear(len(INPUTS) + 1, 6), r"Linear: cannot be traced .*first layer is 12 wide"),
        (Two(), "Two: makes a tuple"),
    ],
)
def test_a_module_that_cannot_be_a_law_is_refused(module: nn.Module, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        module_onnx(module)


WEIGHTS = np.random.default_rng(1).normal(size=(6, 12)).astype(np.float32)


def _file(
    kind: str,
    *given: str,
    inputs: tuple[str, ...] = ("x",),
    width: int = 12,
    version: int = 8,
    axis: int = 1,
) -> bytes:
    """Of one operator; x is (n, width), y (n, 6), the constants w (6, 12) and v (6, 13)."""
    constants = {"w": WEIGHTS, "v": np.ones((6, 13), dtype=np.float32)}
    shapes: dict[str, Any] = {"x": ["n", width], "w": [6, 12], "b": [1, 6], "y": ["n", 6]}
    rows = {n: helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in shapes.items()}
    known: dict[str, dict[str, Any]] = {"Gemm": {"transB": 1}, "Concat": {"axis": axis}}
    node = helper.make_node(kind, given, ["y"], **known.get(kind, {}))
    used = [numpy_helper.from_array(v, n) for n, v in constants.items() if n in given]
    graph = helper.make_graph([node], "g", [rows[n] for n in inputs], [rows["y"]], used)
    opset = [helper.make_opsetid("", 17)]
    model = helper.make_model(graph, opset_imports=opset, ir_version=version)
    return bytes(model.SerializeToString())


@pytest.mark.parametrize(
    "content",
    [
        _file("Gemm", "x", "w"),
        _file("Gemm", "x", "w", ""),
        _file("Gemm", "x", "w", inputs=("x", "w"), version=3),
    ],
    ids=["gemm", "without bias", "constants are inputs"],
)
def test_a_file_from_elsewhere_may_be_a_law(content: bytes) -> None:
    x = np.arange(12.0)
    said = np.asarray(law_function(content)(x)).ravel()
    np.testing.assert_allclose(said, WEIGHTS.astype(float) @ x)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"nonsense", "no ONNX model"),
        (_file("LeakyRelu", "x", width=6), "operator LeakyRelu"),
        (_file("Tanh", "x", width=6), r"gives \(1, 12\)"),
        (_file("Concat", "x", "x", width=6, axis=0), r"Concat joins rows \(axis 0\)"),
        (_file("Gemm", "x", "v", width=13), "cannot be evaluated on a row of 12"),
        (_file("Gemm", "x", "w", "b", inputs=("x", "b")), r"inputs \['x', 'b'\] .*not one of each"),
    ],
)
def test_a_file_that_cannot_be_a_law_is_refused(content: bytes, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        law_function(content)


@pytest.mark.slow
def test_the_page_works() -> None:
    """And its law is not said to be none, or one of a ridge."""
    (block,) = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    page: dict[str, Any] = {"__name__": "own_force"}
    exec(compile(block, str(PAGE), "exec"), page)
    assert "a module of one's own" in force_claim(page["folder"])
