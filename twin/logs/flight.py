"""A flight in memory: the table of `docs/reference/flight_table.md` plus the findings of its
reader."""

import hashlib
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, Literal, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..errors import LogError
from ..representation import ShortRepr
from .airframe import Airframe
from .autopilot import Autopilot
from .columns import Columns, in_order

Array = NDArray[np.float64]
Severity = Literal["info", "warning", "error"]


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that a reader counted, dropped, filled or found doubtful."""

    severity: Severity
    where: str
    message: str
    count: int = 1


class FindingCollector:
    """A source that is being read, with the findings so far."""

    __slots__ = ()
    findings: list[Finding]

    def note(
        self,
        severity: Severity,
        where: str,
        message: str,
        count: int | np.bool_ | NDArray[np.bool_] = 1,
    ) -> None:
        """Add a finding.

        Args:
            severity: Severity of the finding.
            where: Signal or part of the file.
            message: What was found.
            count: Number of samples concerned, or their mask; with 0 no finding is added.
        """
        n = int(np.count_nonzero(count)) if isinstance(count, np.ndarray) else int(count)
        if n:
            self.findings.append(Finding(severity, where, message, n))


@dataclass(frozen=True, slots=True)
class Site:
    """Place of a flight, as far as it affects the air around the aircraft.

    Attributes:
        indoors: Whether within walls: no wind, and a compass near metal.
        source: Source of this information.
    """

    indoors: bool
    source: str

    def __str__(self) -> str:
        return f"{'indoors' if self.indoors else 'outdoors'}: {self.source}"


@dataclass(frozen=True, slots=True)
class Settled:
    """Values that were fixed during a live flight, for computing the same results again later.

    The whole flight would give slightly different values; a filter that is designed for another
    sample rate gives other numbers.

    Attributes:
        rates_hz: Sample rates of signals, by the first of their columns.
        resting_down_m: Position of the aircraft at rest before the flight, NED, down; None: not
            known.
    """

    rates_hz: dict[str, float] = field(default_factory=dict)
    resting_down_m: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Notes:
    """Information on a flight besides its table; a flight table in Parquet stores it.

    Attributes:
        facts: Facts of the log (vehicle, firmware, rates, match of rebuilt commands), printable key
            by key.
        findings: Findings of the reader, in the order of reading.
        site: Indoors or outdoors, and the source of that; None: not known.
        airframe: Facts of the aircraft in the log; None: there are none.
        autopilot: Records of the autopilot: modes, failsafes, setpoints; None: there are none.
        settled: Values that were fixed during recording; None: the flight was not recorded live.
        derived_angles: Euler angles that were not logged and were derived from the acceleration
            (`twin.logs.attitude`).
        speeds_late_s: Correction of the late time stamps of rotor speeds, s
            (`twin.logs.rotor_lag`): the link that delayed the speeds has also smoothed them.
        filter_delays_s: Delay of the low-pass that readings passed before they were logged, s, by
            signal, where their time stamps are corrected for it.
    """

    facts: dict[str, str] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    site: Site | None = None
    airframe: Airframe | None = None
    autopilot: Autopilot | None = None
    settled: Settled | None = None
    derived_angles: tuple[str, ...] = ()
    speeds_late_s: float = 0.0
    filter_delays_s: dict[str, float] = field(default_factory=dict)

    @property
    def notes(self) -> dict[str, Any]:
        """All fields by name."""
        return {f.name: getattr(self, f.name) for f in fields(Notes)}


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Flight(Notes, ShortRepr):
    """One recorded flight on one clock, SI, NED, FRD, quaternions `[w, x, y, z]`.

    Attributes:
        name: Short name, usually the stem of the file.
        table: Flight table; `time` in s from 0, strictly increasing; NaN where a signal has no
            sample in that row. `phase` is a text column, "" where unknown.
        source: Path of the file.
    """

    name: str
    table: pd.DataFrame
    source: Path | None = None

    @property
    def indoors(self) -> bool | None:
        """Whether the flight was within walls; None: not known."""
        return None if self.site is None else self.site.indoors

    @property
    def columns(self) -> Columns:
        """The table by column, in the order of the definition, motors by number."""
        return {c: self.table[c].to_numpy() for c in in_order(map(str, self.table))}

    @property
    def time_s(self) -> Array:
        """Times of the rows, s, shape (n,)."""
        return np.asarray(self.table["time"].to_numpy(dtype=np.float64))

    @property
    def phase_codes(self) -> tuple[NDArray[np.int8], NDArray[np.object_]]:
        """Phase of each row as an index into a list of names, and the list."""
        if "phase" not in self.table:
            return np.zeros(len(self.table), dtype=np.int8), np.array([""], dtype=object)
        codes, names = pd.factorize(self.table["phase"].fillna("").to_numpy(dtype=object))
        return codes.astype(np.int8), np.asarray(names, dtype=object)

    @property
    def fingerprint(self) -> str:
        """Hash of all its numbers, independent of file name and column order."""
        digest = hashlib.sha256()
        for column in sorted(self.table):
            values = self.table[column]
            digest.update(f"{column}\0".encode())
            if values.dtype.kind in "fiub":
                digest.update(values.to_numpy(dtype=np.float64).tobytes())
            else:
                digest.update("\0".join(values.astype(str)).encode())
        return digest.hexdigest()

    def has(self, *columns: str) -> bool:
        """Whether the table has every column with at least one finite sample."""
        return all(c in self.table and _is_known(self.table[c].to_numpy()) for c in columns)

    def signal(self, columns: Sequence[str]) -> tuple[Array, Array]:
        """Samples at the rows where all the columns are finite.

        Args:
            columns: Names of flight-table columns that are sampled together.

        Returns:
            Times in s, shape (n,), and values, shape (n, len(columns)).

        Raises:
            LogError: A column is missing or has no finite sample.
        """
        missing = [c for c in columns if not self.has(c)]
        if missing:
            raise missing_signal(self.name, missing, [c for c in self.table if self.has(c)])
        values = [self.table[c].to_numpy(dtype=np.float64) for c in columns]
        return finite_rows(self.time_s, np.array(values).T)

    def between(self, start_s: float, end_s: float) -> "Flight":
        """The part of the flight within a span of time, both ends included."""
        inside = (self.time_s >= start_s) & (self.time_s <= end_s)
        return replace(self, table=self.table[inside].reset_index(drop=True))


_Flight = TypeVar("_Flight")
_Given = ParamSpec("_Given")
_Made = TypeVar("_Made")


def once_per_flight(
    make: Callable[Concatenate[_Flight, _Given], _Made],
) -> Callable[Concatenate[_Flight, _Given], _Made]:
    """Decorator: cache results of a function of a flight as long as the flight exists, by the
    values of the other arguments; a result must not refer to the flight."""
    stored: WeakKeyDictionary[_Flight, dict[bytes, _Made]] = WeakKeyDictionary()

    @wraps(make)
    def made(flight: _Flight, /, *given: _Given.args, **named: _Given.kwargs) -> _Made:
        own, key = stored.setdefault(flight, {}), pickle.dumps((given, named))
        if key not in own:
            own[key] = make(flight, *given, **named)
        return own[key]

    return made


def _is_known(values: NDArray[Any]) -> bool:
    """Whether a column has a finite sample."""
    return not bool(np.isnan(values).all() if values.dtype.kind == "f" else pd.isna(values).all())


def missing_signal(name: str, missing: Sequence[str], there: Sequence[str]) -> LogError:
    """The error for columns that a flight does not have."""
    return LogError(
        f"{name}: no samples of {', '.join(missing)}. The flight has: {', '.join(there)}."
    )


def finite_rows(t_s: Array, values: Array) -> tuple[Array, Array]:
    """Times and values of the rows in which every column is finite; the same arrays where all
    are."""
    known = ~np.isnan(values).any(axis=1) & ~np.isnan(t_s)
    return (t_s, values) if known.all() else (t_s[known], values[known])
