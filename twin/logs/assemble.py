"""Signals with their own clocks put together into one flight table: stamps in order, attitude of
unit norm, rows.
"""

import math
from abc import abstractmethod
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..errors import LogError
from .airframe import Airframe
from .autopilot import Autopilot, Span, label_phases, motion_spans
from .columns import MOTION, QUAT, VEL, beyond_limit, beyond_message, in_order, motor_columns
from .flight import Array, FindingCollector, Flight, Severity, Site

# -- time stamps --------------------------------------------------------------------------------
#
# Time stamps put in order: which samples of a series can stay.

_JUMP_US = 60_000_000  # between two groups of samples that are not of one flight
_FEW = 0.02  # share of samples below which such a group is damage
_PAUSE_S = 0.2  # shortest pause of a steady signal
_PAUSE_INTERVALS = 2.2  # the same in median intervals
_SHOWN = 8  # times that a finding lists
_LATEST = 0.5  # share of the record after which a signal begins late


def filter_delay_us(cutoff_hz: float) -> int:
    """Delay of a second-order Butterworth low-pass for what is slow, sqrt(2) / (2 pi f), us."""
    return round(1e6 * math.sqrt(2.0) / (2.0 * math.pi * cutoff_hz))


def mean_rate_hz(t_us: NDArray[np.int64]) -> float:
    """Mean rate between the first and the last of increasing times, us; 0 for fewer than two."""
    if len(t_us) < 2:
        return 0.0
    return float((len(t_us) - 1) / ((t_us[-1] - t_us[0]) * 1e-6))


class Timed:
    """Samples with times.

    Attributes:
        t_us: Time of each, us, shape (n,).
    """

    __slots__ = ()
    t_us: NDArray[np.int64]

    @property
    def t_s(self) -> NDArray[np.float64]:
        """Times, s, shape (n,)."""
        return np.asarray(self.t_us * 1e-6, dtype=np.float64)

    @property
    def rate_hz(self) -> float:
        """Mean rate between the first and the last, 0 for fewer than two."""
        return mean_rate_hz(self.t_us)

    @abstractmethod
    def has(self, *fields: str) -> bool:
        """Whether every field is there and holds numbers."""


AnyTopic = TypeVar("AnyTopic", bound=Timed)


def with_fields(
    log: FindingCollector, name: str, topic: AnyTopic | None, needs: Sequence[str]
) -> AnyTopic | None:
    """A topic with all of some fields; else None, and a finding."""
    lacks = [] if topic is None else [f for f in needs if not topic.has(f)]
    if not lacks:
        return topic
    log.note("warning", name, f"has no field {', '.join(lacks)}; it is not used")
    return None


@dataclass(frozen=True, slots=True)
class Pauses:
    """Intervals in which samples are missing.

    Attributes:
        count: How many.
        longest_s: The longest of them.
        at_s: When that begins.
    """

    count: int
    longest_s: float
    at_s: float

    @property
    def message(self) -> str:
        """The text of a finding."""
        return f"gaps, the longest of {self.longest_s:.3g} s after {self.at_s:.2f} s"


def pauses(t_us: NDArray[np.int64]) -> Pauses | None:
    """Where a signal of a steady rate pauses: 0.2 s and 2.2 of its median intervals; None: nowhere.

    Args:
        t_us: Increasing times, us, shape (n,).
    """
    steps_s = np.diff(t_us) * 1e-6
    if len(steps_s) == 0:
        return None
    long = steps_s > _longest_s(steps_s)
    if not long.any():
        return None
    worst = int(np.argmax(steps_s))
    return Pauses(int(long.sum()), float(steps_s[worst]), float(t_us[worst]) * 1e-6)


def missing_ends(t_us: NDArray[np.int64], begin_us: int, end_us: int) -> list[str]:
    """Texts of findings where a signal of a steady rate is not there at the ends of a record.

    It may stop before the end for as long as in `pauses`: of six recorded PX4 logs all topics end
    within 1.5 intervals. It may begin in the first half: their estimates take up to 22 % of it.

    Args:
        t_us: Increasing times, us, shape (n,).
        begin_us: When the record begins, us.
        end_us: When it ends.

    Returns:
        None of one sample or none.
    """
    if len(t_us) < 2:
        return []
    late_s, left_s = (int(t_us[0]) - begin_us) * 1e-6, (end_us - int(t_us[-1])) * 1e-6
    found = []
    if late_s > _LATEST * (end_us - begin_us) * 1e-6:
        found.append(f"begins at {t_us[0] * 1e-6:.2f} s, {late_s:.3g} s after the record does")
    if left_s > _longest_s(np.diff(t_us) * 1e-6):
        found.append(f"ends at {t_us[-1] * 1e-6:.2f} s, {left_s:.3g} s before the record does")
    return found


