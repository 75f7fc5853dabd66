"""A flight that still goes on, put on the grid of its twin: new rows with the numbers that
`Alignment` has for the whole flight."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...logs import Flight
from ...vehicle import Vehicle
from ..airborne import in_flight, starts_in_air
from ..aligned import AlignedFlight
from ..measured import MeasuredMotion
from ..teacher_forced import (
    Inputs,
    InputSignals,
    RotorStates,
    hidden_of,
    measured_states,
)
from .equations import Equations

Array = NDArray[np.float64]
NONE = -1
"""Of a row that is in no piece."""


@dataclass(slots=True)
class GridRows:
    """The newest rows of a grid.

    Attributes:
        first: Number of the first of them, counted from time 0.
        t_s: Times, s, shape (n,).
        u: Inputs, shape (n, n_u).
        rotors: Rotor states, shape (n, n_r).
        states: Shape (n, n_x).
        phases: Shape (n,).
        carried: Shape (n,).
        grounded: Shape (n,).
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
        """These and those after them."""
        return GridRows(
            self.first,
            *(np.concatenate([getattr(self, name), getattr(other, name)]) for name in _ARRAYS),
        )

    def since(self, first: int) -> "GridRows":
        """Those from a number on."""
        skip = max(first - self.first, 0)
        return GridRows(self.first + skip, *(getattr(self, n)[skip:] for n in _ARRAYS))


_ARRAYS = ("t_s", "u", "rotors", "states", "phases", "carried", "grounded")


class RunningGrid:
    """Rows of one grid, and which of them make a piece of flight without a break.

    Attributes:
        airframe: As of `AlignedFlight`.
        imu: As of `AlignedFlight`.
        step_s: Step of the grid.
        rows: The newest ones; None: there are none yet.
        piece_of: Number of the first row of the piece that each of the rows is in, `NONE` where the
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
        self._rotors = RotorStates(airframe, step_s)
        self._hidden = hidden_of(airframe, step_s)
        self._down = [s.name for s in airframe.states].index("pos_z")
        self._columns: tuple[str, ...] = ()
        self._in_air = False

    def new_rows(self, window: Flight, motion: MeasuredMotion, until_s: float) -> GridRows | None:
        """Rows after those that are there, up to a time; None: none.

        Args:
            window: The last seconds of the flight.
            motion: Of the window.
            until_s: Up to where it will not change any more.
        """
        time = window.time_s
        first = round(float(time[0]) / self.step_s) if self.rows is None else self.rows.end
        end = int(np.floor(until_s / self.step_s + 1e-6)) + 1
        if end <= first:
            return None
        t_s = np.arange(first, end).astype(np.float64) * self.step_s
        signals = InputSignals(window, self._vehicle, self.airframe)
        self._columns = signals.columns
        u = signals.at(t_s)
        along = self._rotors.along(u)
        inputs = Inputs(signals.columns, t_s, u, along, ())
        # the step is of the grid, not of what may be one row alone
        states = measured_states(self.airframe, motion, inputs, self._hidden)
        codes, names = window.phase_codes
        at = np.maximum(np.searchsorted(time, t_s + 1e-9, side="right") - 1, 0)
        phases = np.asarray(names.astype("<U8")[codes[at]])
        carried = self._thrust(along, u)[:, 0] > 0.5 * self._weight
        return GridRows(first, t_s, u, along, states, phases, carried, phases == "ground")

    def height_m(self, rows: GridRows) -> Array:
        """Measured height of rows, shape (n,)."""
        return np.asarray(-rows.states[:, self._down])

    def append(self, rows: GridRows, resting_m: float | None, keep: int) -> None:
        """Take new rows.

        Args:
            rows: Of `new_rows`.
            resting_m: Height of the resting place; None: it does not count.
            keep: How many of the newest rows are kept.
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
        self.rows = everything.since(everything.end - keep)
        self.piece_of = np.concatenate([self.piece_of, piece_of])[-len(self.rows.t_s) :]

    def piece(self, first: int, end: int) -> AlignedFlight:
        """Some of the rows as a flight of their own, those that count in the air.

        Args:
            first: Number of the first.
            end: Number of the row after the last.
        """
        assert self.rows is not None
        part = slice(first - self.rows.first, end - self.rows.first)
        rows = self.rows
        return AlignedFlight(
            self.airframe,
            self.imu,
            Inputs(self._columns, rows.t_s[part], rows.u[part], rows.rotors[part], ()),
            _NO_MOTION,
            rows.states[part],
            rows.phases[part],
            self.piece_of[part] != NONE,
            (),
        )

    def piece_at(self, number: int) -> int:
        """First row of the piece that a row is in, `NONE` where it is in none."""
        assert self.rows is not None
        return int(self.piece_of[number - self.rows.first])


_NO_MOTION = MeasuredMotion(None, None, None, None, False, ())


def with_motion(aligned: AlignedFlight, motion: MeasuredMotion) -> AlignedFlight:
    """The same, with the motion of a window that holds it."""
    return replace(aligned, motion=motion)
