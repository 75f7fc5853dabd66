"""One case flown and looked at, and what came of it as a file."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from twin.logs import Flight
from twin.vehicle import Vehicle

from .flights import Case, aircraft, flown
from .run import ran


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
