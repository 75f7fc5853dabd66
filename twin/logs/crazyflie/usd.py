"""Crazyflie uSD-card log -> Flight.

Axes of the firmware: body x forward, y left, z up; world x, y, z up, as its positioning system lays
it. Both are turned by half a turn about x, which makes them FRD and NED, x of the world taken for
north. Source of names and units: Bitcraze, logging groups of crazyflie-firmware.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...errors import LogError
from ...frames import from_euler
from ...vehicle import GRAVITY_M_S2
from ...vehicle.layouts import frame
from ..airframe import Airframe, Told
from ..assemble import Rows, add_signal, lay_out
from ..attitude import unit_quaternions
from ..clock import advancing, filter_delay_us, told_dropped
from ..columns import ACC, GYRO, MAG, POS, QUAT, VEL, motor_columns
from ..flight import Array, Finding, Flight, Noted
from ..formats import ReadOptions
from ..phases import Span, ground_spans, label_phases, motion_spans
from .file import Content, Events, read_content

_MOTORS = 4
_FULL = 65535.0
_ACC_HZ, _GYRO_HZ = 30.0, 80.0
"""ACCEL_LPF_CUTOFF_FREQ and GYRO_LPF_CUTOFF_FREQ of the firmware, at 1 kHz, second order."""
_IS_FLYING = 4
"""Bit of supervisor.info."""
_PER_RPM = 2.0 * np.pi / 60.0


def _turned(factor: float) -> Callable[[Array], Array]:
    """Forward, left, up -> forward, right, down, times a factor."""

    def turned(values: Array) -> Array:
        with np.errstate(invalid="ignore"):  # damaged logs hold signalling NaN
            return np.asarray(values * (factor, -factor, -factor))

    return turned


def _attitude(values: Array) -> Array:
    """Of a quaternion x, y, z, w; both frames are turned about x, so that y and z change sign."""
    with np.errstate(invalid="ignore"):  # damaged logs hold signalling NaN
        return np.asarray(values[:, [3, 0, 1, 2]] * (1.0, 1.0, -1.0, -1.0))


def _from_angles(values: Array) -> Array:
    """Of roll, pitch, yaw in degrees; the firmware's pitch is positive nose up already, and its yaw
    counts to the left."""
    roll, pitch, yaw = np.deg2rad(values).T
    return from_euler(roll, pitch, -yaw).T


@dataclass(frozen=True, slots=True)
class _Signal:
    """Columns of the table and the variables that they come from.

    Attributes:
        where: Name in findings and limits.
        columns: Of the table.
        variables: `group.name`, each in its own unit.
        convert: From these to SI, NED, FRD; shapes (n, k) to (n, len(columns)).
        cutoff_hz: Of the low-pass that it went through before it was logged; 0: none.
    """

    where: str
    columns: tuple[str, ...]
    variables: tuple[str, ...]
    convert: Callable[[Array], Array]
    cutoff_hz: float = 0.0


def _three(group: str, names: str = "x y z") -> tuple[str, ...]:
    return tuple(f"{group}.{n}" for n in names.split())


_CMD, _ROTOR = motor_columns("cmd", _MOTORS), motor_columns("rotor", _MOTORS)
_VELOCITIES = "vx vy vz"
_SIGNALS = (
    _Signal("acc", ACC, _three("acc"), _turned(GRAVITY_M_S2), _ACC_HZ),
    _Signal("gyro", GYRO, _three("gyro"), _turned(np.pi / 180.0), _GYRO_HZ),
    _Signal("mag", MAG, _three("mag"), _turned(1e-4)),
    _Signal("baro", ("baro_pa",), ("baro.pressure",), lambda hpa: 100.0 * hpa),
    _Signal("pos", POS, _three("stateEstimate"), _turned(1.0)),
    _Signal("pos", POS, _three("stateEstimateZ"), _turned(1e-3)),
    _Signal("vel", VEL, _three("stateEstimate", _VELOCITIES), _turned(1.0)),
    _Signal("vel", VEL, _three("stateEstimateZ", _VELOCITIES), _turned(1e-3)),
    _Signal("q", QUAT, _three("stateEstimate", "qx qy qz qw"), _attitude),
    _Signal("q", QUAT, _three("stateEstimate", "roll pitch yaw"), _from_angles),
    _Signal("q", QUAT, _three("stabilizer", "roll pitch yaw"), _from_angles),
    _Signal("cmd", _CMD, tuple(f"pwm.m{i}_pwm" for i in range(1, 5)), lambda n: n / _FULL),
    _Signal("cmd", _CMD, tuple(f"motor.m{i}" for i in range(1, 5)), lambda n: n / _FULL),
    _Signal("rotor", _ROTOR, tuple(f"rpm.m{i}" for i in range(1, 5)), lambda n: n * _PER_RPM),
    _Signal("vbat_v", ("vbat_v",), ("pm.vbat",), lambda volts: volts),
    _Signal("vbat_v", ("vbat_v",), ("pm.vbatMV",), lambda millivolts: 1e-3 * millivolts),
)
"""Of several for the same columns the first that the log has."""


@dataclass(slots=True)
class _Log(Noted):
    """A log while it is read.

    Attributes:
        path: File.
        content: What it holds.
        start_us: Time since boot that counts as 0.
        findings: Grows.
    """

    path: Path
    content: Content
    start_us: int
    findings: list[Finding] = field(default_factory=list)

    def having(self, variables: tuple[str, ...]) -> Events | None:
        """Of the kinds of events that have all variables, the one with most."""
        fit = [e for e in self.content.events if set(variables) <= set(e.kind.variables)]
        return max(fit, key=lambda e: len(e.t_us), default=None)

    def ordered(self, events: Events, where: str) -> NDArray[np.bool_]:
        """Which of them can stay so that time increases; the others are told."""
        keep, *lost = advancing(events.t_us - self.start_us)
        for message, count in told_dropped("events", *lost):
            self.note("error", where, message, count)
        return keep


def read_usd_log(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read the log of a Crazyflie's uSD-card deck.

    Args:
        path: File name.
        blob: Content of the file.
        options: Of no concern: the commands are those that are logged.

    Raises:
        LogError: Nothing in it can be used.
    """
    content = read_content(path, blob)
    if not content.events:
        raise LogError(f"{path.name}: a Crazyflie log without a single event; nothing was logged.")
    log = _Log(path, content, min(int(e.t_us[advancing(e.t_us)[0]].min()) for e in content.events))
    _note_damage(log)
    rows, facts = Rows(), {"firmware": "Crazyflie"}
    used: set[str] = set()
    for signal in _SIGNALS:
        if signal.where not in used and _add(log, rows, signal):
            used.add(signal.where)
            facts[f"{signal.where} from"] = ", ".join(signal.variables)
    if "cmd" not in used:
        log.note("warning", "cmd", "no motor.m1 to m4 in the log. Add them to config.txt")
    named = sorted(n for e in content.events for n in e.kind.variables)
    advice = (
        f"It holds {', '.join(named[:8]) or 'no variable'}. Log acc, gyro, stateEstimate and motor "
        "(config.txt of the card)."
    )
    table, t_us = lay_out(log, path, rows, advice)
    phase = label_phases(table["time"].to_numpy(), _phases(log, table))
    table["phase"] = pd.Series(phase, dtype=object)
    aircraft = Airframe(
        rotors=Told(_MOTORS, "the mixer of the firmware"),
        layout=frame("crazyflie x", "the mixer of the firmware"),
        accel_cutoff_hz=Told(_ACC_HZ, "ACCEL_LPF_CUTOFF_FREQ of the firmware"),
        gyro_cutoff_hz=Told(_GYRO_HZ, "GYRO_LPF_CUTOFF_FREQ of the firmware"),
    )
    facts |= rows.coverage(t_us)
    return Flight(path.stem, table, tuple(log.findings), facts, path, None, aircraft)


