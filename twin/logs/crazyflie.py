"""Reader of Crazyflie uSD-card logs; the only module with Bitcraze's units, axes and names.

Axes of the firmware: body x forward, y left, z up; world x, y, z up, as defined by its positioning
system. Both are rotated by half a turn about x into FRD and NED; x of the world is taken for north.
Source of names and units: Bitcraze, logging groups of crazyflie-firmware.
"""

import struct
import zlib
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..errors import LogError
from ..frames import from_euler
from ..vehicle import GRAVITY_M_S2
from ..vehicle.layouts import frame
from .airframe import Airframe, SourcedValue
from .assemble import FlightBuilder, phases_of_table
from .autopilot import Span, ground_spans
from .columns import ACC, GYRO, MAG, POS, QUAT, VEL, motor_columns
from .flight import Array, Finding, FindingCollector, Flight
from .formats import ReadOptions
from .stamps import monotonic, monotonic_samples

# -- the file -----------------------------------------------------------------------------------
#
# The file that the uSD-card deck of a Crazyflie writes.
#
# `BC`, the version and the number of kinds of events (uint16 each); of each kind its number
# (uint16), its name, the number of its variables (uint16) and each as `group.name(c)` with the
# letter of its type in Python's `struct`, texts ended by a zero. Then the events: number of the
# kind (uint16), time since boot (version 1: ms, uint32; version 2: us, uint64), values without
# gaps. At the end the CRC-32 of all of it. Little-endian. Source: Bitcraze, crazyflie-firmware,
# usddeck.c.

_TYPES = frozenset("bBhHiIqQefd?")  # letters of Python's struct
_STAMPS = {1: ("<u4", 1000), 2: ("<u8", 1)}
"""Type of a time stamp and its unit in us, by version."""
_HEAD = struct.Struct("<BHH")  # magic byte, version, number of kinds
_CRC_BYTES = 4  # checksum at the end
_LONGEST_NAME = 256  # bytes; longer ones are damage
_MOST_VARIABLES = 10_000  # variables of all kinds together; more are damage
_NEVER_US = 2**62  # replaces a time beyond int64
TIME, KIND = "#time", "#kind"
"""Fields of an event that are no variables; no C name begins with #."""


@dataclass(frozen=True, slots=True)
class Kind:
    """Definition of one kind of events.

    Attributes:
        name: Name of the kind: `fixedFrequency`, or that of the event that triggers it.
        layout: Layout of one event, number and time included.
    """

    name: str
    layout: np.dtype[np.void]

    @property
    def variables(self) -> tuple[str, ...]:
        """Names, as `group.name`."""
        return tuple(n for n in self.layout.names or () if n not in (KIND, TIME))


@dataclass(frozen=True, slots=True, eq=False)
class Events:
    """All events of one kind, in the order of the file.

    Attributes:
        kind: Kind of the events.
        t_us: Time since boot, us, shape (n,).
        rows: Events as a structured array, shape (n,).
    """

    kind: Kind
    t_us: NDArray[np.int64]
    rows: NDArray[np.void]

    def values(self, names: tuple[str, ...]) -> Array:
        """Variables side by side, shape (n, len(names))."""
        with np.errstate(invalid="ignore"):  # damaged logs contain signalling NaN
            return np.column_stack([self.rows[n].astype(np.float64) for n in names])


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """Content of a uSD-card log.

    Attributes:
        version: Version of the format.
        events: Events by kind, without kinds that have no events.
        lost: Number of bytes at the end that could not be decoded.
        whole: Whether the checksum at the end is correct.
    """

    version: int
    events: tuple[Events, ...]
    lost: int
    whole: bool


