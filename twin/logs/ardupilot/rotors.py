"""Rotor speeds that the speed controllers report (ESC), put on one clock where they are good."""

import numpy as np
from numpy.typing import NDArray

from ..assemble import Rows
from ..columns import motor_columns
from ..flight import Array
from ..incidents import lower_voltage
from .log import ArduPilotLog, Topic
from .outputs import MotorCommands
from .signals import add, si

_WORKING = 0.1
_LONGEST_S = 0.25
_LEAST_GOOD = 0.8
_FEWEST = 20


def add_rotors(log: ArduPilotLog, rows: Rows, commands: MotorCommands | None) -> dict[str, str]:
    """Rotor speeds of all motors, from the instances of ESC that belong to their outputs.

    Speeds come from each controller in its own time. They are put on the times of the one that
    reports least, linear between two reports at most 0.25 s apart.

    Returns:
        Facts on them.
    """
    there = log.instances("ESC")
    if not there or commands is None:
        return {}
    wanted = instances_of(commands.channels, there)
    if not wanted:
        log.note(
            "warning",
            "rotor",
            f"left out: ESC has instances {', '.join(map(str, there))}, the motors are outputs "
            f"{', '.join(map(str, commands.channels))}",
        )
        return {}
    topics = [log.topic("ESC", k, "RPM") for k in wanted]
    found = [t for t in topics if t is not None and len(t.t_us) >= _FEWEST]
    if len(found) < len(wanted):
        message = f"left out: ESC reports speeds of {len(found)} of {len(wanted)} motors"
        log.note("warning", "rotor", message)
        return {}
    speeds = [np.abs(si(log, t, "rotor", ("RPM",))[:, 0]) for t in found]
    log.findings += lower_voltage(
        {
            m: si(log, t, "vbat_v", ("Volt",))[s > 0.0, 0]
            for m, (t, s) in enumerate(zip(found, speeds, strict=True), start=1)
            if t.has("Volt")
        }
    )
    if why := _doubt(found, speeds, commands):
        log.note("warning", "rotor", f"left out: {why}", sum(map(len, speeds)))
        return {}
    least = min(range(len(found)), key=lambda k: len(found[k].t_us))
    slowest = found[least]
    columns = [_at(slowest.t_us, t.t_us, s) for t, s in zip(found, speeds, strict=True)]
    together = np.column_stack(columns)
    bridged = np.isfinite(together).all(axis=1)
    if not bridged.all():
        message = f"samples left out: a motor reports nothing for over {_LONGEST_S:g} s"
        log.note("warning", "rotor", message, int(np.count_nonzero(~bridged)))
    n = len(found)
    add(log, rows, "rotor", motor_columns("rotor", n), slowest.t_us[bridged], together[bridged])
    log.note(
        "info",
        "rotor",
        "the speed controllers report at different times; all are interpolated to those of number "
        f"{wanted[least]}",
    )
    rates = ", ".join(f"{t.rate_hz:.0f}" for t in found)
    poles = log.params.get("SERVO_BLH_POLES", 0.0)
    counted = f"; SERVO_BLH_POLES {poles:.0f}, which scales what DShot reports" if poles else ""
    return {"rotor speeds": f"ESC {', '.join(map(str, wanted))} at {rates} Hz{counted}"}


def instances_of(channels: tuple[int, ...], there: list[int]) -> list[int]:
    """Instances of ESC of the motors, [] where they cannot be told.

    An instance is an output counted from 0, or, where the controllers are counted from the first
    one that is a motor, its place among the outputs of motors.
    """
    by_output = [c - 1 for c in channels]
    if set(by_output) <= set(there):
        return by_output
    if len(there) == len(channels):
        places = sorted(channels)
        return [there[places.index(c)] for c in channels]
    return []


def _at(t_us: NDArray[np.int64], own_us: NDArray[np.int64], values: Array) -> Array:
    """A controller's speeds at other times, NaN where its reports are too far apart."""
    after = np.clip(np.searchsorted(own_us, t_us), 1, len(own_us) - 1)
    near = (own_us[after] - own_us[after - 1]) <= _LONGEST_S * 1e6
    near |= np.isin(t_us, own_us)
    inside = (t_us >= own_us[0]) & (t_us <= own_us[-1])
    return np.where(near & inside, np.interp(t_us, own_us, values), np.nan)


def _doubt(topics: list[Topic], speeds: list[Array], commands: MotorCommands) -> str:
    """Why the speeds are not those of the motors, "" where they may be."""
    cmd = commands.cmd
    for motor, (topic, speed) in enumerate(zip(topics, speeds, strict=True)):
        own = np.interp(topic.t_us, commands.t_us, cmd[:, motor])
        working = own > _WORKING
        if working.sum() < _FEWEST:
            return f"motor {motor + 1} works in {int(working.sum())} reports"
        steps_s = np.diff(topic.t_us[working]) * 1e-6
        covered = float(steps_s[steps_s <= _LONGEST_S].sum() / steps_s.sum())
        if covered < _LEAST_GOOD:
            return f"motor {motor + 1} is reported in {covered:.0%} of the time that it works"
        turning = np.isfinite(speed) & (speed > 0.0)
        if turning[working].mean() < _LEAST_GOOD:
            return f"motor {motor + 1} has a speed in {turning[working].mean():.0%} of the reports"
        if np.ptp(speed[working & turning]) == 0.0:
            return f"motor {motor + 1} never changes its speed"
    return ""
