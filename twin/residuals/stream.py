"""Alignment of a live flight with the grid of its twin, once for all consumers.

Residuals, alarms and page read the same grid. Its interior has the numbers of `Alignment` for the
whole flight, by the same functions over a moving window, because

- the forward-backward low-pass of the body rates has no effect of its ends after `FORGOTTEN_S`,
- integrated states, rotors and loads, continue from window to window,
- values that depend on the whole flight are fixed when the twin starts, and recorded.

`LastRows` stores the last seconds of the flight table, and some older samples of each signal.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..component.along import BUILDING
from ..component.rows import OverRows
from ..effects import late_actions
from ..errors import LogError
from ..logs import Flight
from ..logs.airframe import Airframe
from ..logs.columns import ACC, GYRO, MAG, POS, QUAT, VEL, Columns
from ..logs.flight import Settled, finite_rows, missing_signal
from ..logs.stored import phases_at
from ..physics.rotors import Drive
from ..vehicle import Vehicle
from .aligned import (
    AlignedFlight,
    TwinGrid,
    components_of,
    in_flight,
    resting_height,
    rotor_thrust,
    starts_in_air,
)
from .channels import GRID_HZ, imu_predictor
from .measured import LONGEST_GAP_INTERVALS, LONGEST_GAP_S, MeasuredMotion, measured_motion
from .short_horizon import Windows
from .teacher_forced import Inputs, InputSignals, choose_drive

Array = NDArray[np.float64]

_VECTORS = (ACC, GYRO, MAG, POS, VEL, QUAT)  # signals whose columns are sampled together
Rows = Mapping[str, NDArray[np.float64] | NDArray[np.object_]]
"""New rows by column, NaN where a signal has no sample; `time` and `phase` among them."""


class RecentFlight(Flight):
    """The last seconds of a flight: the interface of `Flight` on arrays.

    Queries of a pandas table would take longer than all computations on it; it is created on
    demand.
    """

    __slots__ = ("_by", "_known")
    _by: Rows
    _known: frozenset[str]

    def __init__(
        self,
        name: str,
        rows: Rows,
        settled: Settled | None = None,
        airframe: Airframe | None = None,
    ) -> None:
        """Set up for rows.

        Args:
            name: Name of the flight.
            rows: Rows by column.
            settled: Values that were fixed for the flight.
            airframe: Facts of the aircraft.
        """
        known = frozenset(c for c in rows if c == "phase" or not np.isnan(rows[c]).all())
        of_flight: dict[str, Any] = {"name": name, "findings": (), "facts": {}, "settled": settled}
        of_flight |= dict.fromkeys(("source", "site", "autopilot"))
        of_flight |= {"airframe": airframe, "speeds_late_s": 0.0, "derived_angles": ()}
        of_flight |= {"filter_delays_s": {}}
        for key, value in {**of_flight, "_by": rows, "_known": known}.items():
            object.__setattr__(self, key, value)

    @property
    def table(self) -> pd.DataFrame:
        """Flight table, as in `Flight`."""
        return pd.DataFrame(dict(self._by))

    @property
    def columns(self) -> Columns:
        """Columns by name, as in `Flight`."""
        return self._by

    @property
    def time_s(self) -> Array:
        """Times of the rows, as in `Flight`."""
        return np.asarray(self._by["time"], dtype=np.float64)

    @property
    def phase_codes(self) -> tuple[NDArray[np.int8], NDArray[np.object_]]:
        """Phases of the rows, as in `Flight`."""
        if "phase" not in self._by:
            return np.zeros(len(self.time_s), dtype=np.int8), np.array([""], dtype=object)
        codes, names = pd.factorize(np.asarray(self._by["phase"], dtype=object))
        return codes.astype(np.int8), np.asarray(names, dtype=object)

    def has(self, *columns: str) -> bool:
        """Whether every column has a sample, as in `Flight`."""
        return self._known.issuperset(columns)

    def signal(self, columns: Sequence[str]) -> tuple[Array, Array]:
        """Samples of columns, as in `Flight`."""
        if missing := [c for c in columns if not self.has(c)]:
            raise missing_signal(self.name, missing, [c for c in self._by if self.has(c)])
        return finite_rows(self.time_s, np.column_stack([self._by[c] for c in columns]))


@dataclass(slots=True)
class LastRows:
    """The newest rows of a flight table; older ones are dropped.

    Attributes:
        name: Name of the flight.
        settled: Values that were fixed for the flight; None: not yet.
        last_s: Time of the newest row; NaN: there is none.
        airframe: Facts of the aircraft.
    """

    name: str
    settled: Settled | None = None
    last_s: float = np.nan
    airframe: Airframe | None = None
    _portions: list[Rows] = field(default_factory=list)

    def __len__(self) -> int:
        return sum(len(p["time"]) for p in self._portions)

    @property
    def first_s(self) -> float:
        """Time of the oldest row."""
        return float(self._portions[0]["time"][0])

    def append(self, rows: Rows) -> None:
        """Append rows, later than all so far."""
        if len(rows["time"]):
            self._portions.append(rows)
            self.last_s = float(rows["time"][-1])

    def forget(self, before_s: float, needed: Mapping[str, int]) -> None:
        """Drop rows before a time.

        Args:
            before_s: Time, s.
            needed: Number of last samples before that time that are retained for each signal, by
                the first of its columns; one for all others.
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
        retained[first - 1] = True  # the next row may have its phase
        self._portions = [{c: values[retained] for c, values in rows.items()}]

    def rows(self) -> Rows:
        """All rows as one portion."""
        if len(self._portions) != 1:
            self._portions = [_joined(self._portions)]
        return self._portions[0]

    def flight(self) -> RecentFlight:
        """The rows as a flight."""
        return RecentFlight(self.name, self.rows(), self.settled, self.airframe)

    def time_before_newest(self, columns: tuple[str, ...], samples: int) -> float:
        """Time of the sample a given number before the newest one of a signal; infinite where the
        signal has fewer."""
        rows = self.rows()
        t_s = rows["time"][_known(rows, columns)]
        return float(t_s[-1 - samples]) if len(t_s) > samples else np.inf

    def rates_hz(self) -> dict[str, float]:
        """Rates of the signals with at least three samples, by the first of their columns."""
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
    """Mask of the rows, or of those before `end`, in which all columns have a sample."""
    empty = np.logical_or.reduce([np.isnan(rows[c][:end]) for c in columns])
    return np.asarray(~empty)


