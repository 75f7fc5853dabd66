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

PAGE = ROOT / "docs" / "guide" / "own_force.md"


class Mixed(nn.Module):
    """Several operators, a buffer and a number."""

    def __init__(self) -> None:
        super().__init__()
        self.one, self.two = nn.Linear(len(INPUTS), 5), nn.Linear(10, len(OUTPUTS), bias=False)
        self.register_buffer("gain", torch.linspace(0.5, 2.0, len(OUTPUTS)))

    def forward(self, x: torch.Tensor) -> Any:
        """Rows to rows."""
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "message"),
    [
        (nn.Linear(len(INPUTS), 5), r"makes \(2, 5\)"),
        (nn.Sequential(nn.Linear(len(INPUTS), 6), nn.Softmax(dim=1)), "aten.softmax"),
    ],
)
def test_a_module_that_cannot_be_a_law_is_refused(module: nn.Module, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        module_onnx(module)


def test_a_file_from_elsewhere_may_have_a_gemm_and_no_other_operators() -> None:
    weights = np.random.default_rng(1).normal(size=(6, 12)).astype(np.float32)

    def made(kind: str, **attributes: Any) -> bytes:
        rows = (("x", 12), ("y", 6))
        given, wanted = (
            helper.make_tensor_value_info(n, TensorProto.FLOAT, ["n", k]) for n, k in rows
        )
        inputs = ["x", "w"] if kind == "Gemm" else ["x"]
        node = helper.make_node(kind, inputs, ["y"], **attributes)
        graph = helper.make_graph(
            [node], "g", [given], [wanted], [numpy_helper.from_array(weights, "w")]
        )
        opset = [helper.make_opsetid("", 17)]
        model = helper.make_model(graph, opset_imports=opset, ir_version=8)
        return bytes(model.SerializeToString())

    x = np.arange(12.0)
    said = np.asarray(law_function(made("Gemm", transB=1))(x)).ravel()
    np.testing.assert_allclose(said, weights.astype(float) @ x)
    with pytest.raises(ModelError, match="no ONNX model"):
        law_function(b"nonsense")
    with pytest.raises(ModelError, match=r"operator LeakyRelu|gives \(1, 12\)|no ONNX model"):
        law_function(made("LeakyRelu"))


@pytest.mark.slow
def test_the_page_works() -> None:
    (block,) = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    exec(compile(block, str(PAGE), "exec"), {"__name__": "own_force"})
