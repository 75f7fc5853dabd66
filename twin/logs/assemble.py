"""Signals with different time stamps combined into one flight table: rows, attitude of unit
norm."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..errors import LogError
from .airframe import Airframe
from .autopilot import Autopilot, Reset, Span, label_phases, motion_spans
from .columns import MOTION, QUAT, VEL, beyond_limit, beyond_message, in_order, motor_columns
from .flight import Array, FindingCollector, Flight, Site
from .motors import MotorCommands
from .stamps import EARLIER, filter_delay_us, longest_stretch, mean_rate_hz

_SHOWN = 8
"""Largest number of times that a finding lists."""


# -- attitude -----------------------------------------------------------------------------------
#
# Logged attitudes: quaternions normalised, Euler angles converted to quaternions.

NORM_DOUBT = 1e-3
"""Distance of a norm from 1 beyond which the normalisation of a quaternion is reported."""
_LEAST_NORM, _MOST_NORM = 0.5, 2.0  # norm of a quaternion; beyond is damage


def unit_quaternions(log: FindingCollector, q: Array) -> tuple[NDArray[np.bool_], Array]:
    """Logged quaternions normalised, without those of norm far from 1; findings count both.

    Args:
        log: Log with the quaternions; collects the findings.
        q: Logged quaternions, shape (n, 4).

    Returns:
        Mask of the quaternions in use, shape (n,), and these quaternions, shape (m, 4).
    """
    with np.errstate(invalid="ignore", over="ignore"):  # damaged logs contain any number
        norm = np.linalg.norm(q, axis=1)
    usable = np.isfinite(norm) & (norm > _LEAST_NORM) & (norm < _MOST_NORM)
    off = usable & (np.abs(norm - 1.0) > NORM_DOUBT)
    log.note("error", "q", "samples left out, the quaternion is far from unit norm", ~usable)
    log.note("warning", "q", f"quaternions off unit norm by over {NORM_DOUBT:g}, normalised", off)
    return usable, q[usable] / norm[usable, None]


# -- rows ---------------------------------------------------------------------------------------
#
# Signals with their own clocks put together into one flight table.


def phases_of_table(table: pd.DataFrame, ground: list[Span]) -> list[Span]:
    """Phases as in `motion_spans`, by the velocity of a table; `ground` alone where it has none."""
    if not set(VEL) <= set(table):
        return ground
    known = table[["time", *VEL]].dropna().to_numpy(dtype=np.float64)
    return motion_spans(known[:, 0], known[:, 1:], ground)


@dataclass(slots=True)
class FlightBuilder:
    """The flight of a log while it is read: signals, each with its own time stamps, and facts.

    Attributes:
        log: Collects the findings.
        path: Path of the log file.
        facts: Facts of the log, printable key by key.
        begin: Event at time 0.
        signals: Columns that are sampled together, their times, us, shape (n,), and values.
        t_us: Times of the rows of the table, shape (n,), once they are known.
        filter_delays_s: As of `Flight`.
    """

    log: FindingCollector
    path: Path
    facts: dict[str, str] = field(default_factory=dict)
    begin: str = "the log began"
    signals: list[tuple[tuple[str, ...], NDArray[np.int64], Array]] = field(default_factory=list)
    t_us: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    filter_delays_s: dict[str, float] = field(default_factory=dict)

    def add(
        self, where: str, names: tuple[str, ...], t_us: NDArray[np.int64], values: Array
    ) -> None:
        """Add a signal; findings count the samples that it loses.

        Args:
            where: Name of the signal in findings, and in `columns.LIMITS`.
            names: Columns of the signal.
            t_us: Strictly increasing times, us, shape (n,).
            values: Samples, shape (n, len(names)).
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
        """Add logged quaternions FRD to NED, shape (n, 4), as in `unit_quaternions`."""
        usable, unit = unit_quaternions(self.log, q)
        self.add("q", QUAT, t_us[usable], unit)

    def add_commands(self, commands: MotorCommands | None) -> None:
        """Add commands of all motors and their facts, where there are any."""
        if commands is not None:
            columns = motor_columns("cmd", commands.cmd.shape[1])
            self.add("cmd", columns, commands.t_us, commands.cmd)
            self.facts |= commands.facts

    def filter_delay_us(self, where: str, cutoff_hz: float, source: str = "") -> int:
        """Delay of the low-pass applied to a signal before logging, us; a finding reports it.

        Args:
            where: Name of the signal, and of its columns.
            cutoff_hz: Cut-off of the second-order Butterworth low-pass.
            source: Parameter that states the cut-off.
        """
        delay_us = filter_delay_us(cutoff_hz)
        self.filter_delays_s[where] = delay_us * 1e-6
        self.log.note(
            "info",
            where,
            f"low-passed at {cutoff_hz:.0f} Hz{source and f' ({source})'} before it was logged; "
            f"its time is {delay_us / 1e3:.1f} ms {EARLIER}, the delay of that filter",
        )
        return delay_us

    def lay_out(self, advice: str, doubt: str = "") -> pd.DataFrame:
        """The table of all signals on the longest stretch without a pause of a minute, without
        `phase`; NaN where a signal has no sample.

        Args:
            advice: Sentence on the remedy where no signal of the motion is available.
            doubt: Possible cause of dropped rows, starting with a colon.

        Raises:
            LogError: No signal of the motion is available.
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
        """The flight of a table as from `lay_out`, its phases, and the rates of its signals as
        facts; other arguments as in `Flight`."""
        t_s = table["time"].to_numpy()
        table["phase"] = pd.Series(label_phases(t_s, phases), dtype=object)
        length_s = (self.t_us[-1] - self.t_us[0]) * 1e-6
        facts = self.facts | {"duration": f"{length_s:.2f} s"}
        for names, t, _ in self.signals:
            if len(t) > 1:
                group = names[0].rsplit("_", 1)[0] if len(names) > 1 else names[0]
                facts[f"rate {group}"] = f"{mean_rate_hz(t):.1f} Hz"
        if autopilot is not None:
            _note_resets(self.log, autopilot.resets)
        return Flight(
            self.path.stem,
            table,
            self.path,
            facts=facts,
            findings=tuple(self.log.findings),
            site=site,
            airframe=airframe,
            autopilot=autopilot,
            filter_delays_s=self.filter_delays_s,
        )


def _note_resets(log: FindingCollector, resets: Sequence[Reset]) -> None:
    """Findings on steps that an estimator made in its own output."""
    for of in dict.fromkeys(r.of for r in resets):
        times = sorted({r.t_s for r in resets if r.of == of})
        at = ", ".join(f"{t:.2f}" for t in times[:_SHOWN])
        where = "q" if of in ("attitude", "yaw") else "pos"
        log.note(
            "warning",
            where,
            f"the estimator reset its {of} at {at} s: expect steps there",
            len(times),
        )
