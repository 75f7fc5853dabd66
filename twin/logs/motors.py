"""Assignment of physical outputs to motors, with unit and range, and its source in the log.

Every reader of an autopilot's log fills one `MotorOutput` per motor; commands are computed from
these only. Where the log lacks the information, `source` names what was missing and the reader adds
a finding.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from .flight import Array, FindingCollector
from .stamps import mean_rate_hz

_STOPPED = 0.01
"""Command above which a motor runs."""
_ABSURD = 3.0
"""Magnitude of a damaged command; a pulse width of 0, of motors that are off, gives -1 or -2."""
_IDLE, _WORKING = 0.05, 0.2
"""Mean command below which motors idle, and above which they draw a current."""
_STEADY_A = 1e-4
"""Standard deviation below which a current is constant."""


@dataclass(frozen=True, slots=True)
class MotorOutput:
    """The output of one motor.

    Attributes:
        motor: Number of the motor, from 1: `cmd_i` and `rotor_i` of the flight table.
        place: Message or topic and the field of this output.
        unit: Unit of the logged values: "us", "DShot", "CAN", "" for a command 0..1.
        low: Logged value of command 0.
        high: Logged value of command 1; below `low` for a reversed output.
        source: Parameters or fields that state this assignment.
    """

    motor: int
    place: str
    unit: str
    low: float
    high: float
    source: str


def commands_of(outputs: Sequence[MotorOutput], values: Array) -> Array:
    """Commands from logged values, not clipped, shape (n, motors) as `values`."""
    low = np.array([o.low for o in outputs])
    high = np.array([o.high for o in outputs])
    return np.asarray((values - low) / (high - low))


def describe_outputs(outputs: Sequence[MotorOutput]) -> str:
    """All outputs in one line, in the order of the motors, with their source."""
    ranges = [f"{o.low:g} to {o.high:g} {o.unit}".rstrip() for o in outputs]
    same = len(set(ranges)) == 1
    places = [o.place if same else f"{o.place} {r}" for o, r in zip(outputs, ranges, strict=True)]
    common = f", {ranges[0]}" if same else ""
    sources = ", ".join(dict.fromkeys(s for o in outputs for s in o.source.split(", ")))
    return f"{', '.join(places)}{common} ({sources})"


@dataclass(frozen=True, slots=True)
class MotorCommands:
    """Commands 0..1 of all motors.

    Attributes:
        t_us: Times, us, shape (n,).
        cmd: Commands, shape (n, motors).
        facts: Printable facts about the commands.
    """

    t_us: NDArray[np.int64]
    cmd: Array
    facts: dict[str, str] = field(default_factory=dict)

    @property
    def running(self) -> NDArray[np.bool_]:
        """Whether any motor has a command above a hundredth, shape (n,)."""
        return np.asarray((self.cmd > _STOPPED).any(axis=1))

    def note_slow(self, log: FindingCollector, enough_hz: float) -> float:
        """Rate of the commands, Hz; a finding where it is below `enough_hz`."""
        rate_hz = mean_rate_hz(self.t_us)
        if rate_hz < enough_hz:
            message = f"motor commands at only {rate_hz:.0f} Hz; each is held until the next"
            log.note("warning", "cmd", message)
        return rate_hz

    def clipped(self, log: FindingCollector, source: str) -> "MotorCommands":
        """The commands clipped to 0..1; findings count the samples outside.

        Args:
            log: Collects the findings.
            source: Topic or message of the commands.
        """
        absurd = np.abs(self.cmd) > _ABSURD
        log.note("error", "cmd", f"values of {source} beyond {_ABSURD:g} set to 0 or 1", absurd)
        outside = ((self.cmd < -1e-6) | (self.cmd > 1.0 + 1e-6)) & ~absurd
        message = f"values of {source} outside 0..1 (disarmed, or arming) set to its end"
        log.note("info", "cmd", message, outside)
        return replace(self, cmd=np.asarray(np.clip(self.cmd, 0.0, 1.0)))


def doubt_current(
    t_us: NDArray[np.int64], amps: Array, commands: MotorCommands | None, source: str
) -> str:
    """Why a logged current cannot be that of the motors, "" where it can.

    Args:
        t_us: Times, us, shape (n,).
        amps: Current, A, shape (n,); NaN: no sample.
        commands: Clipped commands; None: not known.
        source: Topic or message of the current.
    """
    known = np.isfinite(amps)
    t_us, amps = t_us[known], amps[known]
    if not len(amps):
        return f"{source} has no current"
    with np.errstate(over="ignore"):
        if amps.max() <= 0.0:
            return f"the current is never positive ({amps.min():.2f} A): no current sensor"
        if amps.std() < _STEADY_A:
            return f"the current is {amps.mean():.2f} A throughout: no current sensor"
    if commands is None or not len(commands.t_us):
        return ""
    mean = np.interp(t_us, commands.t_us, commands.cmd.mean(axis=1))
    idle, working = amps[mean < _IDLE], amps[mean > _WORKING]
    if len(idle) and len(working) and np.median(working) < 1.5 * np.median(idle):
        return (
            f"{np.median(working):.2f} A in flight and {np.median(idle):.2f} A with the motors "
            "idle: this is not the current of the motors"
        )
    return ""
