"""Records of the autopilot itself: its modes, setpoints, failures, messages, filters.

Every reader of an autopilot's logs fills them; a flight table in Parquet stores them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..frames import from_euler
from ..representation import ShortRepr
from .columns import GYRO, POS, QUAT, SIGNALS, VEL, beyond_limit
from .samples import stretches_where

Array = NDArray[np.float64]
Sensor = Literal["gyro", "acc"]
ResetOf = Literal["attitude", "yaw", "height", "position", "velocity"]
FilterKind = Literal["low-pass", "notch", "tracking notch"]
Level = Literal["emergency", "alert", "critical", "error", "warning", "notice", "info", "debug", ""]
"""Severity of a message, as in syslog; "": not logged."""
LEVELS: tuple[Level, ...] = get_args(Level)  # most severe first

SETPOINTS: tuple[tuple[str, ...], ...] = (POS, VEL, QUAT, GYRO)
"""Columns of the flight table that may have a setpoint."""
MOST_EVENTS = 1000
"""Largest number of modes, of failsafes and of times armed that are stored."""
MOST_MESSAGES = 2000  # largest number that is stored
MOST_PARAMETERS = 5000  # largest number that is stored
MOST_SAMPLES = 10_000
"""Largest number of samples of a setpoint: beyond the resolution of a screen, some megabytes of a
flight table."""
LONGEST = 300
"""Largest number of characters of a text that is stored."""


SETPOINT_S = 0.02
"""Time between two setpoints of a record."""


@dataclass(frozen=True, slots=True)
class Mode:
    """A flight mode; it lasts until the next one begins.

    Attributes:
        name: Name of the mode in the autopilot's documentation.
        start_s: Start, s from the start of the record.
    """

    name: str
    start_s: float


@dataclass(frozen=True, slots=True)
class Interval:
    """A state that lasted: armed motors, a failsafe, a phase of flight.

    Attributes:
        name: Name of the state.
        start_s: Start, s from the start of the record.
        end_s: End, s from the start of the record, or the end of the record where the state did not
            end.
    """

    name: str
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Message:
    """A text that the autopilot logged.

    Attributes:
        t_s: Time, s from the start of the record; negative before it.
        level: Severity of the message.
        text: Text as logged.
    """

    t_s: float
    level: Level
    text: str

    @property
    def grave(self) -> bool:
        """Whether it is a warning or worse."""
        return self.level in LEVELS[:5]


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter that differs from its default.

    Attributes:
        name: Name in the autopilot.
        value: Value at the end of the log, in the autopilot's unit.
        default: Default value: that of the configured airframe where it has one of its own, else
            that of the firmware.
    """

    name: str
    value: float
    default: float


@dataclass(frozen=True, slots=True)
class Filter:
    """A filter on board.

    Attributes:
        sensor: Sensor whose readings are filtered.
        kind: Type of the filter; a tracking notch follows the rotors from its frequency upwards.
        frequency_hz: Cut-off of a low-pass, centre of a notch.
        source: Parameter that states the filter.
    """

    sensor: Sensor
    kind: FilterKind
    frequency_hz: float
    source: str


@dataclass(frozen=True, slots=True, eq=False)
class Setpoint(ShortRepr):
    """Setpoint of the controllers, in the units and frames of the flight table.

    Attributes:
        columns: Columns of the flight table that should follow it, one of `SETPOINTS`.
        t_s: Times, s from the start of the record, strictly increasing, shape (n,).
        values: Setpoints, NED, FRD, SI, quaternions body to NED, shape (n, len(columns)); NaN where
            the autopilot leaves a number free.
        every: Decimation: one in this many logged samples is stored.
    """

    columns: tuple[str, ...]
    t_s: Array
    values: Array
    every: int = 1


@dataclass(frozen=True, slots=True)
class Reset:
    """A step that an estimator makes in its own output and reports.

    Attributes:
        of: State that was reset.
        t_s: Time, s.
    """

    of: ResetOf
    t_s: float


