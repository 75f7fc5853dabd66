"""What a compensator removes on other flights: `python -m benchmarks.compensator.prediction`.

    python -m benchmarks.compensator.prediction --data D --out OUT [--simulated DIR] [--epochs N]

D holds rflysimdt/real_1.ulg ... Parts:

| part | trained on | tested on |
|---|---|---|
| real | two real flights | the third, each in turn |
| explained | real_1, real_2, with the vehicle file that `explain` writes from them | real_3 |
| simulated, paper's split | hover and takeoff of an aircraft with hidden effects | tour, forward |
| simulated, same missions | one flight of every mission | other flights of tour and forward |
| alarm | two real flights | the third, with a fault planted in the middle |

A training that is done, or was cut short, is gone on from. The page is printed and written to
OUT/prediction.md.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from learning.data.channels import CHANNELS, GROUPS
from learning.data.flights import (
    DEFAULT_RATE_HZ,
    ResidualFlight,
    residual_flight,
    restart_before_s,
)
from learning.data.scaling import in_spans
from learning.evaluation import WHOLE, evaluate, pooled
from learning.export.write import export_onnx
from learning.model.compensator import LINEAR_PART, Compensator
from learning.model.family import Model, TrainingTask
from learning.model.registry import family_named
from learning.preset import BEST, Preset
from learning.training.train import fit_model
from twin.explain.explanation import explain
from twin.logs import Flight, read_flight
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.compensators.running import CompiledCompensator, compiled_compensator

from .residuals import residuals
from .simulated import individuals, produce

VEHICLE = "feisi_x150"
FREE = TrainingTask("free")
TASKS = (*(TrainingTask("track", h) for h in (1, 10, 50, 100)), FREE)
SIMULATED_TASKS = (TrainingTask("track", 1), TrainingTask("track", 10), FREE)
FAULT = "gyro_x"
FAULT_RAD_S = 0.5
MODEL = "compensator"


@dataclass(frozen=True, slots=True)
class Split:
    """Flights to train on and to test on."""

    name: str
    train: Sequence[ResidualFlight]
    test: Sequence[ResidualFlight]


def before_s(task: TrainingTask) -> float:
    """How long before a reading the twin of a task was at the measured state, s."""
    return restart_before_s(task.protocol, task.horizon, DEFAULT_RATE_HZ)


def residuals_of(
    logs: Sequence[Flight], vehicle: Vehicle, task: TrainingTask
) -> list[ResidualFlight]:
    """What a task is about of each flight."""
    return [residual_flight(log, vehicle, restart_s=before_s(task)) for log in logs]


def real_splits(logs: Sequence[Flight], vehicle: str, task: TrainingTask) -> list[Split]:
    """Each flight held out in turn."""
    flights = residuals_of(logs, load_vehicle(vehicle), task)
    return [
        Split(f"without {held.name}", [f for f in flights if f is not held], [held])
        for held in flights
    ]


def simulated_splits(
    folder: Path, seeds: int, jobs: int, task: TrainingTask
) -> dict[str, list[Split]]:
    """Aircraft with hidden effects, the paper's split and the same missions in both."""
    wanted = individuals(seeds=seeds)
    produce(folder, wanted)
    hover = residuals(folder, wanted, "train", jobs, restart_s=before_s(task))
    motion = residuals(folder, wanted, "test", jobs, restart_s=before_s(task))
    paper, same = [], []
    for name, test in motion.items():
        paper.append(Split(name, hover[name], test))
        again = [f for f in test if f.name.endswith("_2")]
        other = [f for f in (*hover[name], *test) if f.name.endswith("_1")]
        same.append(Split(name, other, again))
    return {"paper's split": paper, "same missions": same}


@contextmanager
def shipped(
    split: Split, task: TrainingTask, preset: Preset, seed: int, out: Path
) -> Iterator[tuple[Compensator, CompiledCompensator]]:
    """The compensator of a split and its FMU; one that is trained already is taken."""
    folder = out / f"{split.name.replace(' ', '_')}-{task.protocol}{task.horizon}-{seed}"
    wanted = replace(task, seed=seed)
    trained = fit_model(split.train, family_named("svq"), preset, wanted, folder)
    assert isinstance(trained, Compensator)
    export_onnx(trained, folder)
    with compiled_compensator(folder) as compiled:
        yield trained, compiled


def score(
    splits: Mapping[TrainingTask, Sequence[Split]],
    preset: Preset,
    seeds: int,
    out: Path,
    jobs: int = 1,
) -> pd.DataFrame:
    """Rows of `protocols.evaluate`, with the split and the seed."""
    began = time.perf_counter()
    wanted = [
        (s, t, preset, k, out) for t, some in splits.items() for s in some for k in range(seeds)
    ]
    tables: list[pd.DataFrame] = []
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        for table in pool.map(_score, *zip(*wanted, strict=True)):
            tables.append(table)
            left = (time.perf_counter() - began) / len(tables) * (len(wanted) - len(tables))
            text = f"{out.name}: {len(tables)}/{len(wanted)}, {left:.0f} s left"
            print(text, file=sys.stderr, flush=True)
    return pd.concat(tables, ignore_index=True)


