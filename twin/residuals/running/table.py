"""The last seconds of a flight table that still grows, and some older samples of each signal."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...logs import Flight
from ...logs.columns import ACC, GYRO, MAG, POS, QUAT, VEL
from ...logs.flight import Settled

Array = NDArray[np.float64]
_VECTORS = (ACC, GYRO, MAG, POS, VEL, QUAT)
Rows = Mapping[str, NDArray[np.float64] | NDArray[np.object_]]
"""New rows by column, NaN where a signal has no sample; `time` and `phase` among them."""


@dataclass(slots=True)
class LastRows:
    """Rows of a flight table, the older ones forgotten.

    Attributes:
        name: Of the flight.
        settled: Of the flight; None: not yet.
    """

    name: str
    settled: Settled | None = None
    _table: pd.DataFrame = field(default_factory=pd.DataFrame)

    def __len__(self) -> int:
        return len(self._table)

    @property
    def first_s(self) -> float:
        """Time of the oldest row."""
        return float(self._table["time"].iloc[0])

    @property
    def last_s(self) -> float:
        """Time of the newest row."""
        return float(self._table["time"].iloc[-1])

    def append(self, rows: Rows) -> None:
        """Take new rows, later than all so far."""
        new = pd.DataFrame(dict(rows), copy=False)
        self._table = (
            new if not len(self._table) else pd.concat([self._table, new], ignore_index=True)
        )

    def forget(self, before_s: float, needed: Mapping[str, int]) -> None:
        """Let go of rows before a time.

        Args:
            before_s: Time, s.
            needed: How many of the last samples among them are kept of a signal, by the first of
                its columns; one of every other.
        """
        time = self._table["time"].to_numpy()
        first = int(np.searchsorted(time, before_s))
        if first == 0:
            return
        kept = np.zeros(len(time), dtype=np.bool_)
        kept[first:] = True
        old = self._table.iloc[:first]
        for columns in self._signals():
            known = np.flatnonzero(old[columns].notna().all(axis=1).to_numpy())
            kept[known[-needed.get(columns[0], 1) :]] = True
        kept[first - 1] = True  # of whose phase the next row may be
        self._table = self._table[kept].reset_index(drop=True)

    def flight(self) -> Flight:
        """What there is, as a flight."""
        return Flight(self.name, self._table, settled=self.settled)

    def time_before_newest(self, columns: tuple[str, ...], samples: int) -> float:
        """Time of a sample so many before the newest one of a signal; infinite where the signal
        has not so many."""
        known = self._table[list(columns)].notna().all(axis=1).to_numpy()
        t_s = self._table["time"].to_numpy()[known]
        return float(t_s[-1 - samples]) if len(t_s) > samples else np.inf

    def rates_hz(self) -> dict[str, float]:
        """Rates of the signals by the first of their columns, of those that came three times."""
        found = {}
        for columns in self._signals():
            known = self._table[columns].notna().all(axis=1).to_numpy()
            t_s = self._table["time"].to_numpy()[known]
            if len(t_s) > 2:
                found[columns[0]] = float(1.0 / np.median(np.diff(t_s)))
        return found

    def _signals(self) -> list[list[str]]:
        there = [str(c) for c in self._table if c not in ("time", "phase")]
        vectors = [list(v) for v in _VECTORS if set(v) <= set(there)]
        taken = {c for v in vectors for c in v}
        return [*vectors, *([c] for c in there if c not in taken)]