@dataclass(frozen=True, slots=True)
class Autopilot(ShortRepr):
    """Records of an autopilot on its flight; empty where its log has none.

    Attributes:
        modes: Flight modes in order of time.
        armed: Intervals in which the motors were armed.
        failsafes: Intervals in which a failsafe was active.
        messages: Messages in order of time.
        setpoints: Setpoints, at most one for each of `SETPOINTS`.
        parameters: Parameters that differ from their default, by name; none without defaults.
        filters: Filters on board, by frequency; the logged signals need not be filtered by them.
        resets: Resets of its estimator.
    """

    modes: tuple[Mode, ...] = ()
    armed: tuple[Interval, ...] = ()
    failsafes: tuple[Interval, ...] = ()
    messages: tuple[Message, ...] = ()
    setpoints: tuple[Setpoint, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    filters: tuple[Filter, ...] = ()
    resets: tuple[Reset, ...] = ()

    def mode_stretches(self, end_s: float) -> tuple[Interval, ...]:
        """Interval of each mode in a record that ends at this time, s."""
        ends = [*(m.start_s for m in self.modes[1:]), end_s]
        return tuple(Interval(m.name, m.start_s, e) for m, e in zip(self.modes, ends, strict=False))

    def setpoint(self, columns: Sequence[str]) -> Setpoint | None:
        """The setpoint of these columns; None where the log has none."""
        return next((s for s in self.setpoints if s.columns == tuple(columns)), None)


def as_text(raw: object) -> str:
    """A text of a log as it is stored: in one line, without half characters, of bounded length."""
    text = " ".join(str(raw).encode("utf-8", "replace").decode("utf-8").split())
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def modes_of(t_s: Array, names: Sequence[str], end_s: float) -> tuple[Mode, ...]:
    """Flight modes of a record from logged samples of the mode.

    Args:
        t_s: Times at which a mode was reported, s, ascending, shape (n,); the mode at time 0 may be
            older.
        names: Mode at each of these times.
        end_s: End of the record.
    """
    found: list[Mode] = []
    for t, name in zip(np.maximum(t_s, 0.0).tolist(), names, strict=True):
        if t > end_s or (found and found[-1].name == name):
            continue
        if found and found[-1].start_s == t:
            found.pop()
        if not found or found[-1].name != name:
            found.append(Mode(name, t))
    return tuple(found[:MOST_EVENTS])


def stretches_of(
    t_s: Array, on: NDArray[np.bool_], name: str, end_s: float
) -> tuple[Interval, ...]:
    """Intervals in which a state was active, from samples that are valid until the next.

    Args:
        t_s: Times, s, ascending, shape (n,).
        on: Whether the state was active, shape (n,).
        name: Name of the state.
        end_s: End of the record, where the last sample ends.
    """
    times = np.append(t_s, end_s)
    pairs = [(float(times[a]), float(times[b])) for a, b in stretches_where(on)]
    found = [(max(a, 0.0), min(b, end_s)) for a, b in pairs]
    return tuple(Interval(name, a, b) for a, b in found if b > a)[:MOST_EVENTS]


def setpoint_of(columns: tuple[str, ...], t_s: Array, values: Array) -> Setpoint | None:
    """A setpoint as it is stored; None without a finite sample.

    Args:
        columns: One of `SETPOINTS`.
        t_s: Times, s, strictly increasing, shape (n,).
        values: Setpoints, shape (n, len(columns)); infinite or beyond `columns.LIMITS`: free.
    """
    signal = next((s for s, names in SIGNALS.items() if names == columns), "")
    with np.errstate(invalid="ignore"):
        absurd = ~np.isfinite(values) | beyond_limit(signal, values)[:, None]
    values = np.where(absurd, np.nan, values)
    there = np.isfinite(values).any(axis=1) & (t_s >= 0.0)
    if not there.any():
        return None
    first, end = np.flatnonzero(there)[[0, -1]] + (0, 1)
    every = max(1, -(-int(end - first) // MOST_SAMPLES))
    part = slice(int(first), int(end), every)
    return Setpoint(columns, t_s[part], values[part], every)


def differing(values: dict[str, float], defaults: dict[str, float]) -> tuple[Parameter, ...]:
    """Parameters that differ from their default, by name; those without a default are omitted."""
    found = [
        Parameter(name[:LONGEST], values[name], default)
        for name, default in sorted(defaults.items())
        if name in values and values[name] != default
    ]
    return tuple(found[:MOST_PARAMETERS])


def check_autopilot(record: Autopilot) -> None:
    """Refuse records with valid types but invalid values, or more of them than any reader stores.

    Raises:
        ValueError: A value is invalid, or there are too many.
    """
    for what, several, most in (
        ("modes", record.modes, MOST_EVENTS),
        ("times armed", record.armed, MOST_EVENTS),
        ("failsafes", record.failsafes, MOST_EVENTS),
        ("messages", record.messages, MOST_MESSAGES),
        ("parameters", record.parameters, MOST_PARAMETERS),
        ("filters", record.filters, MOST_EVENTS),
        ("setpoints", record.setpoints, len(SETPOINTS)),
    ):
        if len(several) > most:
            raise ValueError(f"{len(several)} {what} of the autopilot")
    stretches = (*record.armed, *record.failsafes)
    texts = [m.name for m in record.modes] + [s.name for s in stretches]
    texts += [m.text for m in record.messages] + [p.name for p in record.parameters]
    texts += [f.source for f in record.filters]
    if any(len(text) > LONGEST for text in texts):
        raise ValueError("an endless text of the autopilot")
    starts = [m.start_s for m in record.modes]
    if starts != sorted(starts) or any(s.end_s < s.start_s for s in stretches):
        raise ValueError("modes or failsafes of the autopilot that run backward")
    if any(not f.frequency_hz > 0.0 for f in record.filters):
        raise ValueError("a filter of the autopilot without a frequency")
    for each in record.setpoints:
        _check_setpoint(each)
    if len({s.columns for s in record.setpoints}) < len(record.setpoints):
        raise ValueError("two setpoints of one signal")


def _check_setpoint(given: Setpoint) -> None:
    if given.columns not in SETPOINTS:
        raise ValueError("a setpoint of no signal that is known")
    if given.t_s.ndim != 1 or not 0 < len(given.t_s) <= MOST_SAMPLES or given.every < 1:
        raise ValueError("a setpoint without samples, or with too many")
    if given.values.shape != (len(given.t_s), len(given.columns)):
        raise ValueError("a setpoint whose numbers do not fit its times")
    if not np.isfinite(given.t_s).all() or not (np.diff(given.t_s) > 0.0).all():
        raise ValueError("a setpoint whose time does not increase")


# -- phases -------------------------------------------------------------------------------------
#
# Phases of a flight from signals of every autopilot: landed or not, and the velocity.

Span = tuple[str, float, float]
"""Name of a phase, its start and its end in s; the end belongs to the next span."""

_CLIMB_M_S = 0.3  # mean velocity of a step in takeoff and landing; made up
_CRUISE_M_S = 1.0  # speed over ground between hover and forward flight; made up
_STEP_S = 0.5  # length of a phase by motion


def label_phases(t_s: Array, spans: Sequence[Span]) -> NDArray[np.object_]:
    """Phase at each time, "" outside all spans; later spans override earlier ones.

    Args:
        t_s: Times, s, shape (n,).
        spans: Spans in the order in which they override each other.
    """
    phase = np.full(len(t_s), "", dtype=object)
    for name, start, end in spans:
        phase[(t_s >= start) & (t_s < end)] = name
    return phase


def ground_spans(t_s: Array, landed: NDArray[np.bool_]) -> list[Span]:
    """Spans on the ground, from a land detector.

    Args:
        t_s: Times of the detector's samples, s, shape (n,); its first state also applies before the
            first sample, its last state until the end.
        landed: State of the detector, shape (n,).
    """
    edges = np.append(t_s, np.inf)
    spans = [
        ("ground", float(a), float(b))
        for a, b, down in zip(edges[:-1], edges[1:], landed, strict=True)
        if down
    ]
    if spans and landed[0]:
        spans[0] = ("ground", -np.inf, spans[0][2])
    return spans


def motion_spans(t_s: Array, velocity_n: Array, ground: list[Span]) -> list[Span]:
    """Phases of half a second each from the motion of the vehicle.

    Faster than 1 m/s over ground is `forward`, else `hover`; climbing by more than 0.3 m/s next to
    a time on the ground is `takeoff`, sinking by more than that before one is `land`.

    Args:
        t_s: Times of the velocity, s, shape (n,).
        velocity_n: NED, m/s, shape (n, 3).
        ground: Spans from `ground_spans`; without any, takeoff and landing cannot be distinguished.

    Returns:
        The phases flown, then `ground`; `ground` alone where it or the velocity is missing.
    """
    if not ground or len(t_s) < 2:
        return ground
    edges = np.arange(t_s[0], t_s[-1] + _STEP_S, _STEP_S)
    here = [(t_s >= a) & (t_s < a + _STEP_S) for a in edges]
    means = np.array(
        [velocity_n[k].mean(axis=0) if np.any(k) else np.full(3, np.nan) for k in here]
    )
    horizontal, down = np.hypot(means[:, 0], means[:, 1]), means[:, 2]
    kind = np.full(len(edges), "hover", dtype=object)
    kind[horizontal > _CRUISE_M_S] = "forward"
    kind[~np.isfinite(down)] = ""
    on_ground = label_phases(edges, ground) == "ground"
    _spread(kind, on_ground, down < -_CLIMB_M_S, "takeoff", after=True)
    _spread(kind, on_ground, down > _CLIMB_M_S, "land", after=False)
    flown: list[Span] = [
        (str(k), float(a), float(a + _STEP_S)) for k, a in zip(kind, edges, strict=True) if k
    ]
    return [*flown, *ground]


def _spread(
    kind: NDArray[np.object_],
    on_ground: NDArray[np.bool_],
    moving: NDArray[np.bool_],
    name: str,
    after: bool,
) -> None:
    """Label the vertical motion that follows (`after`) or precedes a time on the ground."""
    order = range(len(kind)) if after else range(len(kind) - 1, -1, -1)
    state = "air"
    for i in order:
        if on_ground[i]:
            state = "ground"
        elif state == "ground":  # lift-off may begin below the threshold
            state = "moving" if moving[i] else "ground"
            kind[i] = name
        elif state == "moving":
            if moving[i]:
                kind[i] = name
            else:
                state = "air"


def setpoints_of_mission(setpoints: Array, step_s: float, gravity_m_s2: float) -> Autopilot:
    """Position, velocity and attitude setpoints of a mission, as an autopilot logs them: the
    attitude is that of the demanded acceleration and heading, without disturbances.

    Args:
        setpoints: Setpoints in the order of `twin.flight.closed_loop.SETPOINTS`, of which the first
            ten, one row per step, shape (n, 10) or wider.
        step_s: Time between two rows.
        gravity_m_s2: Acceleration of free fall.
    """
    rows = setpoints[:: round(SETPOINT_S / step_s)]
    t_s, yaw = np.asarray(SETPOINT_S * np.arange(len(rows))), rows[:, 9]
    north, east, lift = rows[:, 6], rows[:, 7], gravity_m_s2 - rows[:, 8]
    pitch = np.arctan2(-np.cos(yaw) * north - np.sin(yaw) * east, lift)
    right = np.cos(yaw) * east - np.sin(yaw) * north
    attitude = from_euler(np.arctan2(right * np.cos(pitch), lift), pitch, yaw)
    found = [(POS, rows[:, :3]), (VEL, rows[:, 3:6]), (QUAT, attitude.T)]
    made = (setpoint_of(columns, t_s, values) for columns, values in found)
    return Autopilot(setpoints=tuple(s for s in made if s is not None))
