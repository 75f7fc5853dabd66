"""The paper's Table IV: what each system costs in onnxruntime, one thread of one core.

    python -m benchmarks.compensator.edge --out OUT

writes OUT/edge.md. Each system, of the paper's size and with weights as they begin, since what they
are costs nothing, is written as ONNX and run in a process of its own: a system of the comparison
over windows of the training's length, the compensator sample by sample.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import onnx

from learning.data.channels import CHANNELS, GROUPS
from learning.export.step import streaming_model
from learning.export.system import export_system, untrained_system
from learning.model.compensator import untrained_compensator
from learning.model.info import ModelInfo
from learning.model.registry import FAMILIES
from learning.preset import BEST, PAPER
from uavtwin.bench.compensator import CLUSTERS, onnxruntime_cost

CLAIMED_MS, CLAIMED_MB = 165, 2741
"""Of the proposed model on the paper's edge device."""
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

    def row(self) -> str:
        """Of the table."""
        memory = "" if self.memory_mb is None else f"{self.memory_mb:.0f}"
        cells = (self.name, self.samples, self.numbers, f"{self.file_mb:.1f}", f"{self.ms:.4f}")
        return f"| {' | '.join(map(str, cells))} | {memory} |"


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
    for preset, clusters in OURS:
        model = untrained_compensator(ModelInfo(preset, "reconstruct", 0, RATE_HZ, 0, clusters))
        file = folder / f"{preset.name}.onnx"
        onnx.save(streaming_model(model), file)
        yield measured(f"{preset.name}, ours", model, 1, file)


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


def table(found: Sequence[Cost]) -> str:
    """Markdown."""
    head = "| system | samples a call | numbers | file, MB | ms a sample | memory, MB |"
    claim = f"| paper's claim, its edge device | | | | {CLAIMED_MS} | {CLAIMED_MB} |"
    return "\n".join([head, "|---|" + "---|" * 5, claim, *(c.row() for c in found), ""])


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of edge.md")
    given = parser.parse_args(arguments)
    found = []
    for cost in costs(given.out / "onnx"):
        found.append(cost)
        print(cost.row(), file=sys.stderr, flush=True)
    (given.out / "edge.md").write_text(table(found), "utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