def _note_damage(log: _Log) -> None:
    """What of the file is missing or makes no sense."""
    content = log.content
    if content.lost:
        message = "bytes at the end of which nothing can be made: the log was cut or damaged"
        log.note("error", "log", message, content.lost)
    elif not content.whole:
        log.note(
            "error",
            "log",
            "its checksum is not that of its content: it was damaged, or logging was not stopped "
            "before the aircraft was switched off",
        )


def _add(log: _Log, rows: Rows, signal: _Signal) -> bool:
    """Put a signal into the table, if the log has it."""
    events = log.having(signal.variables)
    if events is None:
        return False
    keep = log.ordered(events, signal.where)
    t_us = events.t_us[keep] - log.start_us
    if signal.cutoff_hz:
        delay_us = filter_delay_us(signal.cutoff_hz)
        log.note(
            "info",
            signal.where,
            f"low-passed at {signal.cutoff_hz:.0f} Hz before it was logged; its time is "
            f"{delay_us / 1e3:.1f} ms before the stamp of the log, the delay of that filter",
        )
        t_us = t_us - delay_us
    values = signal.convert(events.values(signal.variables)[keep])
    if signal.columns == QUAT:
        usable, values = unit_quaternions(log, values)
        t_us = t_us[usable]
    add_signal(log, rows, signal.where, signal.columns, t_us, values)
    return True


def _phases(log: _Log, table: pd.DataFrame) -> list[Span]:
    """By whether the firmware believes that it flies, and by the velocity."""
    ground: list[Span] = []
    for name, bit in (("supervisor.info", _IS_FLYING), ("sys.isFlying", 0)):
        events = log.having((name,))
        if events is not None:
            keep = log.ordered(events, "phase")
            flies = events.rows[name][keep].astype(np.int64) >> bit & 1
            t_s = (events.t_us[keep] - log.start_us).astype(np.float64) * 1e-6
            ground = ground_spans(t_s, flies == 0)
            break
    if not set(VEL) <= set(table):
        return ground
    known = table[["time", *VEL]].dropna().to_numpy()
    return motion_spans(known[:, 0], known[:, 1:], ground)