def _score(split: Split, task: TrainingTask, preset: Preset, seed: int, out: Path) -> pd.DataFrame:
    with shipped(split, task, preset, seed, out) as (trained, fmu):
        models: dict[str, Model] = {MODEL: fmu}
        if (alone := trained.without_network()) is not None:
            models[LINEAR_PART] = alone
        table = evaluate(models, split.train, split.test, task)
    return table[table["phase"] == WHOLE].assign(split=split.name, seed=seed)


def table_text(rows: pd.DataFrame) -> str:
    """Per task and model: share of the rms beyond a constant that is gone, by sensor.

    A cell: mean over the splits, smallest and largest over splits and seeds of the compensator.
    """
    lines = [
        f"| task | model | {' | '.join(GROUPS)} |",
        "|---|---|" + "---|" * len(GROUPS),
    ]
    per = pooled(rows, ("protocol", "horizon", "model", "split", "seed", "group"))
    for (protocol, horizon), part in per.groupby(["protocol", "horizon"], sort=False):
        name = protocol if not horizon else f"{protocol} {horizon}"
        for model, own in part.groupby("model", sort=False):
            cells = [_cell(own[own["group"] == g], str(model)) for g in GROUPS]
            lines.append(f"| {name} | {model} | {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def _cell(own: pd.DataFrame, model: str) -> str:
    """Mean share in percent, and its range over splits and seeds."""
    share = 100 * own["removed_beyond_constant"].dropna()
    if share.empty:
        return "-"
    text = f"{share.mean():.1f}"
    return f"**{text}** ({share.min():.1f} to {share.max():.1f})" if model == MODEL else text


def verdicts(rows: pd.DataFrame) -> str:
    """Per task and sensor: rms of the compensator over that of the best trivial baseline."""
    per = pooled(rows, ("protocol", "horizon", "model", "group"))
    lines = [f"| task | {' | '.join(GROUPS)} |", "|---|" + "---|" * len(GROUPS)]
    for (protocol, horizon), part in per.groupby(["protocol", "horizon"], sort=False):
        cells = []
        for group in GROUPS:
            here = part[part["group"] == group].set_index("model")["rmse"]
            best = here.drop([MODEL, LINEAR_PART]).idxmin() if len(here) else ""
            cells.append(f"{here[MODEL] / here[best]:.2f} of {best}" if best else "-")
        name = protocol if not horizon else f"{protocol} {horizon}"
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def coverage(rows: pd.DataFrame) -> str:
    """Per task and sensor: share of samples within one and two predicted spreads."""
    per = pooled(rows[rows["model"] == MODEL], ("protocol", "horizon", "group"))
    lines = [f"| task | {' | '.join(GROUPS)} | inside |", "|---|" + "---|" * (len(GROUPS) + 1)]
    for (protocol, horizon), part in per.groupby(["protocol", "horizon"], sort=False):
        here = part.set_index("group")
        cells = [
            f"{here['within_1'][g]:.0%}, {here['within_2'][g]:.0%}" if g in here.index else "-"
            for g in GROUPS
        ]
        name = protocol if not horizon else f"{protocol} {horizon}"
        lines.append(f"| {name} | {' | '.join(cells)} | {here['inside'].min():.0%} |")
    return "\n".join([*lines, ""])


def explained_text(logs: Sequence[Flight], preset: Preset, seeds: int, out: Path, jobs: int) -> str:
    """The rms left on real_3 by the twin, the explained twin, and each with a compensator."""
    fit, held = logs[:2], logs[2:]
    vehicle = load_vehicle(VEHICLE)
    found = explain(fit, held, vehicle)
    lines = [
        f"`explain` on {fit[0].name} and {fit[1].name}: {found.verdict}, "
        f"{', '.join(found.effects) or 'no effect'}.",
        "",
        f"| task | twin | {' | '.join(GROUPS)} |",
        "|---|---|" + "---|" * len(GROUPS),
    ]
    models = {"as published": vehicle}
    if found.added is not None:
        models["explained"] = found.added
    for task in (TrainingTask("track", 10), TrainingTask("free")):
        for name, model_of in models.items():
            made = residuals_of(logs, model_of, task)
            split = Split(f"explained {name}", made[:2], made[2:])
            rows = score({task: [split]}, preset, seeds, out, jobs)
            per = pooled(rows, ("model", "group")).set_index(["model", "group"])["rmse"]
            for model in ("none", MODEL):
                label = name if model == "none" else f"{name} + compensator"
                here = per[model].reindex(GROUPS)
                cells = ["-" if np.isnan(v) else f"{v:.3g}" for v in here]
                lines.append(f"| {_task(task)} | {label} | {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def _task(task: TrainingTask) -> str:
    return task.protocol if not task.horizon else f"{task.protocol} {task.horizon}"


def alarm_text(splits: Mapping[TrainingTask, Sequence[Split]], preset: Preset, out: Path) -> str:
    """Share of the time with an alarm before and after a fault in the middle of the flight."""
    lines = ["| flight | task | before the fault | after it |", "|---|---|---|---|"]
    for task in (TrainingTask("track", 1), TrainingTask("track", 10)):
        for split in splits[task]:
            for flight in split.test:
                broken, at = with_fault(flight)
                with shipped(split, task, preset, 0, out) as (_, fmu):
                    alarm = fmu.run(broken).anomaly > 1
                before, after = _shares(broken, alarm, at)
                cells = (flight.name, _task(task), f"{before:.1%}", f"{after:.1%}")
                lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def clean_text(splits: Mapping[TrainingTask, Sequence[Split]], preset: Preset, out: Path) -> str:
    """Share of the time with an alarm on flights without a fault."""
    tasks = [task for task in splits if task.protocol == "track"]
    lines = [f"| flights of | {' | '.join(map(_task, tasks))} |", "|---|" + "---|" * len(tasks)]
    for parts in zip(*(splits[task] for task in tasks), strict=True):
        cells = []
        for task, split in zip(tasks, parts, strict=True):
            with shipped(split, task, preset, 0, out) as (_, fmu):
                said = [(f, fmu.run(f)) for f in split.test]
            rings = [(c.anomaly > 1)[in_spans(f)] for f, c in said]
            cells.append(f"{np.concatenate(rings).mean():.1%}")
        lines.append(f"| {parts[0].name} | {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def with_fault(flight: ResidualFlight) -> tuple[ResidualFlight, int]:
    """The flight with a step in one reading from the middle of its time in the air, and the row."""
    at = (flight.spans[0][0] + flight.spans[-1][1]) // 2
    residual = flight.residual.copy()
    residual[at:, CHANNELS.index(FAULT)] += FAULT_RAD_S
    return replace(flight, residual=residual), at


def _shares(flight: ResidualFlight, alarm: NDArray[np.bool_], at: int) -> tuple[float, float]:
    before, after = in_spans(flight), in_spans(flight)
    before[at:] = False
    after[:at] = False
    return float(alarm[before].mean()), float(alarm[after].mean())


def page(parts: Mapping[str, str]) -> str:
    """All parts under their titles."""
    return "\n".join(f"## {title}\n\n{text}" for title, text in parts.items())


def _parts(given: argparse.Namespace) -> Iterator[tuple[str, str]]:
    preset = replace(BEST, epochs=given.epochs)
    out = given.out / "models"
    logs = [read_flight(given.data / "rflysimdt" / f"real_{k}.ulg") for k in (1, 2, 3)]
    splits = {task: real_splits(logs, VEHICLE, task) for task in TASKS}
    rows = score(splits, preset, given.seeds, out / "real", given.jobs)
    yield "Real flights, each held out in turn", table_text(rows)
    yield "Real flights: rms over that of the best trivial baseline", verdicts(rows)
    yield "Real flights: share within one and two predicted spreads", coverage(rows)
    alarms = alarm_text(splits, preset, out / "real")
    yield f"{FAULT} off by {FAULT_RAD_S:g} rad/s from mid-flight on: time with an alarm", alarms
    explained = explained_text(logs, preset, given.seeds, out / "explained", given.jobs)
    yield "After `explain`", explained
    if given.simulated is None:
        return
    made = {
        task: simulated_splits(given.simulated, given.aircraft, given.jobs, task)
        for task in SIMULATED_TASKS
    }
    for name in made[FREE]:
        own = {task: splits[name] for task, splits in made.items()}
        rows = score(own, preset, 1, out / name.replace(" ", "_"), given.jobs)
        yield f"Simulated flights with hidden effects, {name}", table_text(rows)
        yield f"The same: rms over that of the best trivial baseline, {name}", verdicts(rows)
        yield f"The same: share within one and two predicted spreads, {name}", coverage(rows)
        alarms = clean_text(own, preset, out / name.replace(" ", "_"))
        yield f"The same: time with an alarm, though nothing is wrong, {name}", alarms


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder of the recorded flights")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--simulated", type=Path, help="folder of the simulated flights")
    parser.add_argument("--aircraft", type=int, default=2, help="simulated ones per hidden set")
    parser.add_argument("--epochs", type=int, default=40, help="of every training")
    parser.add_argument("--seeds", type=int, default=3, help="trainings of each real split")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    parts = {}
    for title, text in _parts(given):
        parts[title] = text
        (given.out / "prediction.md").write_text(page(parts), "utf-8")
    print(page(parts))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