def read_content(path: Path, blob: bytes) -> Content:
    """Decode a file; bytes after an event of an unknown kind are lost.

    Args:
        path: File name, for messages.
        blob: Content of the file.

    Raises:
        LogError: Its head is incomplete or invalid.
    """
    try:
        version, kinds, begin = _head(blob)
    except (struct.error, ValueError, KeyError) as error:
        raise LogError(
            f"{path.name}: the head of the Crazyflie log cannot be read ({error}): it was cut or "
            "damaged. Copy the file from the card again."
        ) from error
    whole = zlib.crc32(blob[:-_CRC_BYTES]) == int.from_bytes(blob[-_CRC_BYTES:], "little")
    end = len(blob) - _CRC_BYTES * whole
    starts, reached = _starts(blob, begin, end, kinds)
    content = np.frombuffer(blob, np.uint8)
    _, unit_us = _STAMPS[version]
    found = []
    for number, kind in kinds.items():
        here = np.frombuffer(starts[number], dtype=np.int64)
        if len(here) == 0:
            continue
        size = kind.layout.itemsize
        rows = content[here[:, None] + np.arange(size)].reshape(-1).view(kind.layout)
        stamps = np.minimum(rows[TIME], np.uint64(_NEVER_US // unit_us)).astype(np.int64)
        found.append(Events(kind, stamps * unit_us, rows))
    return Content(version, tuple(found), end - reached, whole)


def _head(blob: bytes) -> tuple[int, dict[int, Kind], int]:
    """Version, kinds by number, and offset of the first event."""
    _, version, count = _HEAD.unpack_from(blob)
    stamp, _ = _STAMPS[version]
    kinds: dict[int, Kind] = {}
    at, total = _HEAD.size, 0
    for _ in range(count):
        (number,) = struct.unpack_from("<H", blob, at)
        name, at = _text(blob, at + 2)
        (several,) = struct.unpack_from("<H", blob, at)
        at, total = at + 2, total + several
        if total > _MOST_VARIABLES:
            raise ValueError(f"more than {_MOST_VARIABLES} variables")
        fields = [(KIND, "<u2"), (TIME, stamp)]
        for _ in range(several):
            variable, at = _text(blob, at)
            title, letter = variable[:-3], variable[-2:-1]
            if variable != f"{title}({letter})" or letter not in _TYPES:
                raise ValueError(f"variable {variable!r} of no known type")
            fields.append((title, "<" + letter))
        if number in kinds:
            raise ValueError(f"two kinds of number {number}")
        kinds[number] = Kind(name, np.dtype(fields))
    return version, kinds, at


def _text(blob: bytes, at: int) -> tuple[str, int]:
    """A zero-terminated text, and the offset behind it."""
    end = blob.find(b"\0", at, at + _LONGEST_NAME)
    if end < 0:
        raise ValueError(f"a name without an end at byte {at}")
    return blob[at:end].decode("ascii"), end + 1


def _starts(
    blob: bytes, begin: int, end: int, kinds: Mapping[int, Kind]
) -> tuple[dict[int, "array[int]"], int]:
    """Offsets of the events of each kind, and the offset from which nothing can be decoded."""
    starts = {number: array("q") for number in kinds}
    sizes = {number: kind.layout.itemsize for number, kind in kinds.items()}
    at = begin
    while at + 2 <= end:
        number = blob[at] | blob[at + 1] << 8
        size = sizes.get(number, 0)
        if not size or at + size > end:
            break
        starts[number].append(at)
        at += size
    return starts, at


# -- the flight ---------------------------------------------------------------------------------

_MOTORS = 4  # number of motors of every Crazyflie
_FULL = 65535.0  # PWM of command 1
_ACC_HZ, _GYRO_HZ = 30.0, 80.0
"""ACCEL_LPF_CUTOFF_FREQ and GYRO_LPF_CUTOFF_FREQ of the firmware, at 1 kHz, second order."""
_IS_FLYING = 4
"""Bit of supervisor.info that is set in flight."""
_PER_RPM = 2.0 * np.pi / 60.0  # rad/s


def _turned(factor: float) -> Callable[[Array], Array]:
    """Conversion forward, left, up -> forward, right, down, times a factor."""

    def turned(values: Array) -> Array:
        with np.errstate(invalid="ignore"):  # damaged logs contain signalling NaN
            return np.asarray(values * (factor, -factor, -factor))

    return turned


def _attitude(values: Array) -> Array:
    """Attitude from a quaternion x, y, z, w; both frames are rotated about x, so y and z change
    sign."""
    with np.errstate(invalid="ignore"):  # damaged logs contain signalling NaN
        return np.asarray(values[:, [3, 0, 1, 2]] * (1.0, 1.0, -1.0, -1.0))


def _from_angles(values: Array) -> Array:
    """Attitude from roll, pitch, yaw in degrees; the firmware's pitch is positive nose up as in
    FRD, its yaw is positive to the left."""
    roll, pitch, yaw = np.deg2rad(values).T
    return from_euler(roll, pitch, -yaw).T


@dataclass(frozen=True, slots=True)
class _Signal:
    """Columns of the table and the variables that they come from.

    Attributes:
        where: Name in findings and limits.
        columns: Columns of the flight table.
        variables: Variables, `group.name`, each in its own unit.
        convert: Conversion to SI, NED, FRD; shapes (n, k) to (n, len(columns)).
        cutoff_hz: Cut-off of the low-pass applied before logging; 0: none.
    """

    where: str
    columns: tuple[str, ...]
    variables: tuple[str, ...]
    convert: Callable[[Array], Array]
    cutoff_hz: float = 0.0


def _three(group: str, names: str = "x y z") -> tuple[str, ...]:
    return tuple(f"{group}.{n}" for n in names.split())


_CMD, _ROTOR = motor_columns("cmd", _MOTORS), motor_columns("rotor", _MOTORS)
"""Columns of the motors."""
_VELOCITIES = "vx vy vz"  # variables of stateEstimate
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
"""Signals of the log; of several with the same columns the first that the log contains is used."""


@dataclass(slots=True)
class _Log(FindingCollector):
    """A log while it is read.

    Attributes:
        path: Path of the file.
        content: Decoded content of the file.
        start_us: Time since boot that is time 0.
        findings: Findings so far.
    """

    path: Path
    content: Content
    start_us: int
    findings: list[Finding] = field(default_factory=list)

    def having(self, variables: tuple[str, ...]) -> Events | None:
        """Events of the kind that has all variables; of several, the kind with most events."""
        fit = [e for e in self.content.events if set(variables) <= set(e.kind.variables)]
        return max(fit, key=lambda e: len(e.t_us), default=None)

    def ordered(self, events: Events, where: str) -> NDArray[np.bool_]:
        """Mask of the events whose time increases; findings count the others."""
        return monotonic_samples(self, where, events.t_us - self.start_us, "events")


def read_usd_log(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read the log of a Crazyflie's uSD-card deck; arguments and errors as in `formats.Reader`."""
    content = read_content(path, blob)
    if not content.events:
        raise LogError(f"{path.name}: a Crazyflie log without a single event; nothing was logged.")
    log = _Log(path, content, min(int(e.t_us[monotonic(e.t_us)[0]].min()) for e in content.events))
    _note_damage(log)
    flight = FlightBuilder(log, path, {"firmware": "Crazyflie"})
    used: set[str] = set()
    for signal in _SIGNALS:
        if signal.where not in used and _add(log, flight, signal):
            used.add(signal.where)
            flight.facts[f"{signal.where} from"] = ", ".join(signal.variables)
    if "cmd" not in used:
        log.note("warning", "cmd", "no motor.m1 to m4 in the log. Add them to config.txt")
    named = sorted(n for e in content.events for n in e.kind.variables)
    advice = (
        f"It holds {', '.join(named[:8]) or 'no variable'}. Log acc, gyro, stateEstimate and motor "
        "(config.txt of the card)."
    )
    table = flight.lay_out(advice)
    aircraft = Airframe(
        rotors=SourcedValue(_MOTORS, "the mixer of the firmware"),
        layout=frame("crazyflie x", "the mixer of the firmware"),
        accel_cutoff_hz=SourcedValue(_ACC_HZ, "ACCEL_LPF_CUTOFF_FREQ of the firmware"),
        gyro_cutoff_hz=SourcedValue(_GYRO_HZ, "GYRO_LPF_CUTOFF_FREQ of the firmware"),
    )
    return flight.flight(table, _phases(log, table), airframe=aircraft)


def _note_damage(log: _Log) -> None:
    """Findings on parts of the file that are missing or invalid."""
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


def _add(log: _Log, flight: FlightBuilder, signal: _Signal) -> bool:
    """Add a signal to the table, if the log has it."""
    events = log.having(signal.variables)
    if events is None:
        return False
    keep = log.ordered(events, signal.where)
    t_us = events.t_us[keep] - log.start_us
    if signal.cutoff_hz:
        t_us = t_us - flight.filter_delay_us(signal.where, signal.cutoff_hz)
    values = signal.convert(events.values(signal.variables)[keep])
    if signal.columns == QUAT:
        flight.add_attitude(t_us, values)
    else:
        flight.add(signal.where, signal.columns, t_us, values)
    return True


def _phases(log: _Log, table: pd.DataFrame) -> list[Span]:
    """Phases by the firmware's flag for flight, and by the velocity."""
    ground: list[Span] = []
    for name, bit in (("supervisor.info", _IS_FLYING), ("sys.isFlying", 0)):
        events = log.having((name,))
        if events is not None:
            keep = log.ordered(events, "phase")
            flies = events.rows[name][keep].astype(np.int64) >> bit & 1
            t_s = (events.t_us[keep] - log.start_us).astype(np.float64) * 1e-6
            ground = ground_spans(t_s, flies == 0)
            break
    return phases_of_table(table, ground)