def _longest_s(steps_s: NDArray[np.float64]) -> float:
    """Beyond which an interval of a steady signal is a pause, s."""
    return max(_PAUSE_S, _PAUSE_INTERVALS * float(np.median(steps_s)))


def monotonic(t: NDArray[np.int64]) -> tuple[NDArray[np.bool_], int, int, int]:
    """Choose samples so that time strictly increases, dropping as few as possible.

    Args:
        t: Time stamps, us, shape (n,), in the order of the file.

    Returns:
        Mask of the samples to keep, shape (n,), then how many are dropped because time runs
        backward, because it repeats, and because they lie over a minute from the rest.
    """
    keep = np.ones(len(t), dtype=np.bool_)
    far = far_off(t)
    keep[far] = False
    left = np.flatnonzero(keep)
    steps = np.diff(t[left])
    if np.all(steps > 0):
        return keep, 0, 0, int(far.sum())
    rising = left[_longest_rise(t[left])]
    keep[:] = False
    keep[rising] = True
    repeated = int(np.count_nonzero(np.isin(t[left], t[rising]) & ~keep[left]))
    dropped = len(left) - len(rising)
    return keep, dropped - repeated, repeated, int(far.sum())


def far_off(t: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Samples of a small group (under 2 %) that is over a minute from every other sample."""
    order = np.argsort(t, kind="stable")
    group = np.concatenate([[0], np.cumsum(np.diff(t[order]) > _JUMP_US)])
    if group[-1] == 0:
        return np.zeros(len(t), dtype=np.bool_)
    sizes = np.bincount(group)
    small = (sizes < _FEW * len(t)) & (sizes < sizes.max())
    far = np.zeros(len(t), dtype=np.bool_)
    far[order] = small[group]
    return far


def longest_stretch(t: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Times of the largest group that has no pause of over a minute.

    Args:
        t: Increasing times, us, shape (n,).
    """
    group = np.concatenate([[0], np.cumsum(np.diff(t) > _JUMP_US)])
    return np.asarray(group == np.argmax(np.bincount(group)))


def _longest_rise(t: NDArray[np.int64]) -> NDArray[np.int64]:
    """Indices of a longest strictly increasing subsequence (patience sorting, O(n log n))."""
    tails: list[int] = []
    tail_at: list[int] = []
    before = np.full(len(t), -1, dtype=np.int64)
    for i, value in enumerate(t.tolist()):
        k = bisect_left(tails, value)
        if k == len(tails):
            tails.append(value)
            tail_at.append(i)
        else:
            tails[k] = value
            tail_at[k] = i
        before[i] = tail_at[k - 1] if k else -1
    chain = []
    i = tail_at[-1] if tail_at else -1
    while i >= 0:
        chain.append(i)
        i = int(before[i])
    return np.array(chain[::-1], dtype=np.int64)


def monotonic_samples(
    log: FindingCollector,
    where: str,
    t_us: NDArray[np.int64],
    what: str,
    severity: Severity = "error",
) -> NDArray[np.bool_]:
    """Samples to keep so that time strictly increases, as of `monotonic`; findings count the rest.

    Args:
        log: Takes the findings.
        where: What the signal is called in them.
        t_us: Time stamps, us, shape (n,), in the order of the file.
        what: What a sample is called in the log.
        severity: Of the findings.

    Returns:
        Shape (n,).
    """
    keep, backward, repeated, jumped = monotonic(t_us)
    for count, why in (
        (backward, "whose time runs backward"),
        (repeated, "whose time repeats"),
        (jumped, "that lie more than a minute from the rest"),
    ):
        log.note(severity, where, f"{what} dropped {why}", count)
    return keep


def note_cut(log: FindingCollector, tail: int) -> None:
    """The finding on a log that ends inside a message, of so many bytes; none of 0."""
    message = f"cut short: it ends inside a message; the last {tail} bytes are not used"
    log.note("error", "log", message, tail)


def note_resets(log: FindingCollector, where: str, what: str, times_s: Sequence[float]) -> None:
    """The finding on steps that an estimator put into its own output, at some times."""
    at = ", ".join(f"{t:.2f}" for t in sorted(set(times_s))[:_SHOWN])
    message = f"the estimator reset {what} at {at} s: expect steps there"
    log.note("warning", where, message, len(times_s))


# -- stamps and the order in the file -----------------------------------------------------------
#
# Time stamps of a ULog held against the order of its messages in the file.
#
# The logger writes what it receives as it comes, so that the stamps of neighbours are of about the
# same moment whatever their topic.

_NEIGHBOURS = 101
"""Samples of whose stamps the median is taken."""
_MANY = 0.2
"""Share of all samples from which on a topic would outvote the others."""
_FAR_US = 10_000_000
"""A stamp farther than that from its neighbours is of another clock."""
APART_S = 0.15
"""Median of a whole topic; sound PX4 logs: under 80 ms for GPS, 10 ms for what is fast."""


def stamp_offsets(
    places: Sequence[NDArray[np.int64]], stamps_us: Iterable[NDArray[np.int64]]
) -> list[NDArray[np.int64]]:
    """How far each stamp is from the median of its neighbours in the file, us.

    Args:
        places: Per topic, where its samples stand in the file, each of shape (n,).
        stamps_us: Their stamps, each of the same shape.

    Returns:
        Per topic, shape (n,); positive: stamped later than its neighbours in the file.
    """
    if not any(map(len, places)):
        return [np.zeros(0, dtype=np.int64) for _ in places]
    stamps = list(stamps_us)
    place, stamp = np.concatenate(places), np.concatenate(stamps)
    owner = np.repeat(np.arange(len(places)), [len(p) for p in places])
    order = np.argsort(place, kind="stable")
    place, stamp, owner = place[order], stamp[order], owner[order]
    every = _clock(stamp)
    out = []
    for k, (own_place, own_stamp) in enumerate(zip(places, stamps, strict=True)):
        others = owner != k
        if len(own_place) > _MANY * len(place) and others.any():  # it would outvote the others
            clock = np.interp(own_place, place[others], _clock(stamp[others]))
        else:
            clock = np.interp(own_place, place, every)
        out.append(own_stamp - np.round(clock).astype(np.int64))
    return out


def stray_samples(
    log: FindingCollector, names: Sequence[str], off_us: Sequence[NDArray[np.int64]], what: str
) -> Iterator[NDArray[np.bool_]]:
    """Samples stamped far from their neighbours in the file; findings count them and doubt topics.

    Args:
        log: Takes the findings.
        names: Of the topics.
        off_us: Per topic, as of `stamp_offsets`.
        what: What a sample is called in the log.

    Returns:
        Per topic, shape (n,): those to be dropped.
    """
    for name, off in zip(names, off_us, strict=True):
        far = np.abs(off) > _FAR_US
        middle_s = float(np.median(off)) * 1e-6
        message = (
            f"{what} dropped, stamped over {_FAR_US * 1e-6:.0f} s from what stands next to "
            f"them in the file (median {middle_s:+.3g} s): another clock, or another unit?"
        )
        log.note("error", name, message, far)
        if abs(middle_s) > APART_S and not far.all():
            message = f"stamped {middle_s:+.2f} s from what stands next to it in the file"
            log.note("error", name, f"{message}: another clock?")
        yield far


def _clock(stamp_us: NDArray[np.int64]) -> NDArray[np.float64]:
    """Median of each stamp and its neighbours, us, the first and the last one repeated."""
    half = _NEIGHBOURS // 2
    repeated = pd.Series(np.pad(stamp_us, half, mode="edge"))
    median = repeated.rolling(_NEIGHBOURS, center=True).median().to_numpy(dtype=np.float64)
    return np.asarray(median[half:-half])


# -- attitude -----------------------------------------------------------------------------------
#
# Attitude as logs have it: quaternions of unit norm, Euler angles turned into them.

NORM_DOUBT = 1e-3
"""Distance of a norm from 1 beyond which that a quaternion was normalised is said."""
_LEAST_NORM, _MOST_NORM = 0.5, 2.0  # of a quaternion; beyond is damage


def unit_quaternions(log: FindingCollector, q: Array) -> tuple[NDArray[np.bool_], Array]:
    """Logged quaternions normalised, those left out whose norm is far from 1; findings count both.

    Args:
        log: Which has them; gets the findings.
        q: Shape (n, 4).

    Returns:
        Which are used, shape (n,), and these, shape (m, 4).
    """
    with np.errstate(invalid="ignore", over="ignore"):  # damaged logs hold any number
        norm = np.linalg.norm(q, axis=1)
    usable = np.isfinite(norm) & (norm > _LEAST_NORM) & (norm < _MOST_NORM)
    off = usable & (np.abs(norm - 1.0) > NORM_DOUBT)
    log.note("error", "q", "samples left out, the quaternion is far from unit norm", ~usable)
    log.note("warning", "q", f"quaternions off unit norm by over {NORM_DOUBT:g}, normalised", off)
    return usable, q[usable] / norm[usable, None]


# -- motors ----------------------------------------------------------------------
#
# Which physical output drives which motor, in which unit and range, and what in a log says so.
#
# Every reader of an autopilot's log fills one `MotorOutput` per motor; commands are made of nothing
# else. Where the log does not say it, `source` names what was missing and the reader adds a
# finding.


_STOPPED = 0.01
"""Command above which a motor runs."""
_ABSURD = 3.0
"""Size of a command that is damaged; a pulse width of 0, of motors that are off, is -1 or -2."""
_IDLE, _WORKING = 0.05, 0.2
"""Mean command below which motors idle, and above which they draw a current."""
_STEADY_A = 1e-4
"""Standard deviation of a current that never changes."""


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


def describe_outputs(outputs: Sequence[MotorOutput]) -> str:
    """All outputs in a line, in the order of the motors, with what says so."""
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
        cmd: Shape (n, motors).
        facts: What to print about them.
    """

    t_us: NDArray[np.int64]
    cmd: Array
    facts: dict[str, str] = field(default_factory=dict)

    @property
    def running(self) -> NDArray[np.bool_]:
        """Whether any motor gets more than a hundredth, shape (n,)."""
        return np.asarray((self.cmd > _STOPPED).any(axis=1))

    def note_slow(self, log: FindingCollector, enough_hz: float) -> float:
        """Their rate, Hz; a finding where it is below what is enough."""
        rate_hz = mean_rate_hz(self.t_us)
        if rate_hz < enough_hz:
            message = f"motor commands at only {rate_hz:.0f} Hz; each is held until the next"
            log.note("warning", "cmd", message)
        return rate_hz

    def clipped(self, log: FindingCollector, source: str) -> "MotorCommands":
        """The same within 0..1; findings count what lay outside.

        Args:
            log: Takes the findings.
            source: Topic or message that they are from.
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
        commands: Clipped; None: not known.
        source: Topic or message.
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


# -- rows ---------------------------------------------------------------------------------------
#
# Signals with their own clocks put together into one flight table.


def phases_of_table(table: pd.DataFrame, ground: list[Span]) -> list[Span]:
    """Phases as of `motion_spans`, by the velocity of a table; `ground` alone where it has none."""
    if not set(VEL) <= set(table):
        return ground
    known = table[["time", *VEL]].dropna().to_numpy(dtype=np.float64)
    return motion_spans(known[:, 0], known[:, 1:], ground)


@dataclass(slots=True)
class FlightBuilder:
    """The flight of a log while it is read: signals, each with its own time stamps, and facts.

    Attributes:
        log: Takes the findings.
        path: File.
        facts: What the log says about itself, printable key by key.
        begin: What happens at time 0.
        signals: Columns that are sampled together, their times, us, shape (n,), and values.
        t_us: Times of the rows of the table, shape (n,), once it is laid out.
    """

    log: FindingCollector
    path: Path
    facts: dict[str, str] = field(default_factory=dict)
    begin: str = "the log began"
    signals: list[tuple[tuple[str, ...], NDArray[np.int64], Array]] = field(default_factory=list)
    t_us: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def add(
        self, where: str, names: tuple[str, ...], t_us: NDArray[np.int64], values: Array
    ) -> None:
        """Add a signal; findings count the samples that it loses.

        Args:
            where: What the signal is called in findings, and in `columns.LIMITS`.
            names: Its columns.
            t_us: Strictly increasing times, us, shape (n,).
            values: Shape (n, len(names)).
        """
        absurd = beyond_limit(where, values)
        if absurd.any():
            self.log.note("error", where, beyond_message(where, values[absurd]), absurd)
        early = (t_us < 0) & ~absurd
        broken = ~np.isfinite(values).all(axis=1) & ~early & ~absurd
        good = ~(early | broken | absurd)
        if good.any():
            self.signals.append((names, t_us[good], values[good]))
        self.log.note("info", where, f"samples left out, taken before {self.begin}", early)
        self.log.note("error", where, "samples left out, a value is NaN or infinite", broken)

    def add_attitude(self, t_us: NDArray[np.int64], q: Array) -> None:
        """Add logged quaternions FRD to NED, shape (n, 4), as of `unit_quaternions`."""
        usable, unit = unit_quaternions(self.log, q)
        self.add("q", QUAT, t_us[usable], unit)

    def add_commands(self, commands: MotorCommands | None) -> None:
        """Add commands of all motors and what is to be printed about them, where there are any."""
        if commands is not None:
            columns = motor_columns("cmd", commands.cmd.shape[1])
            self.add("cmd", columns, commands.t_us, commands.cmd)
            self.facts |= commands.facts

    def filter_delay_us(self, where: str, cutoff_hz: float, source: str = "") -> int:
        """Delay of the low-pass that a signal went through before it was logged, us; a finding.

        Args:
            where: Name of the signal.
            cutoff_hz: Of a second-order Butterworth low-pass.
            source: Parameter that says so.
        """
        delay_us = filter_delay_us(cutoff_hz)
        self.log.note(
            "info",
            where,
            f"low-passed at {cutoff_hz:.0f} Hz{source and f' ({source})'} before it was logged; "
            f"its time is {delay_us / 1e3:.1f} ms before the time stamp of the log, the delay of "
            "that filter",
        )
        return delay_us

    def lay_out(self, advice: str, doubt: str = "") -> pd.DataFrame:
        """The table of all signals on the longest stretch without a pause of a minute, without
        `phase`; NaN where a signal has no sample.

        Args:
            advice: What to do where nothing of the motion is there, a sentence.
            doubt: What may be the cause where rows are left out, begun by a colon.

        Raises:
            LogError: Nothing of the motion is there.
        """
        every = [t for _, t, _ in self.signals]
        t_us = np.unique(np.concatenate(every)) if every else np.zeros(0, dtype=np.int64)
        inside = longest_stretch(t_us) if every else np.zeros(0, dtype=np.bool_)
        message = "rows dropped outside the longest stretch without a pause of a minute"
        self.log.note("error", "time", message + doubt, ~inside)
        t_us = self.t_us = t_us[inside]
        columns: dict[str, Array] = {"time": np.asarray(t_us * 1e-6, dtype=np.float64)}
        for names, t, values in self.signals:
            row = np.minimum(np.searchsorted(t_us, t), len(t_us) - 1)
            here = t_us[row] == t
            for k, name in enumerate(names):
                column = columns.setdefault(name, np.full(len(t_us), np.nan))
                column[row[here]] = values[here, k]
        if not columns.keys() & MOTION:
            raise LogError(
                f"{self.path.name}: the log holds no sample of acceleration, body rates, attitude, "
                f"position or velocity within {len(t_us)} rows. {advice}"
            )
        return pd.DataFrame({name: columns[name] for name in in_order(columns)})

    def flight(
        self,
        table: pd.DataFrame,
        phases: Sequence[Span] = (),
        *,
        site: Site | None = None,
        airframe: Airframe | None = None,
        autopilot: Autopilot | None = None,
    ) -> Flight:
        """The flight of a table as of `lay_out`, its phases, and the rates of its signals as facts;
        other arguments as of `Flight`."""
        t_s = table["time"].to_numpy()
        table["phase"] = pd.Series(label_phases(t_s, phases), dtype=object)
        length_s = (self.t_us[-1] - self.t_us[0]) * 1e-6
        facts = self.facts | {"duration": f"{length_s:.2f} s"}
        for names, t, _ in self.signals:
            if len(t) > 1:
                group = names[0].rsplit("_", 1)[0] if len(names) > 1 else names[0]
                facts[f"rate {group}"] = f"{mean_rate_hz(t):.1f} Hz"
        findings = tuple(self.log.findings)
        path = self.path
        return Flight(path.stem, table, findings, facts, path, site, airframe, autopilot)
