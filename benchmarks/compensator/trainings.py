"""Trainings on the paper's tables, each kept as JSON: a run that was cut short goes on.

    OUT/runs/KEY.json  scores of one training    OUT/models/KEY/  a training under way

A run counts as long as preset, seed, flights, share of the data and the sources of `learning` are
the same.
"""

import hashlib
import json
import shutil
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import learning
from learning.data.channels import GROUPS, PHASE_CODES
from learning.data.flights import ResidualFlight
from learning.data.paper_tables import GAUSS_T, paper_flights
from learning.evaluation import metrics
from learning.model.folder import write_json
from learning.preset import Preset, preset_json
from learning.training.train import train

Array = NDArray[np.float64]
MODALITIES = ("takeoff", "hover")
SYSTEMS = ("standardised", "physical", "range")
"""Units: spread of the training residual = 1; SI but gauss, as published; each phase's range over
all three flights = -1..1, as in the published code."""
METRICS = ("mse", "mae", "wasserstein")
ALL = (1, 2, 3)


@dataclass(frozen=True, slots=True)
class Run:
    """One training and what it is scored on.

    Attributes:
        name: Of the variant, as printed.
        preset: Hyper-parameters.
        seed: Of everything that is drawn.
        train: Numbers of the flights.
        test: Number of the flight scored; 0: the training flights themselves, as published.
        share: Of each phase of each training flight, from its start.
    """

    name: str
    preset: Preset
    seed: int = 0
    train: tuple[int, ...] = (1, 2)
    test: int = 3
    share: float = 1.0

    def key(self) -> str:
        """Name of its files: hash of all that decides the scores, sources included."""
        content = {**asdict(self), "preset": preset_json(self.preset), "name": ""}
        digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode())
        root = Path(str(learning.__file__)).parent
        for path in sorted(root.rglob("*.py")):
            if "export" not in path.relative_to(root).parts:
                digest.update(path.read_bytes())
        return f"{self.preset.name}_{self.seed}_{digest.hexdigest()[:12]}"


def run_all(data: Path, out: Path, runs: Sequence[Run], jobs: int = 1) -> list[dict[str, Any]]:
    """Scores of every run, in order; those that are there already are not run again."""
    distinct = list({r.key(): r for r in runs}.values())
    missing = [r for r in distinct if not _file(out, r).is_file()]
    print(f"{len(distinct)} trainings, {len(missing)} to be done", file=sys.stderr)
    began = time.perf_counter()
    if jobs == 1:
        each = map(_score, missing, repeat(data), repeat(out))
        _follow(each, len(missing), began)
    elif missing:
        with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
            _follow(pool.map(_score, missing, repeat(data), repeat(out)), len(missing), began)
    found = [json.loads(_file(out, r).read_text("utf-8")) for r in runs]
    return [{**f, "run": asdict(r)} for f, r in zip(found, runs, strict=True)]


def _follow(each: Any, count: int, began: float) -> None:
    for done, line in enumerate(each, start=1):
        left = (time.perf_counter() - began) / done * (count - done)
        print(f"{done}/{count} {line}; {left:.0f} s left", file=sys.stderr, flush=True)


def shortened(flight: ResidualFlight, share: float) -> ResidualFlight:
    """The first part of each span only."""
    spans = tuple((a, a + round(share * (b - a))) for a, b in flight.spans)
    fresh = np.zeros_like(flight.fresh)
    for a, b in spans:
        fresh[a:b] = flight.fresh[a:b]
    return replace(flight, spans=spans, fresh=fresh)


def scores(
    corrections: Sequence[Array],
    tests: Sequence[ResidualFlight],
    trained: Sequence[ResidualFlight],
    everything: Sequence[ResidualFlight],
) -> dict[str, dict[str, dict[str, float]]]:
    """Modality -> units -> metric, each the mean over the 15 channels.

    Args:
        corrections: One per test flight, shape (n, 15).
        tests: Flights scored.
        trained: They give the standardised unit.
        everything: All flights: they give the range.
    """
    spread = np.concatenate([f.residual[f.fresh.all(1)] for f in trained]).std(axis=0)
    gauss = np.ones_like(spread)
    gauss[GROUPS["mag"]] = GAUSS_T
    found: dict[str, dict[str, dict[str, float]]] = {}
    for name in MODALITIES:
        code = PHASE_CODES[name]
        pooled = np.concatenate([f.residual[f.phase == code] for f in everything])
        units = dict(zip(SYSTEMS, (spread, gauss, np.ptp(pooled, axis=0) / 2), strict=True))
        residual = np.concatenate([f.residual[f.phase == code] for f in tests])
        said = np.concatenate([c[f.phase == code] for c, f in zip(corrections, tests, strict=True)])
        found[name] = {system: _means(residual / u, said / u) for system, u in units.items()}
    return found


def _means(residual: Array, said: Array) -> dict[str, float]:
    columns = list(zip(residual.T, said.T, strict=True))
    return {
        "mse": float(np.mean([metrics.mse(r - s) for r, s in columns])),
        "mae": float(np.mean([metrics.mae(r - s) for r, s in columns])),
        "wasserstein": float(np.mean([metrics.wasserstein(r, s) for r, s in columns])),
    }


def _score(run: Run, data: Path, out: Path) -> str:
    """Train, score, keep the scores; returns a line to print."""
    flights = dict(zip(ALL, paper_flights(data, ALL), strict=True))
    trained = [shortened(flights[k], run.share) for k in run.train]
    folder = out / "models" / run.key()
    began = time.process_time()
    model = train(trained, run.preset, "reconstruct", 0, run.seed, folder)
    seconds = time.process_time() - began  # one thread: its wall clock on a quiet machine
    tests = trained if run.test == 0 else [flights[run.test]]
    corrections = [model.run(f).correction for f in tests]
    found = scores(corrections, tests, trained, list(flights.values()))
    epochs = model.info.metrics["epochs"]
    clusters = [list(c) for c in model.info.clusters]
    write_json(
        _file(out, run),
        {
            "run": asdict(run),
            "seconds": seconds,
            "epochs": epochs,
            "clusters": clusters,
            "weights": sum(p.numel() for p in model.parameters()),
            "scores": found,
        },
    )
    shutil.rmtree(folder)
    shown = " | ".join(
        f"{m} " + " ".join(f"{found[m]['standardised'][k]:.4f}" for k in METRICS)
        for m in MODALITIES
    )
    return f"{run.name}, seed {run.seed}: {seconds:.0f} s, {shown}"


def _file(out: Path, run: Run) -> Path:
    folder = out / "runs"
    folder.mkdir(parents=True, exist_ok=True)
    return folder / f"{run.key()}.json"
