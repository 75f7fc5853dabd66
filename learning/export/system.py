"""A system of the paper's comparison as ONNX: windows in, residuals out, for measuring its cost."""

import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from ..data.channels import CHANNELS, N_PHASES
from ..model.registry import FamilyRow
from ..systems.system import System

OPSET = 17
"""Operators as of ONNX 1.12, as of the compensator's graph."""


class _Reconstructs(nn.Module):
    """A system as what it says."""

    def __init__(self, system: System) -> None:
        super().__init__()
        self.system = system

    def forward(self, given: Tensor, phase: Tensor) -> Tensor:
        """As `System.reconstruct`."""
        return self.system.reconstruct(given, phase)


def untrained_system(row: FamilyRow) -> System:
    """A system with weights as they begin, of the size that a trained one has.

    Args:
        row: Of a system.
    """
    family: Any = row.load()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        system: System = family.system(family.presets()[row.name], len(CHANNELS), len(CHANNELS))
    return system.eval()


def export_system(system: System, file: Path) -> Path:
    """Write a system: `given` and `phase` of a window of its training's length to `residual`.

    Shapes (1, window, ...). What draws, draws at each call.
    """
    window = system.preset.window
    phase = torch.eye(N_PHASES)[torch.zeros(1, window, dtype=torch.long)]
    given = torch.zeros(1, window, system.n_given)
    with warnings.catch_warnings():  # of a tracer that is to be replaced, and of LSTM in batches
        warnings.simplefilter("ignore")
        torch.onnx.export(
            _Reconstructs(system),
            (given, phase),
            str(file),
            dynamo=False,
            opset_version=OPSET,
            input_names=["given", "phase"],
            output_names=["residual"],
        )
    return file
