"""Motor commands of a DataFlash log: the pulse widths of RCOU, of the outputs that drive motors."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..columns import MAX_MOTORS, MIN_MOTORS
from ..flight import Array
from ..outputs import MotorOutput, commands_of, described
from .geometry import CLASSES, NO_MULTIROTOR, geometry
from .identity import frame_of
from .log import ArduPilotLog, Topic
from .parameters import TRICOPTER, motor_channels, motor_value, pulse_range_us

_ENOUGH_HZ = 50.0
_ABSURD = 2.0
"""A command farther than that from 0..1 is damaged; a pulse width of 0, of none, is -1 or -2."""
_OUTPUT = re.compile(r"(?:C|Ch|Chan)([1-9][0-9]?)")
_IDLE = 0.01
_ONESHOT125, _SHORT_US = 2.0, 300.0
"""MOT_PWM_TYPE, and what its pulses of 125 to 250 us stay below."""


@dataclass(frozen=True, slots=True)
class MotorCommands:
    """Commands 0..1 of all motors.

    Attributes:
        t_us: Times, us, shape (n,).
        cmd: Shape (n, motors), not clipped.
        channels: Output of each motor, from 1.
        facts: What to print about them.
    """

    t_us: NDArray[np.int64]
    cmd: Array
    channels: tuple[int, ...]
    facts: dict[str, str] = field(default_factory=dict)

    @property
    def running(self) -> NDArray[np.bool_]:
        """Whether any motor gets more than a hundredth, shape (n,)."""
        return np.asarray((self.cmd > _IDLE).any(axis=1))

    def mean_at(self, t_us: NDArray[np.int64]) -> Array:
        """Mean command of the motors at any time, linear between samples."""
        mean = np.clip(self.cmd, 0.0, 1.0).mean(axis=1)
        return np.asarray(np.interp(t_us, self.t_us, mean), dtype=np.float64)


def logged_commands(log: ArduPilotLog, get: Callable[[str], Topic | None]) -> MotorCommands | None:
    """Commands of all motors, None where the log has not got them all.

    Args:
        log: The log; what does not fit is noted by `from_ardupilot_commands` alone.
        get: How a topic of the log is had.
    """
    channels = channels_of(log)
    if not MIN_MOTORS <= len(channels) <= MAX_MOTORS:
        return None
    widths = _widths(get, channels)
    if widths is None:
        return None
    topic, pwm_us = widths
    outputs = motor_outputs(log, channels, pwm_us)
    low, high = outputs[0].low, outputs[0].high
    said = f"{topic.name}, {topic.rate_hz:.0f} Hz, outputs {', '.join(map(str, channels))}"
    facts = {"commands": f"{said}, {low:.0f} to {high:.0f} us", "motors": described(outputs)}
    return MotorCommands(topic.t_us, commands_of(outputs, pwm_us), tuple(channels), facts)


def motor_outputs(log: ArduPilotLog, channels: list[int], widths_us: Array) -> list[MotorOutput]:
    """Output, range and source of each motor.

    Until Copter 3.5 pulses of OneShot125 were divided by 8 before they were logged.
    Source: ArduPilot, AP_Motors::rc_write of that time.

    Args:
        log: The log.
        channels: Output of each motor, from 1.
        widths_us: Logged pulse widths, shape (n, motors).
    """
    low, high = pulse_range_us(log.params)
    source = "MOT_PWM_MIN, MOT_PWM_MAX, MOT_PWM_TYPE"
    longest = float(np.nanmax(widths_us, initial=0.0))
    if motor_value(log.params, "MOT_PWM_TYPE", 0.0) == _ONESHOT125 and longest <= _SHORT_US:
        low, high, source = low / 8.0, high / 8.0, f"{source} 2: OneShot125, an eighth"
    named = {f"SERVO{c}_FUNCTION" for c in channels} <= log.params.keys()
    said = "SERVOn_FUNCTION" if named else "order of the frame"
    return [
        MotorOutput(motor, f"output {channel}", "us", low, high, f"{said}, {source}")
        for motor, channel in enumerate(channels, 1)
    ]


def channels_of(log: ArduPilotLog) -> list[int]:
    """Outputs of the motors: by their functions, else the first ones, as many as the frame has; []
    of what is no multirotor."""
    frame = frame_of(log)
    if frame.kind in NO_MULTIROTOR:
        return []
    if has_functions(log.params):
        return motor_channels(log.params)
    if CLASSES.get(frame.kind) == "tri":
        return list(TRICOPTER)
    rotors = geometry(frame.kind, frame.form)
    return list(range(1, rotors.count + 1)) if rotors else []


def has_functions(params: Mapping[str, float]) -> bool:
    """Whether a log has SERVOn_FUNCTION, as since Copter 3.5."""
    return any(name.startswith("SERVO") and name.endswith("_FUNCTION") for name in params)


def _widths(get: Callable[[str], Topic | None], channels: list[int]) -> tuple[Topic, Array] | None:
    """Pulse widths of the outputs, on the clock of the message that has the first of them."""
    where: dict[int, tuple[Topic, str]] = {}
    for name in ("RCOU", "RCO2", "RCO3"):
        topic = get(name)
        for column in topic.source.data if topic is not None else ():
            if topic is not None and (match := _OUTPUT.fullmatch(column)) and topic.has(column):
                where.setdefault(int(match.group(1)), (topic, column))
    if any(c not in where for c in channels):
        return None
    base = where[channels[0]][0]
    columns = []
    for channel in channels:
        topic, column = where[channel]
        held = np.searchsorted(topic.t_us, base.t_us, side="right") - 1
        columns.append(topic.raw(column)[np.maximum(held, 0)])
    return base, np.column_stack(columns)


def from_ardupilot_commands(log: ArduPilotLog) -> MotorCommands | None:
    """Commands of a flight, clipped; what is missing or clipped is noted."""
    commands = logged_commands(log, log.topic)
    if commands is None:
        channels = channels_of(log)
        outputs = [n for n in ("RCOU", "RCO2", "RCO3") if n in log.content.messages]
        why = f"{', '.join(outputs) or 'no RCOU'} and {len(channels)} motors by SERVOn_FUNCTION"
        if not has_functions(log.params):
            why = f"{', '.join(outputs) or 'no RCOU'} and names no frame of known motors"
        log.note("warning", "cmd", f"no motor commands: the log has {why}. Set LOG_BITMASK bit 10")
        return None
    rate_hz = (len(commands.t_us) - 1) / max(1e-6 * float(np.ptp(commands.t_us)), 1e-9)
    if rate_hz < _ENOUGH_HZ:
        log.note(
            "warning",
            "cmd",
            f"motor commands at only {rate_hz:.0f} Hz; each is held until the next",
        )
    cmd = commands.cmd
    absurd = int(np.count_nonzero(np.abs(cmd - 0.5) > 0.5 + _ABSURD))
    if absurd:
        log.note("error", "cmd", f"values of RCOU beyond {_ABSURD:g} set to 0 or 1", absurd)
    outside = int(np.count_nonzero((cmd < -1e-6) | (cmd > 1.0 + 1e-6))) - absurd
    if outside:
        message = "values of RCOU outside the range of the pulse widths set to its end"
        log.note("info", "cmd", message, outside)
    if not commands.running.any():
        log.note("warning", "cmd", "the motors never run")
    clipped = np.asarray(np.clip(cmd, 0.0, 1.0))
    return MotorCommands(commands.t_us, clipped, commands.channels, commands.facts)