def _joined(portions: Sequence[Rows]) -> Rows:
    """Consecutive portions as one; a column that some lack is empty there."""

    def part(rows: Rows, column: str) -> NDArray[Any]:
        """The column of a portion."""
        if column in rows:
            return rows[column]
        n = len(rows["time"])
        return np.full(n, "", dtype=object) if column == "phase" else np.full(n, np.nan)

    names = dict.fromkeys(c for rows in portions for c in rows)
    return {c: np.concatenate([part(rows, c) for rows in portions]) for c in names}


# -- rows on the grid ------------------------------------------------------------------------


NONE = -1
"""Number for rows in no piece."""
FORGOTTEN_S = 0.35
"""Decay time of the body-rate low-pass, exp(-133/s): 5e-21 after that time, in samples."""
BEFORE_S = 2.0
"""Decay time of a channel's low-pass, exp(-80/s) at 18 Hz, exp(-13/s) at the 3 Hz that an IMU of 8
Hz allows: 3e-12 after that time. The shortest piece of flight in use is shorter."""
_DIFFERENCES = 10
"""Number of samples on either side for a derivative of position or attitude."""
SETTLE_S = 2.0
"""Time from the start of a flight to the start of the twin, in which streams may appear. Made
up."""
LONGEST_WAIT_S = 10.0
"""Longest time for which rows wait for a stream that the twin needs, s. Made up."""
NEEDED = ("cmd_1", "rotor_1", "q_w", "vel_x", "pos_x", "gyro_x", "acc_x", "vbat_v")
"""Columns whose signals affect the equations: a new one later starts a new flight."""


class Equations:
    """The equations of a twin. Each is built on first use, which takes up to a second: `build`
    builds them before a flight.

    Attributes:
        drive: Input of its rotors.
        airframe: Airframe as in `AlignedFlight`.
        imu: IMU as in `AlignedFlight`.
    """

    def __init__(self, vehicle: Vehicle, drive: Drive) -> None:
        """Set up for a vehicle."""
        self._vehicle, self.drive = vehicle, drive
        self.airframe, self.imu = components_of(vehicle, drive)

    @cached_property
    def imu_predictor(self) -> OverRows:
        """Predicted readings of the IMU at measured states."""
        return imu_predictor(self.airframe, self._vehicle)

    @cached_property
    def thrust(self) -> OverRows:
        """Total thrust of the rotors."""
        return rotor_thrust(self.airframe, self._vehicle.rotors.count)

    @cached_property
    def windows(self) -> Windows:
        """Simulation over the short horizon."""
        return Windows(self.airframe, self.imu)

    def build(self) -> None:
        """Build all equations that are not built yet."""
        _ = self.imu_predictor, self.thrust, self.windows


