"""Signals with their own clocks put together into one flight table."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..errors import LogError
from .clock import longest_stretch
from .columns import MOTION, in_order
from .flight import Array, Noted
from .limits import beyond, told


@dataclass(slots=True)
class Rows:
    """Collects signals, each with its own time stamps, and lays them out row by row."""

    signals: list[tuple[tuple[str, ...], NDArray[np.int64], Array]] = field(default_factory=list)

    def add(
        self, names: tuple[str, ...], t_us: NDArray[np.int64], values: Array
    ) -> tuple[int, int]:
        """Add columns that are sampled together.

        Args:
            names: Column names.
            t_us: Strictly increasing times, us, shape (n,).
            values: Shape (n, len(names)).

        Returns:
            Number of samples left out because they are older than the record, and because one
            of their values is not finite.
        """
        early = t_us < 0
        broken = ~np.isfinite(values).all(axis=1) & ~early
        good = ~early & ~broken
        if good.any():
            self.signals.append((names, t_us[good], values[good]))
        return int(early.sum()), int(broken.sum())

    def times_us(self) -> tuple[NDArray[np.int64], int]:
        """Times of all rows of the longest stretch without a pause of a minute, strictly
        increasing, and how many lie outside it."""
        if not self.signals:
            return np.zeros(0, dtype=np.int64), 0
        t_us = np.unique(np.concatenate([t for _, t, _ in self.signals]))
        kept = longest_stretch(t_us)
        return t_us[kept], int(np.count_nonzero(~kept))

    def table(self, t_us: NDArray[np.int64]) -> pd.DataFrame:
        """Flight table on these times, NaN where a signal has no sample; no `phase` yet."""
        columns: dict[str, Array] = {"time": np.asarray(t_us * 1e-6, dtype=np.float64)}
        for names, t, values in self.signals:
            row = np.minimum(np.searchsorted(t_us, t), len(t_us) - 1)
            here = t_us[row] == t
            for k, name in enumerate(names):
                column = columns.setdefault(name, np.full(len(t_us), np.nan))
                column[row[here]] = values[here, k]
        return pd.DataFrame({name: columns[name] for name in in_order(columns)})

    def coverage(self, t_us: NDArray[np.int64]) -> dict[str, str]:
        """Facts: duration of the rows at these times, and mean rate of every signal."""
        facts = {"duration": f"{(t_us[-1] - t_us[0]) * 1e-6:.2f} s"}
        for names, t, _ in self.signals:
            if len(t) > 1:
                group = names[0].rsplit("_", 1)[0] if len(names) > 1 else names[0]
                facts[f"rate {group}"] = f"{(len(t) - 1) / ((t[-1] - t[0]) * 1e-6):.1f} Hz"
        return facts


def lay_out(
    log: Noted, path: Path, rows: Rows, advice: str, doubt: str = ""
) -> tuple[pd.DataFrame, NDArray[np.int64]]:
    """The table of all signals that were added, and the times of its rows, us; no `phase` yet.

    Args:
        log: Takes a finding on rows that are left out.
        path: File, for messages.
        rows: Signals.
        advice: What to do where nothing of the motion is there, a sentence.
        doubt: What may be the cause where rows are left out, begun by a colon.

    Raises:
        LogError: Nothing of the motion is there.
    """
    t_us, outside = rows.times_us()
    if outside:
        message = "rows dropped outside the longest stretch without a pause of a minute"
        log.note("error", "time", message + doubt, outside)
    table = rows.table(t_us)
    if not any(c in table for c in MOTION):
        raise LogError(
            f"{path.name}: the log holds no sample of acceleration, body rates, attitude, position "
            f"or velocity within {len(t_us)} rows. {advice}"
        )
    return table, t_us


def add_signal(
    log: Noted,
    rows: Rows,
    where: str,
    names: tuple[str, ...],
    t_us: NDArray[np.int64],
    values: Array,
    begin: str = "the log began",
) -> None:
    """Add a signal and note what it loses.

    Args:
        log: Takes the findings.
        rows: Takes the samples.
        where: What the signal is called in findings, and in `limits`.
        names: Its columns.
        t_us: Strictly increasing times, us, shape (n,).
        values: Shape (n, len(names)).
        begin: What happens at time 0.
    """
    absurd = beyond(where, values)
    if absurd.any():
        log.note("error", where, told(where, values[absurd]), int(absurd.sum()))
    early, broken = rows.add(names, t_us[~absurd], values[~absurd])
    if early:
        log.note("info", where, f"samples left out, taken before {begin}", early)
    if broken:
        log.note("error", where, "samples left out, a value is NaN or infinite", broken)
