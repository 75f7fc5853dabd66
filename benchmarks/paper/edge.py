"""The paper's Table IV: what each system costs in onnxruntime, one thread of one core.

Each system, of the paper's size and with weights as they begin, since what they are costs nothing,
is written as ONNX and run in a process of its own: a system of the comparison over windows of the
training's length, the compensator sample by sample.
"""

import subprocess
import sys
import time
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import onnx
import plotly.graph_objects as go
import psutil
import torch
from plotly.subplots import make_subplots
from torch import Tensor, nn

from benchmarks.speed.compensator import CLUSTERS, onnxruntime_cost
from learning.data.channels import CHANNELS, GROUPS, N_PHASES
from learning.export.streaming import streaming_model
from learning.model.compensator import Compensator, untrained_compensator
from learning.model.family import ModelInfo
from learning.preset import BEST, PAPER

from .figures import COLOURS, styled, thin
from .system import System, SystemPreset, begun
from .trainings import SYSTEMS

OURS = (
    (PAPER, CLUSTERS),
    (BEST, tuple(tuple(range(len(CHANNELS))[columns]) for columns in GROUPS.values())),
)
CALLS = 200
RATE_HZ = 100.0


@dataclass(frozen=True, slots=True)
class Cost:
    """Of one system.

    Attributes:
        name: As printed.
        samples: Of a call.
        numbers: That are trained.
        file_mb: Size of the ONNX file.
        ms: Of a sample, median.
        memory_mb: Of the process; None where not told.
    """

    name: str
    samples: int
    numbers: int
    file_mb: float
    ms: float
    memory_mb: float | None

    def scores(self) -> dict[str, float | None]:
        """Of a row of Table IV."""
        return {
            "samples": self.samples,
            "weights": self.numbers,
            "file_mb": round(self.file_mb, 1),
            "ms": round(self.ms, 4),
            "memory_mb": self.memory_mb and round(self.memory_mb),
        }


def costs(folder: Path) -> Iterator[Cost]:
    """Of every system of the comparison, and of the compensator.

    Args:
        folder: For the ONNX files; made if it does not exist.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name in SYSTEMS:
        system = untrained_system(name)
        file = export_system(system, folder / f"{name}.onnx")
        yield measured(name, system, system.preset.window, file)
    for name, (model, file) in exported_ours(folder).items():
        yield measured(f"{name}, ours", model, 1, file)


def exported_ours(folder: Path) -> dict[str, tuple[Compensator, Path]]:
    """Our networks with weights as they begin, by preset, and where each is written as ONNX.

    Args:
        folder: For the files; made if it does not exist.
    """
    folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for preset, clusters in OURS:
        model = untrained_compensator(ModelInfo(preset, "reconstruct", 0, RATE_HZ, 0, clusters))
        file = folder / f"{preset.name}.onnx"
        onnx.save(streaming_model(model), file)
        found[preset.name] = model, file
    return found


def measured(name: str, network: Any, samples: int, file: Path) -> Cost:
    """Of a network as its ONNX file.

    Args:
        name: As printed.
        network: A torch module.
        samples: Of a call.
        file: What was written of it.
    """
    ms, _, memory_mb = onnxruntime_cost(file, CALLS)
    numbers = sum(p.numel() for p in network.parameters())
    return Cost(name, samples, numbers, file.stat().st_size / 1e6, ms / samples, memory_mb)


# ----------------------------------------------------------------------------------------
# The paper's figure 13: processor and memory over a run, from the start of the process.

SECONDS, RATE_HZ, EVERY_S = 12.0, 100.0, 0.2
CLAIMED_MB = 2741
"""Of the proposed model on the paper's edge device."""
MB = 2**20
_RUN = """
import sys, time
import numpy as np, onnxruntime
path, seconds, rate = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
options = onnxruntime.SessionOptions()
options.intra_op_num_threads = 1
session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
rng = np.random.default_rng(0)
fed = {i.name: rng.random((1, *i.shape[1:])).astype(np.float32) for i in session.get_inputs()}
begin = time.perf_counter()
for k in range(int(seconds * rate)):
    fed["state"] = session.run(None, fed)[-1]
    time.sleep(max(0.0, begin + (k + 1) / rate - time.perf_counter()))
"""


@dataclass(frozen=True, slots=True)
class Usage:
    """Of a process.

    Attributes:
        t_s: Since its start, s.
        processor: Share of one core since the instant before, percent.
        memory_mb: Resident, MB of 2^20 bytes.
    """

    t_s: tuple[float, ...]
    processor: tuple[float, ...]
    memory_mb: tuple[float, ...]


def usage(file: Path, seconds: float = SECONDS) -> Usage:
    """Of a process that runs a streaming model in onnxruntime, one thread, 100 samples a second.

    Args:
        file: ONNX whose last output is its next `state`.
        seconds: Of samples; loading comes before.

    Raises:
        subprocess.CalledProcessError: The file does not run.
    """
    command = [sys.executable, "-c", _RUN, str(file), str(seconds), str(RATE_HZ)]
    found: list[tuple[float, float, float]] = []
    began, before, spent = time.perf_counter(), 0.0, 0.0
    with subprocess.Popen(command) as process:
        watched = psutil.Process(process.pid)
        while process.poll() is None:
            time.sleep(EVERY_S)
            try:
                times, memory = watched.cpu_times(), watched.memory_info().rss
            except psutil.NoSuchProcess:
                break
            now, used = time.perf_counter() - began, times.user + times.system
            if memory:  # a process that has ended, but was not waited for, holds none
                found.append((now, 100 * (used - spent) / (now - before), memory / MB))
            before, spent = now, used
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return Usage(*zip(*found, strict=True))


def usage_figure(by_system: Mapping[str, Usage]) -> go.Figure:
    """Figure 13: processor above, memory below, a line per system."""
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    for k, (name, used) in enumerate(by_system.items()):
        for row, values in enumerate((used.processor, used.memory_mb), start=1):
            figure.add_scatter(
                x=thin(used.t_s),
                y=thin(values),
                name=name,
                legendgroup=name,
                showlegend=row == 1,
                line={"color": COLOURS[k], "width": 1.5},
                row=row,
                col=1,
            )
    figure.add_hline(
        y=CLAIMED_MB, line_dash="dot", annotation_text="the paper's edge device", row=2, col=1
    )
    figure.update_yaxes(title_text="of one core, %", row=1, col=1)
    figure.update_yaxes(title_text="memory, MB", type="log", row=2, col=1)
    figure.update_xaxes(title_text="since the process was started, s", row=2, col=1)
    return styled(figure, 480)


# ----------------------------------------------------------------------------------------
# A system of the paper's comparison as ONNX: windows in, residuals out, for measuring its cost.

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


def untrained_system(name: str) -> System:
    """A system with weights as they begin, of the size that a trained one has."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return begun(SYSTEMS[name], SystemPreset(name), "reconstruct", 0).eval()


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