@dataclass(slots=True)
class GridRows:
    """The newest rows of a grid.

    Attributes:
        first: Number of the first row, counted from time 0.
        t_s: Times, s, shape (n,).
        u: Inputs, shape (n, n_u).
        rotors: Rotor states, shape (n, n_r).
        states: States, shape (n, n_x).
        phases: Phase of flight, shape (n,).
        carried: Whether the rotors carry the vehicle, shape (n,).
        grounded: Whether the log reports ground, shape (n,).
    """

    first: int
    t_s: Array
    u: Array
    rotors: Array
    states: Array
    phases: NDArray[np.str_]
    carried: NDArray[np.bool_]
    grounded: NDArray[np.bool_]

    @property
    def end(self) -> int:
        """Number of the row after the last."""
        return self.first + len(self.t_s)

    def joined(self, other: "GridRows") -> "GridRows":
        """These rows and those after them."""
        return GridRows(
            self.first,
            *(np.concatenate([getattr(self, name), getattr(other, name)]) for name in _ARRAYS),
        )

    def between(self, first: int, end: int) -> "GridRows":
        """Rows from one number up to another."""
        first = max(first, self.first)
        part = slice(first - self.first, end - self.first)
        return GridRows(first, *(getattr(self, name)[part] for name in _ARRAYS))


_NO_MOTION = MeasuredMotion(None, None, None, None, False, ())
"""Placeholder for pieces whose motion is not used."""
_ARRAYS = ("t_s", "u", "rotors", "states", "phases", "carried", "grounded")
"""Arrays of the grid that are cut and joined by rows."""


class RunningGrid:
    """Rows of one grid, and the uninterrupted pieces of flight among them.

    Attributes:
        airframe: Airframe as in `AlignedFlight`.
        imu: IMU as in `AlignedFlight`.
        step_s: Step of the grid.
        rows: The newest rows; None: there are none yet.
        piece_of: Number of the first row of the piece that contains each row, `NONE` where the
            state is unknown or the aircraft on the ground.
    """

    def __init__(self, vehicle: Vehicle, equations: Equations, step_s: float) -> None:
        airframe = equations.airframe
        self.airframe, self.imu, self.step_s = airframe, equations.imu, step_s
        self.rows: GridRows | None = None
        self.piece_of: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self._vehicle = vehicle
        self._weight = vehicle.mass_kg * vehicle.gravity_m_s2
        self._thrust = equations.thrust
        self._grid = TwinGrid(vehicle, airframe, step_s)
        self._down = [s.name for s in airframe.states].index("pos_z")
        self._columns: tuple[str, ...] = ()
        self._in_air = False

    def new_rows(self, window: Flight, motion: MeasuredMotion, until_s: float) -> GridRows | None:
        """Rows after the existing ones, up to a time; None: none.

        Args:
            window: Last seconds of the flight.
            motion: Measured motion of the window.
            until_s: Time up to which it is final.
        """
        first = round(float(window.time_s[0]) / self.step_s) if self.rows is None else self.rows.end
        end = int(np.floor(until_s / self.step_s + 1e-6)) + 1
        if end <= first:
            return None
        t_s = np.arange(first, end).astype(np.float64) * self.step_s
        signals = InputSignals(window, self._vehicle, self.airframe)
        self._columns = signals.columns
        block = self._grid.block(signals, motion, first, t_s)
        rotors, u = block.inputs.rotor_states, block.inputs.u
        phases = phases_at(window, t_s)
        carried = self._thrust(rotors, u)[:, 0] > 0.5 * self._weight
        return GridRows(first, t_s, u, rotors, block.states, phases, carried, phases == "ground")

    def height_m(self, rows: GridRows) -> Array:
        """Measured height of rows, shape (n,)."""
        return np.asarray(-rows.states[:, self._down])

    def append(self, rows: GridRows, resting_m: float | None, keep: int) -> None:
        """Append rows.

        Args:
            rows: Rows from `new_rows`.
            resting_m: Height of the resting place; None: not used.
            keep: Number of the newest rows that are retained.
        """
        if self.rows is None:
            self._in_air = starts_in_air(rows.carried, rows.grounded, self.step_s)
        height_m = self.height_m(rows)
        flying = in_flight(
            rows.carried, rows.grounded, height_m, None if self._in_air else resting_m
        )
        known = flying & np.all(np.isfinite(rows.states), axis=1)
        number = np.arange(rows.first, rows.end)
        before = int(self.piece_of[-1]) if len(self.piece_of) else NONE
        begins = known & ~np.concatenate([[before != NONE], known[:-1]])
        since = np.maximum.accumulate(np.where(begins, number, before))
        piece_of = np.where(known, since, NONE)
        everything = rows if self.rows is None else self.rows.joined(rows)
        self.rows = everything.between(everything.end - keep, everything.end)
        self.piece_of = np.concatenate([self.piece_of, piece_of])[-len(self.rows.t_s) :]

    def piece(self, first: int, end: int, motion: MeasuredMotion = _NO_MOTION) -> AlignedFlight:
        """Some of the rows as a separate flight, with a mask of those in the air.

        Args:
            first: Number of the first row.
            end: Number of the row after the last.
            motion: Motion of a window that contains them, where it is needed.
        """
        assert self.rows is not None
        rows = self.rows.between(first, end)
        return AlignedFlight(
            self.airframe,
            self.imu,
            Inputs(self._columns, rows.t_s, rows.u, rows.rotors, ()),
            motion,
            rows.states,
            rows.phases,
            self.known_in_air(first, end),
            (),
        )

    def known_in_air(self, first: int, end: int) -> NDArray[np.bool_]:
        """Whether each of some rows is in the air with a known state."""
        assert self.rows is not None
        return np.asarray(self.piece_of[first - self.rows.first : end - self.rows.first] != NONE)

    def piece_at(self, number: int) -> int:
        """First row of the piece that contains a row, `NONE` where there is none."""
        assert self.rows is not None
        return int(self.piece_of[number - self.rows.first])


