"""The paper's figure 13: processor and memory over a run, from the start of the process."""

import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import plotly.graph_objects as go
import psutil
from plotly.subplots import make_subplots

from .palette import COLOURS
from .style import styled, thin

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
