"""What the autopilot itself says of a flight: its modes, what it was asked for, what it reported.

Every reader of an autopilot's logs fills it; a flight table in Parquet keeps it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..representation import short_repr
from .columns import GYRO, POS, QUAT, SIGNALS, VEL, beyond

Array = NDArray[np.float64]
Sensor = Literal["gyro", "acc"]
FilterKind = Literal["low-pass", "notch", "tracking notch"]
Level = Literal["emergency", "alert", "critical", "error", "warning", "notice", "info", "debug", ""]
"""Of a message, as syslog has them; "": the log does not tell."""
LEVELS: tuple[Level, ...] = get_args(Level)

SETPOINTS: tuple[tuple[str, ...], ...] = (POS, VEL, QUAT, GYRO)
"""Columns of the flight table of which a setpoint can be kept."""
MOST_EVENTS = 1000
"""Modes, failsafes and times armed that are kept, of each."""
MOST_MESSAGES = 2000
MOST_PARAMETERS = 5000
MOST_SAMPLES = 10_000
"""Of a setpoint: more than any screen shows; some megabytes of a flight table at most."""
LONGEST = 300
"""Characters of a text that are kept."""


@dataclass(frozen=True, slots=True)
class Mode:
    """A flight mode; it lasts until the next one begins.

    Attributes:
        name: As the autopilot's users call it.
        start_s: Begin, s from the start of the record.
    """

    name: str
    start_s: float


@dataclass(frozen=True, slots=True)
class Stretch:
    """Something that lasted: armed motors, a failsafe.

    Attributes:
        name: What.
        start_s: Begin, s from the start of the record.
        end_s: End, that of the record where nothing ended it.
    """

    name: str
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Message:
    """A text that the autopilot logged.

    Attributes:
        t_s: When, s from the start of the record; negative before it.
        level: How grave it is.
        text: As logged.
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
        name: Of the autopilot.
        value: As it is at the end of the log, in the autopilot's unit.
        default: What it is as delivered: of the airframe that is set up where that has one of its
            own, else of the firmware.
    """

    name: str
    value: float
    default: float


@dataclass(frozen=True, slots=True)
class Filter:
    """A filter on board.

    Attributes:
        sensor: Of which readings.
        kind: What it does; a tracking notch follows the rotors from its frequency upwards.
        frequency_hz: Cut-off of a low-pass, centre of a notch.
        source: The parameter that tells it.
    """

    sensor: Sensor
    kind: FilterKind
    frequency_hz: float
    source: str


@dataclass(frozen=True, slots=True, eq=False)
class Setpoint:
    """What the controllers were asked for, in the units and frames of the flight table.

    Attributes:
        columns: Columns of the flight table that should follow it, one of `SETPOINTS`.
        t_s: Times, s from the start of the record, strictly increasing, shape (n,).
        values: NED, FRD, SI, quaternions body to NED, shape (n, len(columns)); NaN where the
            autopilot leaves a number free.
        every: One in so many of the logged samples is kept.
    """

    columns: tuple[str, ...]
    t_s: Array
    values: Array
    every: int = 1

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class Autopilot:
    """What an autopilot says of its flight; empty where its log does not tell.

    Attributes:
        modes: Flight modes in order.
        armed: When the motors were armed.
        failsafes: When a failsafe was active.
        messages: In order of time.
        setpoints: At most one of each of `SETPOINTS`.
        parameters: Those that differ from their default, by name.
        defaults_told: Whether the log holds defaults; without them no parameter is listed.
        filters: On board, by frequency; the logged signals need not have gone through them.
    """

    modes: tuple[Mode, ...] = ()
    armed: tuple[Stretch, ...] = ()
    failsafes: tuple[Stretch, ...] = ()
    messages: tuple[Message, ...] = ()
    setpoints: tuple[Setpoint, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    defaults_told: bool = False
    filters: tuple[Filter, ...] = ()

    __repr__ = short_repr

    def mode_stretches(self, end_s: float) -> tuple[Stretch, ...]:
        """When each mode was on, in a record that ends then, s."""
        ends = [*(m.start_s for m in self.modes[1:]), end_s]
        return tuple(Stretch(m.name, m.start_s, e) for m, e in zip(self.modes, ends, strict=False))

    def setpoint(self, columns: Sequence[str]) -> Setpoint | None:
        """The setpoint of these columns; None where the log has none."""
        return next((s for s in self.setpoints if s.columns == tuple(columns)), None)


def as_text(raw: object) -> str:
    """A text of a log as it is kept: in one line, without half characters, not endless."""
    text = " ".join(str(raw).encode("utf-8", "replace").decode("utf-8").split())
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def modes_of(t_s: Array, names: Sequence[str], end_s: float) -> tuple[Mode, ...]:
    """Flight modes of a record from what was logged of them.

    Args:
        t_s: When a mode was told, s, ascending, shape (n,); what holds at 0 may be older.
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


