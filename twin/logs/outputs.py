"""Which physical output drives which motor, in which unit and range, and what in a log says so.

Every reader of an autopilot's log fills one `MotorOutput` per motor; commands are made of nothing
else. Where the log does not say it, `source` names what was missing and the reader adds a finding.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .flight import Array


@dataclass(frozen=True, slots=True)
class MotorOutput:
    """The output of one motor.

    Attributes:
        motor: Number of the motor, from 1: `cmd_i` and `rotor_i` of the flight table.
        place: Message or topic and the field of this output.
        unit: Of the logged values: "us", "DShot", "CAN", "" for a command 0..1.
        low: Logged value of command 0.
        high: Logged value of command 1; below `low` for a reversed output.
        source: Parameters or fields that say all this.
    """

    motor: int
    place: str
    unit: str
    low: float
    high: float
    source: str


def commands_of(outputs: Sequence[MotorOutput], values: Array) -> Array:
    """Commands of logged values, not clipped, shape (n, motors) as `values`."""
    low = np.array([o.low for o in outputs])
    high = np.array([o.high for o in outputs])
    return np.asarray((values - low) / (high - low))


def described(outputs: Sequence[MotorOutput]) -> str:
    """All outputs in a line, in the order of the motors, with what says so."""
    ranges = [f"{o.low:g} to {o.high:g} {o.unit}".rstrip() for o in outputs]
    same = len(set(ranges)) == 1
    places = [o.place if same else f"{o.place} {r}" for o, r in zip(outputs, ranges, strict=True)]
    common = f", {ranges[0]}" if same else ""
    sources = ", ".join(dict.fromkeys(s for o in outputs for s in o.source.split(", ")))
    return f"{', '.join(places)}{common} ({sources})"