class Stream:
    """Rows of one live flight on the grid of `GRID_HZ`.

    Attributes:
        vehicle: Vehicle of the twin.
        equations: Equations of the twin; None: it has not started.
        waits_for: Missing conditions for the start of the twin, in words; "": none.
        grid: Rows of the grid up to `until_s`; None: the twin has not started.
        window: The last seconds of the flight table.
        motion: Measured motion of the window.
        starts_s: Time of the oldest row when the twin started; NaN: it has not started.
        until_s: Time up to which rows are final.
        needed_s: Time from which consumers need rows, at most `LONGEST_WAIT_S` before the end of
            the grid.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        equations: Equations | None = None,
        name: str = "live",
    ) -> None:
        """Set up without rows.

        Args:
            vehicle: Vehicle of the twin.
            equations: Equations of the vehicle, where they are available.
            name: Name of the flight.
        """
        self.vehicle = vehicle
        self.equations: Equations | None = None
        self._prepared = equations
        self.waits_for = "the first seconds of flight"
        self.grid: RunningGrid | None = None
        self.window: Flight | None = None
        self.motion = _NO_MOTION
        self.until_s, self.needed_s, self.starts_s = -np.inf, np.inf, np.nan
        self._last, self._begins_s, self._advanced_s = LastRows(name), np.nan, np.nan
        self._heights_m: list[Array] = []
        self._resting_known = False
        late_s = max([0.0, *late_actions(vehicle).values()])
        self._before_s = BEFORE_S + 1.0 + late_s

    @property
    def settled(self) -> Settled | None:
        """Fixed values for a recording; None: the twin has not started."""
        return self._last.settled

    @property
    def last_s(self) -> float:
        """Time of the newest row; NaN: there is none."""
        return self._last.last_s

    @property
    def resting_m(self) -> float | None:
        """Height of the resting place, m; None: not used, or not known yet."""
        down_m = None if self.settled is None else self.settled.resting_down_m
        return None if down_m is None else -down_m

    def push(self, rows: Rows) -> None:
        """Append rows of the flight table.

        Args:
            rows: Rows by column, NaN where a signal has no sample.

        Raises:
            LogError: Times do not increase.
        """
        time, last = rows["time"], self._last
        if not len(time):
            return
        if not np.all(np.diff(time) > 0) or time[0] <= last.last_s:
            raise LogError(
                f"live flight: time has to rise, {time[0]:.6g} s comes after {last.last_s:.6g} s. "
                f"Give each row once, in order; a new clock is a new flight."
            )
        last.append(rows)
        if np.isnan(self._begins_s):
            self._begins_s = last.first_s

    def lacks(self, columns: Sequence[str]) -> list[str]:
        """New columns that would change the twin."""
        if self.equations is None:
            return []
        return [c for c in columns if c in NEEDED and c not in self._columns]

    def advance(self, final: bool = False) -> bool:
        """Append final rows to the grid; returns whether the twin has started.

        Args:
            final: Whether there will be no more rows.
        """
        if not len(self._last):
            return False
        if self.equations is None and not self._started(final):
            self._last.forget(self._last.last_s - LONGEST_WAIT_S, {})
            return False
        if self._advanced_s == self._last.last_s and not final:
            return True
        self._advanced_s = self._last.last_s
        assert self.grid is not None
        oldest_s = max(self.needed_s, self.until_s - LONGEST_WAIT_S)
        self.until_s = self._last.last_s if final else self._settled_until_s()
        self.window = self._last.flight()
        self.motion = measured_motion(self.window, doubts=False)
        new = self.grid.new_rows(self.window, self.motion, self.until_s)
        if new is not None:
            keep = round((self._before_s + LONGEST_WAIT_S) * GRID_HZ) + len(new.t_s)
            self.grid.append(new, self._resting_of(new), keep)
        samples = {name: count + 1 for name, (_, count) in self._needed.items()}
        oldest_s = min(oldest_s, self.until_s) - self._before_s - FORGOTTEN_S
        self._last.forget(oldest_s, samples)
        return True

    def _started(self, final: bool) -> bool:
        """Start the twin, where all its signals are available."""
        if self._last.last_s - self._begins_s < SETTLE_S and not final:
            return False
        self._last.settled = Settled(self._last.rates_hz())
        try:
            with BUILDING:
                self._start(self._last.flight())
        except LogError as error:
            self._last.settled = None
            self.waits_for = str(error).partition(": ")[2]
            return False
        self.waits_for = ""
        return True

    def _start(self, flight: Flight) -> None:
        self._columns = frozenset(c for c in flight.columns if flight.has(c))
        drive = choose_drive(flight, self.vehicle)
        measured_motion(flight)  # raises where there is none
        equations = self._prepared
        if equations is None or equations.drive != drive:
            equations = Equations(self.vehicle, drive)
        self.starts_s = float(flight.time_s[0])
        self.grid = RunningGrid(self.vehicle, equations, 1 / GRID_HZ)
        self.equations = equations
        rates = flight.settled.rates_hz if flight.settled else {}
        self._after_s = max([FORGOTTEN_S, *(_longest_gap_s(r) for r in rates.values())])
        self._needed = {
            columns[0]: (columns, _DIFFERENCES)
            for columns, instead in ((POS, VEL), (QUAT, GYRO))
            if columns[0] in rates and instead[0] not in self._columns  # it is derived then
        } | {
            columns[0]: (columns, max(_DIFFERENCES, int(np.ceil(FORGOTTEN_S * rates[columns[0]]))))
            for columns in (ACC, GYRO)
            if columns[0] in rates
        }

    def _settled_until_s(self) -> float:
        """Time up to which rows are final.

        Filters and differences count samples: before a pause of a signal they wait for its end, for
        at most `LONGEST_WAIT_S`.
        """
        newest_s = self._last.last_s
        known = [self._last.time_before_newest(c, n) for c, n in self._needed.values()]
        known = [t for t in known if t > newest_s - LONGEST_WAIT_S]
        return min([newest_s - self._after_s, *known])

    def _resting_of(self, new: GridRows) -> float | None:
        """Height of the resting place, fixed when the rotors carry the vehicle for the first
        time."""
        assert self._last.settled is not None and self.grid is not None
        if self._resting_known:
            return self.resting_m
        height_m = self.grid.height_m(new)
        if not new.carried.any():
            self._heights_m.append(height_m[np.isfinite(height_m)])
            return None  # not carried: nothing is in the air
        self._heights_m.append(height_m[: int(np.argmax(new.carried))])
        before = np.concatenate(self._heights_m)
        found = None
        if self.motion.position is not None:
            found = resting_height(before, np.zeros(len(before), dtype=np.bool_))
        self._resting_known, self._heights_m = True, []
        down_m = None if found is None else -found
        self._last.settled = replace(self._last.settled, resting_down_m=down_m)
        return found


def _longest_gap_s(rate_hz: float) -> float:
    """Time after a sample at which it is known whether a gap follows it."""
    return min(LONGEST_GAP_INTERVALS / rate_hz, max(LONGEST_GAP_S, 1.5 / rate_hz)) + 0.01