def stretches_of(t_s: Array, on: NDArray[np.bool_], name: str, end_s: float) -> tuple[Stretch, ...]:
    """When something was on, from samples of it; each holds until the next.

    Args:
        t_s: Times, s, ascending, shape (n,).
        on: Shape (n,).
        name: What it is.
        end_s: End of the record, until when the last one holds.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(np.int8), [0]])))
    times = np.append(t_s, end_s)
    pairs = edges.reshape(-1, 2).tolist()
    found = [(max(float(times[a]), 0.0), min(float(times[b]), end_s)) for a, b in pairs]
    return tuple(Stretch(name, a, b) for a, b in found if b > a)[:MOST_EVENTS]


def setpoint_of(columns: tuple[str, ...], t_s: Array, values: Array) -> Setpoint | None:
    """A setpoint as it is kept; None where none of its samples tells anything.

    Args:
        columns: One of `SETPOINTS`.
        t_s: Times, s, strictly increasing, shape (n,).
        values: Shape (n, len(columns)); infinite or beyond what flies (`limits`): not asked for.
    """
    signal = next((s for s, names in SIGNALS.items() if names == columns), "")
    with np.errstate(invalid="ignore"):
        absurd = ~np.isfinite(values) | beyond(signal, values)[:, None]
    values = np.where(absurd, np.nan, values)
    told = np.isfinite(values).any(axis=1) & (t_s >= 0.0)
    if not told.any():
        return None
    first, end = np.flatnonzero(told)[[0, -1]] + (0, 1)
    every = max(1, -(-int(end - first) // MOST_SAMPLES))
    kept = slice(int(first), int(end), every)
    return Setpoint(columns, t_s[kept], values[kept], every)


def differing(values: dict[str, float], defaults: dict[str, float]) -> tuple[Parameter, ...]:
    """Parameters that differ from their default, by name; those without one are left out."""
    found = [
        Parameter(name[:LONGEST], values[name], default)
        for name, default in sorted(defaults.items())
        if name in values and values[name] != default
    ]
    return tuple(found[:MOST_PARAMETERS])


def check_autopilot(told: Autopilot) -> None:
    """Refuse what has the right types and no meaning, or more of it than any reader keeps.

    Raises:
        ValueError: It is such.
    """
    for what, several, most in (
        ("modes", told.modes, MOST_EVENTS),
        ("times armed", told.armed, MOST_EVENTS),
        ("failsafes", told.failsafes, MOST_EVENTS),
        ("messages", told.messages, MOST_MESSAGES),
        ("parameters", told.parameters, MOST_PARAMETERS),
        ("filters", told.filters, MOST_EVENTS),
        ("setpoints", told.setpoints, len(SETPOINTS)),
    ):
        if len(several) > most:
            raise ValueError(f"{len(several)} {what} of the autopilot")
    stretches = (*told.armed, *told.failsafes)
    texts = [m.name for m in told.modes] + [s.name for s in stretches]
    texts += [m.text for m in told.messages] + [p.name for p in told.parameters]
    texts += [f.source for f in told.filters]
    if any(len(text) > LONGEST for text in texts):
        raise ValueError("an endless text of the autopilot")
    starts = [m.start_s for m in told.modes]
    if starts != sorted(starts) or any(s.end_s < s.start_s for s in stretches):
        raise ValueError("modes or failsafes of the autopilot that run backward")
    if any(not f.frequency_hz > 0.0 for f in told.filters):
        raise ValueError("a filter of the autopilot without a frequency")
    for each in told.setpoints:
        _check_setpoint(each)
    if len({s.columns for s in told.setpoints}) < len(told.setpoints):
        raise ValueError("two setpoints of one signal")


def _check_setpoint(told: Setpoint) -> None:
    if told.columns not in SETPOINTS:
        raise ValueError("a setpoint of no signal that is known")
    if told.t_s.ndim != 1 or not 0 < len(told.t_s) <= MOST_SAMPLES or told.every < 1:
        raise ValueError("a setpoint without samples, or with too many")
    if told.values.shape != (len(told.t_s), len(told.columns)):
        raise ValueError("a setpoint whose numbers do not fit its times")
    if not np.isfinite(told.t_s).all() or not (np.diff(told.t_s) > 0.0).all():
        raise ValueError("a setpoint whose time does not increase")


# -- phases -------------------------------------------------------------------------------------
#
# Phases of a flight from what every autopilot logs: landed or not, and the velocity.

Span = tuple[str, float, float]
"""Name of a phase, its start and its end in s; the end belongs to the next span."""

_CLIMB_M_S = 0.3
_CRUISE_M_S = 1.0
_STEP_S = 0.5


def label_phases(t_s: Array, spans: Sequence[Span]) -> NDArray[np.object_]:
    """Phase of each time, "" outside all spans; later spans win.

    Args:
        t_s: Times, s, shape (n,).
        spans: In the order in which they are laid over each other.
    """
    phase = np.full(len(t_s), "", dtype=object)
    for name, start, end in spans:
        phase[(t_s >= start) & (t_s < end)] = name
    return phase


def ground_spans(t_s: Array, landed: NDArray[np.bool_]) -> list[Span]:
    """Spans on the ground, from a land detector.

    Args:
        t_s: When it spoke, s, shape (n,); what it says first also holds before, and what it says
            last from then on.
        landed: What it said, shape (n,).
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
    """Phases of half a second each from how the vehicle moves.

    Faster than 1 m/s over ground is `forward`, else it is `hover`; climbing by more than 0.3 m/s
    next to a time on the ground is `takeoff`, sinking so before one is `land`.

    Args:
        t_s: Times of the velocity, s, shape (n,).
        velocity_n: NED, m/s, shape (n, 3).
        ground: From `ground_spans`; without any, nothing tells takeoff from landing.

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
    """Name the vertical motion next to a time on the ground; `after` it, or before it."""
    order = range(len(kind)) if after else range(len(kind) - 1, -1, -1)
    state = "air"
    for i in order:
        if on_ground[i]:
            state = "ground"
        elif state == "ground":  # lift-off may begin slower than the threshold
            state = "moving" if moving[i] else "ground"
            kind[i] = name
        elif state == "moving":
            if moving[i]:
                kind[i] = name
            else:
                state = "air"
