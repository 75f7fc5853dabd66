"""The last seconds of a flight table that still grows, and some older samples of each signal."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..logs import Flight
from ..logs.columns import ACC, GYRO, MAG, POS, QUAT, VEL, Columns
from ..logs.flight import Settled, finite_rows, missing_signal

Array = NDArray[np.float64]
_VECTORS = (ACC, GYRO, MAG, POS, VEL, QUAT)  # signals whose columns belong together
Rows = Mapping[str, NDArray[np.float64] | NDArray[np.object_]]
"""New rows by column, NaN where a signal has no sample; `time` and `phase` among them."""


class Recent(Flight):
    """The last seconds of a flight: the interface of `Flight` on arrays.

    A table of pandas takes longer to say what it holds than all that is computed of it; it is made
    where it is asked for.
    """

    __slots__ = ("_by", "_known")
    _by: Rows
    _known: frozenset[str]

    def __init__(self, name: str, rows: Rows, settled: Settled | None = None) -> None:
        """Take rows.

        Args:
            name: Of the flight.
            rows: By column.
            settled: Of the flight.
        """
        known = frozenset(c for c in rows if c == "phase" or not np.isnan(rows[c]).all())
        of_flight: dict[str, Any] = {"name": name, "findings": (), "facts": {}, "settled": settled}
        of_flight |= dict.fromkeys(("source", "site", "airframe", "autopilot"))
        for key, value in {**of_flight, "_by": rows, "_known": known}.items():
            object.__setattr__(self, key, value)

    @property
    def table(self) -> pd.DataFrame:
        """See `Flight`."""
        return pd.DataFrame(dict(self._by))

    @property
    def columns(self) -> Columns:
        """See `Flight`."""
        return self._by

    @property
    def time_s(self) -> Array:
        """See `Flight`."""
        return np.asarray(self._by["time"], dtype=np.float64)

    @property
    def phase_codes(self) -> tuple[NDArray[np.int8], NDArray[np.object_]]:
        """See `Flight`."""
        if "phase" not in self._by:
            return np.zeros(len(self.time_s), dtype=np.int8), np.array([""], dtype=object)
        codes, names = pd.factorize(np.asarray(self._by["phase"], dtype=object))
        return codes.astype(np.int8), np.asarray(names, dtype=object)

    def has(self, *columns: str) -> bool:
        """See `Flight`."""
        return self._known.issuperset(columns)

    def signal(self, columns: Sequence[str]) -> tuple[Array, Array]:
        """See `Flight`."""
        if missing := [c for c in columns if not self.has(c)]:
            raise missing_signal(self.name, missing, [c for c in self._by if self.has(c)])
        return finite_rows(self.time_s, np.column_stack([self._by[c] for c in columns]))


@dataclass(slots=True)
class LastRows:
    """Rows of a flight table, the older ones forgotten.

    Attributes:
        name: Of the flight.
        settled: Of the flight; None: not yet.
        last_s: Time of the newest row; NaN: there is none.
    """

    name: str
    settled: Settled | None = None
    last_s: float = np.nan
    _portions: list[Rows] = field(default_factory=list)

    def __len__(self) -> int:
        return sum(len(p["time"]) for p in self._portions)

    @property
    def first_s(self) -> float:
        """Time of the oldest row."""
        return float(self._portions[0]["time"][0])

    def append(self, rows: Rows) -> None:
        """Take new rows, later than all so far."""
        if len(rows["time"]):
            self._portions.append(rows)
            self.last_s = float(rows["time"][-1])

    def forget(self, before_s: float, needed: Mapping[str, int]) -> None:
        """Let go of rows before a time.

        Args:
            before_s: Time, s.
            needed: How many of the last samples among them are retained of a signal, by the first
                of its columns; one of every other.
        """
        rows = self.rows()
        first = int(np.searchsorted(rows["time"], before_s))
        if first == 0:
            return
        retained = np.zeros(len(rows["time"]), dtype=np.bool_)
        retained[first:] = True
        for columns in self._signals():
            known = np.flatnonzero(_known(rows, columns, first))
            retained[known[-needed.get(columns[0], 1) :]] = True
        retained[first - 1] = True  # of whose phase the next row may be
        self._portions = [{c: values[retained] for c, values in rows.items()}]

    def rows(self) -> Rows:
        """All that there are, in one piece."""
        if len(self._portions) != 1:
            self._portions = [_joined(self._portions)]
        return self._portions[0]

    def flight(self) -> Recent:
        """What there is, as a flight."""
        return Recent(self.name, self.rows(), self.settled)

    def time_before_newest(self, columns: tuple[str, ...], samples: int) -> float:
        """Time of a sample so many before the newest one of a signal; infinite where the signal
        has not so many."""
        rows = self.rows()
        t_s = rows["time"][_known(rows, columns)]
        return float(t_s[-1 - samples]) if len(t_s) > samples else np.inf

    def rates_hz(self) -> dict[str, float]:
        """Rates of the signals by the first of their columns, of those that came three times."""
        found, rows = {}, self.rows()
        for columns in self._signals():
            t_s = np.asarray(rows["time"][_known(rows, columns)], dtype=np.float64)
            if len(t_s) > 2:
                found[columns[0]] = float(1.0 / np.median(np.diff(t_s)))
        return found

    def _signals(self) -> list[tuple[str, ...]]:
        there = [c for c in self.rows() if c not in ("time", "phase")]
        vectors = [v for v in _VECTORS if set(v) <= set(there)]
        taken = {c for v in vectors for c in v}
        return [*vectors, *((c,) for c in there if c not in taken)]


def _known(rows: Rows, columns: Sequence[str], end: int | None = None) -> NDArray[np.bool_]:
    """Rows, or those before `end`, in which all columns have a sample."""
    empty = np.logical_or.reduce([np.isnan(rows[c][:end]) for c in columns])
    return np.asarray(~empty)


def _joined(portions: Sequence[Rows]) -> Rows:
    """Portions that follow each other, as one; a column that some lack is empty there."""

    def part(rows: Rows, column: str) -> NDArray[Any]:
        """The column of a portion."""
        if column in rows:
            return rows[column]
        n = len(rows["time"])
        return np.full(n, "", dtype=object) if column == "phase" else np.full(n, np.nan)

    names = dict.fromkeys(c for rows in portions for c in rows)
    return {c: np.concatenate([part(rows, c) for rows in portions]) for c in names}
