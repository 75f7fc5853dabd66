"""Figures of the compensator: time and memory of one sample.

The network has the paper's sizes (four clusters, D = 128, K = 512, 1.3 million weights in LSTM
cells) and random weights. Each figure comes from a process of its own that has loaded nothing else;
times are those of the best of ten runs.
"""

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import fmpy

from fmus import build
from fmus.compensator import FILE, INT8_FILE, native_model, read_network
from learning.export.write import export_onnx
from learning.model.compensator import ModelInfo, untrained_compensator
from learning.preset import PAPER
from twin.errors import FmuError

SAMPLES = 5000
"""Samples that the step time is measured over."""
RUNS = 10
"""Repetitions, of which the fastest counts."""
CLUSTERS = ((0, 1, 2, 3), (4, 5, 6, 7), (8, 9, 10, 11), (12, 13, 14))
"""Channels that share an encoder in the network that is measured."""
_HEAD = """
import json, sys, time
def resident():
    try:
        lines = open("/proc/self/status").read().splitlines()
    except OSError:
        return None
    return next(int(x.split()[1]) / 1024 for x in lines if x.startswith("VmRSS"))
path, samples = sys.argv[1], int(sys.argv[2])
"""
"""Beginning of every script that is timed in a process of its own."""
_TAIL = f"""
n = samples // {RUNS}
runs = [sorted(seconds[k : k + n]) for k in range(0, samples, n)]
print(json.dumps([*(1e3 * min(r[int(q * n)] for r in runs) for q in (0.5, 0.99)), used]))
"""
"""End of it: prints the percentiles and the memory."""
_ONNXRUNTIME = f"""{_HEAD}
import numpy as np, onnxruntime
options = onnxruntime.SessionOptions()
options.intra_op_num_threads = 1
session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
rng, seconds = np.random.default_rng(0), []
fed = {{i.name: rng.random((1, *i.shape[1:])).astype(np.float32) for i in session.get_inputs()}}
for _ in range(samples):
    begin = time.perf_counter()
    said = session.run(None, fed)
    seconds.append(time.perf_counter() - begin)
    if "state" in fed:
        fed["state"] = said[-1]
used = resident()
{_TAIL}"""
"""Script that steps the network by onnxruntime."""
_FMU = f"""{_HEAD}
import fmpy
from fmpy.fmi2 import FMU2Slave
description, seconds = fmpy.read_model_description(path), []
before = resident()
fmu = FMU2Slave(guid=description.guid, unzipDirectory=path, instanceName="one",
                modelIdentifier=description.coSimulation.modelIdentifier)
fmu.instantiate()
fmu.setupExperiment()
fmu.enterInitializationMode()
inputs = [v for v in description.modelVariables if v.causality == "input" and v.type == "Real"]
fmu.setReal([v.valueReference for v in inputs], [0.1 * (i % 9) for i in range(len(inputs))])
fmu.exitInitializationMode()
for k in range(samples):
    begin = time.perf_counter()
    fmu.doStep(k * 0.01, 0.01)
    seconds.append(time.perf_counter() - begin)
used = None if before is None else resident() - before
{_TAIL}"""
"""Script that steps the FMU of the network."""


@dataclass(frozen=True, slots=True)
class Row:
    """One measured figure.

    Attributes:
        what: Was measured.
        value: In its unit.
        unit: Of it.
        goal: That it is held against.
    """

    what: str
    value: float
    unit: str
    goal: str


def compensator_rows(folder: Path) -> list[Row]:
    """One sample in onnxruntime and in the native FMU, one thread.

    Args:
        folder: For the files.
    """
    model = untrained_compensator(ModelInfo(PAPER, "reconstruct", 0, 100.0, 4, CLUSTERS))
    export_onnx(model, folder)
    rows = []
    for file, what, goals in (
        (FILE, "", (("<= 0.3", "<= 1"), "<= 80", ("<= 0.2", ""), "<= 20")),
        (INT8_FILE, ", int8", (("", ""), "", ("<= 0.1", ""), "")),
    ):
        fmu = build(native_model(read_network(folder, file)), folder / "compensator.fmu")
        unpacked = fmpy.extract(str(fmu), str(folder / file.replace(".", "_")))
        runtime, native = onnxruntime_cost(folder / file), _measured(_FMU, unpacked, SAMPLES)
        rows += _rows(f"one sample in onnxruntime{what}", runtime, *goals[:2])
        rows += _rows(f"one sample in the native FMU{what}", native, *goals[2:])
    return rows


def _rows(
    what: str, found: tuple[float, float, float | None], goals: tuple[str, str], memory: str
) -> list[Row]:
    median_ms, late_ms, mb = found
    name = f"compensator of the paper's size, {what}"
    whole = "memory beyond the host's" if "FMU" in what else "memory of the process"
    rows = [
        Row(f"{name}, median", median_ms, "ms", goals[0]),
        Row(f"{name}, 99 %", late_ms, "ms", goals[1]),
    ]
    return rows if mb is None else [*rows, Row(f"{name}, {whole}", mb, "MB", memory)]


def onnxruntime_cost(file: Path, calls: int = SAMPLES) -> tuple[float, float, float | None]:
    """Of a call of an ONNX file, one thread of a process that has loaded nothing else: median and
    99th percentile, ms; memory of the process, MB, None where not known.

    Args:
        file: Its inputs are fed with random numbers; what it says last is its next `state`.
        calls: A multiple of `RUNS`.

    Raises:
        FmuError: The file does not run.
    """
    return _measured(_ONNXRUNTIME, file, calls)


def _measured(program: str, path: Path | str, calls: int) -> tuple[float, float, float | None]:
    """Median and 99th percentile, ms, and resident memory, MB (None where not known)."""
    command = [sys.executable, "-c", program, str(path), str(calls)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        raise FmuError(f"{Path(path).name}: the measurement failed:\n{result.stderr}")
    median, late, memory = json.loads(result.stdout)
    return median, late, memory
