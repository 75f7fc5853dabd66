"""One flight through the running evidence, second by second, and its result as a file."""

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.explain.running.alarms import Alarm
from twin.explain.running.evidence import RunningEvidence
from twin.explain.running.hypotheses import RUNNING, RunningSettings
from twin.logs import Flight
from twin.vehicle import Vehicle

from .flights import Case, aircraft, flown

BLOCK_S = 1.0
"""Length of a portion of rows, s: as in a live flight."""


@dataclass
class Ran:
    """What came of a flight.

    Attributes:
        seconds: Flown in the air, the quiet start left out.
        opened: Alarms as they were raised; when, on the clock of the flight: the newest row.
        names: By raised alarm, its effect at the end.
        last: Alarms at the end.
        cost_s: Processor per second of flight, the first seconds left out.
        top: Highest log odds of any change before an effect begins.
    """

    seconds: float = 0.0
    opened: list[tuple[float, Alarm]] = field(default_factory=list)
    names: list[list[tuple[float, str]]] = field(default_factory=list)
    last: tuple[Alarm, ...] = ()
    cost_s: list[float] = field(default_factory=list)
    top: float = -np.inf


def ran(flight: Flight, vehicle: Vehicle, settings: Mapping[str, float] | None = None) -> Ran:
    """Feed a flight in blocks of a second.

    Args:
        flight: Recorded.
        vehicle: Its calibrated model.
        settings: Some settings changed.
    """
    chosen: RunningSettings = replace(RUNNING, **(settings or {}))  # type: ignore[arg-type]
    evidence, found = RunningEvidence(vehicle, settings=chosen), Ran()
    t, columns = flight.time_s, flight.columns
    edges = np.searchsorted(t, np.arange(t[0] + BLOCK_S, t[-1] + BLOCK_S, BLOCK_S))
    first = 0
    known: dict[float, int] = {}
    for end in edges:
        if end == first:
            continue
        begun = time.process_time()
        verdict = evidence.update({c: values[first:end] for c, values in columns.items()})
        found.cost_s.append(time.process_time() - begun)
        newest = float(t[end - 1])
        if verdict.flying and not verdict.learning:
            found.seconds += BLOCK_S
            if 0 < verdict.nothing < 1:
                found.top = max(found.top, float(np.log(1 / verdict.nothing - 1 + 1e-300)))
        for alarm in verdict.opened:
            known[alarm.raised_s] = len(found.opened)
            found.opened.append((newest, alarm))
            found.names.append([(newest, alarm.effect)])
        for alarm in verdict.alarms:
            i = known.get(alarm.raised_s)
            if i is not None and found.names[i][-1][1] != alarm.effect:
                found.names[i].append((newest, alarm.effect))
        found.last = verdict.alarms
        first = int(end)
    return found


def score_case(out: Path, case: Case) -> str:
    """Fly a case, look at it, write what came of it; its name."""
    flight, begins_s = flown(case)
    row: dict[str, Any] = {
        "name": case.name,
        "effect": case.effect,
        "magnitude": case.magnitude,
        "aircraft": case.aircraft,
        "begins_s": begins_s if np.isfinite(begins_s) else None,
        **evaluated(flight, aircraft(case.aircraft)),
    }
    write_row(out, case.name, row)
    return case.name


def evaluated(flight: Flight, vehicle: Vehicle) -> dict[str, Any]:
    """What came of a flight, for a file."""
    found = ran(flight, vehicle)
    return {
        "seconds": found.seconds,
        "cost_s": float(np.mean(found.cost_s[4:])) if len(found.cost_s) > 4 else None,
        "alarms": [
            {
                "raised_s": raised_s,
                "effect": alarm.effect,
                "since_s": alarm.since_s,
                "probability": alarm.probability,
                "others": dict(alarm.others),
                "numbers": [[n.name, n.value, n.sd, n.unit] for n in alarm.numbers],
                "names": names,
            }
            for (raised_s, alarm), names in zip(found.opened, found.names, strict=True)
        ],
    }


def file_of(out: Path, name: str) -> Path:
    """Where the result of a case lies."""
    return out / f"{name}.json"


def write_row(out: Path, name: str, row: dict[str, Any]) -> None:
    """Write a result."""
    file_of(out, name).write_text(json.dumps(row, indent=1), "utf-8")
