"""The paper's Table IV: what each system costs in onnxruntime, one thread of one core.

    python -m benchmarks.compensator.edge --out OUT

writes OUT/edge.md.
Each system, of the paper's size and with weights as they begin, since what they are costs nothing,
is written as ONNX and run in a process of its own: a system of the comparison over windows of the
training's length, the compensator sample by sample. Time is that of the fastest of some calls;
memory what the process holds at most beyond onnxruntime itself.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx

from learning.data.channels import CHANNELS, GROUPS
from learning.export.step import streaming_model
from learning.export.system import export_system, untrained_system
from learning.model.compensator import untrained_compensator
from learning.model.info import ModelInfo
from learning.model.registry import FAMILIES
from learning.preset import BEST, PAPER, Preset

CLAIMED_MS, CLAIMED_MB = 165, 2741
"""Of the proposed model on the paper's edge device."""
WARM_S, CALLS = 0.5, 5
RATE_HZ = 100.0


@dataclass(frozen=True, slots=True)
class Cost:
    """Of one system.

    Attributes:
        name: As printed.
        samples: Of a call.
        numbers: That are trained.
        file_mb: Size of the ONNX file.
        ms: Of a sample.
        memory_mb: Beyond onnxruntime.
    """

    name: str
    samples: int
    numbers: int
    file_mb: float
    ms: float
    memory_mb: float

    def row(self) -> str:
        """Of the table."""
        cells = (self.name, self.samples, self.numbers, f"{self.file_mb:.1f}", f"{self.ms:.4f}")
        return f"| {' | '.join(map(str, cells))} | {self.memory_mb:.0f} |"


def costs(folder: Path) -> Iterator[Cost]:
    """Of every system of the comparison, and of the compensator.

    Args:
        folder: For the ONNX files; made if it does not exist.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for row in FAMILIES:
        if row.member.startswith("systems."):
            system = untrained_system(row)
            file = export_system(system, folder / f"{row.name}.onnx")
            yield measured(row.name, system, system.preset.window, file)
    for preset in (PAPER, BEST):
        model = untrained_compensator(
            ModelInfo(preset, "reconstruct", 0, RATE_HZ, 0, _clusters(preset))
        )
        file = folder / f"{preset.name}.onnx"
        onnx.save(streaming_model(model), file)
        yield measured(f"{preset.name}, ours", model, 1, file)


def _clusters(preset: Preset) -> tuple[tuple[int, ...], ...]:
    """As many as the preset has: sensors, or parts of equal size."""
    every = np.arange(len(CHANNELS))
    parts = [every[columns] for columns in GROUPS.values()]
    if preset.clustering == "kmeans":
        parts = np.array_split(every, preset.n_clusters or len(CHANNELS))
    return tuple(tuple(int(c) for c in part) for part in parts)


def measured(name: str, network: Any, samples: int, file: Path) -> Cost:
    """Of a file, by a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", __spec__.name if __spec__ else __name__, "--one", str(file)],
        check=True,
        capture_output=True,
        text=True,
    )
    said = json.loads(done.stdout)
    numbers = sum(p.numel() for p in network.parameters())
    megabytes = file.stat().st_size / 1e6
    return Cost(name, samples, numbers, megabytes, said["ms"] / samples, said["memory_mb"])


def _one(file: Path) -> dict[str, float]:
    """Time of a call and memory of a file, in this process."""
    import onnxruntime

    before = _kilobytes("VmRSS")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    rng = np.random.default_rng(0)
    given = {
        i.name: 0.1 * rng.normal(size=i.shape).astype(np.float32) for i in session.get_inputs()
    }
    given["phase"] = np.zeros_like(given["phase"])
    spent, began, fastest = 0.0, time.perf_counter(), np.inf
    count = 0
    while spent < WARM_S or count < CALLS:
        start = time.perf_counter()
        session.run(None, given)
        fastest = min(fastest, time.perf_counter() - start)
        spent, count = time.perf_counter() - began, count + 1
    return {"ms": 1e3 * fastest, "memory_mb": (_kilobytes("VmHWM") - before) / 1024}


def _kilobytes(name: str) -> int:
    """Of this process's memory, as Linux tells it."""
    lines = Path("/proc/self/status").read_text("ascii").splitlines()
    said = dict(line.split(":", 1) for line in lines)
    return int(said[name].split()[0])


def table(found: list[Cost]) -> str:
    """Markdown."""
    head = "| system | samples a call | numbers | file, MB | ms a sample | memory, MB |"
    claim = f"| paper's claim, its edge device | | | | {CLAIMED_MS} | {CLAIMED_MB} |"
    return "\n".join([head, "|---|" + "---|" * 5, claim, *(c.row() for c in found), ""])


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, help="folder of the ONNX files and of edge.md")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.one:
        print(json.dumps(_one(given.one)))
        return 0
    if given.out is None:
        parser.error("--out is missing")
    found = []
    for cost in costs(given.out / "onnx"):
        found.append(cost)
        print(cost.row(), file=sys.stderr, flush=True)
    (given.out / "edge.md").write_text(table(found), "utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
