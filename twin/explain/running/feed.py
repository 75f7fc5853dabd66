"""Rows of a flight table as they come, put onto the grid of the twin, whole frames at a time.

The same signals, filters and rotor states as `twin.residuals.aligned`, over the last seconds alone
and a quarter of a second behind the newest row: until then the zero-phase low-pass of the body
rates has forgotten where the record ends, and the next sample of a slow signal is there.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...component import Component
from ...component.building import BUILDING
from ...errors import LogError
from ...logs import Flight
from ...logs.columns import ACC, GYRO
from ...physics.airframe import airframe
from ...physics.rotors import Drive
from ...physics.sensors.table import BODY, SENSORS
from ...representation import short_repr
from ...residuals.channels import GRID_HZ, on_grid
from ...residuals.measured import Signal, measured_motion, rates_of
from ...residuals.running.table import LastRows, Rows
from ...residuals.teacher_forced import (
    Inputs,
    InputSignals,
    RotorStates,
    choose_drive,
    hidden_of,
    measured_states,
)
from ...vehicle import Vehicle

Array = NDArray[np.float64]
FRAME_ROWS = 100
"""Rows of the grid in a frame."""
FRAME_S = FRAME_ROWS / GRID_HZ
OVERLAP_S = 1.0
"""Rows so old are kept: filters begin there."""
BEHIND_S = 0.25
"""By which the grid ends before the newest row."""
OF_POSE = tuple(s for s in SENSORS if s.group != BODY)


@dataclass(frozen=True, slots=True)
class GridBlock:
    """Rows of the grid, one after the other, up to the end of a frame.

    Attributes:
        first: Number of the first of them; the grid begins at the time zero.
        t_s: Times, shape (n,).
        states: Of the airframe, shape (n, n_x); NaN where nothing was measured.
        inputs: Of the airframe, shape (n, n_u).
        grounded: Where the flight says that it is on the ground, shape (n,).
        readings: By signal ("acc", "gyro", "pull" NED, "turning", "mag", "baro"), shape (n, k),
            NaN where unknown.
        samples: Readings of the IMU as they came: times, shape (m,), and values, shape (m, k).
        further: Columns of the flight that a sensor of the pose asks for, shape (n,) each.
    """

    first: int
    t_s: Array
    states: Array
    inputs: Array
    grounded: NDArray[np.bool_]
    readings: Mapping[str, Array]
    samples: Mapping[str, tuple[Array, Array]]
    further: Mapping[str, Array]

    __repr__ = short_repr


class StreamResampler:
    """From rows of a flight table to rows of the grid, none left out.

    Attributes:
        airframe: Built with the effects, switched off; None before two seconds have come.
        drive: What drives it.
    """

    def __init__(self, vehicle: Vehicle, effects: Iterable[str]) -> None:
        """Begin.

        Args:
            vehicle: The calibrated model.
            effects: Effects to build into the airframe.
        """
        self._vehicle, self._effects = vehicle, list(effects)
        self._last = LastRows("live")
        self._next: int | None = None
        self.airframe: Component | None = None
        self.drive: Drive | None = None

    def push(self, rows: Rows) -> GridBlock | None:
        """The next rows of the grid; None while they do not complete a frame.

        Args:
            rows: Of a flight table, later than those before.

        Raises:
            LogError: Times do not rise, or nothing drives the vehicle.
        """
        time, last = rows["time"], self._last
        if not len(time):
            return None
        if not np.all(np.diff(time) > 0) or time[0] <= last.last_s:
            raise LogError(
                f"live flight: time has to rise, {time[0]:.6g} s comes after {last.last_s:.6g} s. "
                f"Give each row once, in order; a new clock is a new flight."
            )
        last.append(rows)
        end = int(np.floor((last.last_s - BEHIND_S) * GRID_HZ + 1e-6)) // FRAME_ROWS * FRAME_ROWS
        if self._next is None:
            if last.last_s - last.first_s < OVERLAP_S:
                return None
            with BUILDING:
                self._begin(last.flight())
            self._next = int(np.ceil(last.first_s * GRID_HZ - 1e-6)) + 1
        if end <= self._next:
            return None
        block = self._block(last.flight(), self._next, end)
        self._next = end
        last.cut(end / GRID_HZ - OVERLAP_S)
        return block

    def _begin(self, flight: Flight) -> None:
        self.drive = choose_drive(flight, self._vehicle)
        self.airframe = airframe(self._vehicle, self.drive, self._effects)
        self._rotors = RotorStates(self.airframe, 1 / GRID_HZ)
        self._hidden = hidden_of(self.airframe, 1 / GRID_HZ)

    def _block(self, flight: Flight, first: int, end: int) -> GridBlock:
        assert self.airframe is not None
        wide = np.arange(first - 1, end + 1) / GRID_HZ
        t = wide[1:-1]
        signals = InputSignals(flight, self._vehicle, self.airframe)
        u = signals.at(t)
        inputs = Inputs(signals.columns, t, u, self._rotors.along(u), signals.notes)
        motion = measured_motion(flight, doubts=False)
        states = measured_states(self.airframe, motion, inputs, self._hidden)
        read: dict[str, Array] = {}
        for name, columns in (("acc", ACC), ("gyro", GYRO)):
            if flight.has(*columns):
                read[name] = on_grid(Signal(*flight.signal(columns)), t)
        if motion.attitude is not None and len(motion.attitude.t_s) > 2:
            read["turning"] = rates_of(motion.attitude).at(t)
        if motion.velocity is not None:
            velocity = motion.velocity.at(wide)
            pull = (velocity[2:] - velocity[:-2]) * (GRID_HZ / 2)
            read["pull"] = pull - [0.0, 0.0, self._vehicle.gravity_m_s2]
        for sensor in OF_POSE:
            if flight.has(*sensor.columns):
                read[sensor.signal] = Signal(*flight.signal(sensor.columns)).at(t)
        further = {
            c: Signal(*flight.signal([c])).held(t)[:, 0]
            for c in ("ibat_a", "vbat_v")
            if flight.has(c)
        }
        return GridBlock(
            first, t, states, u, _grounded(flight, t), read, _samples(flight, first, end), further
        )


def _grounded(flight: Flight, t: Array) -> NDArray[np.bool_]:
    """Where the flight says that it is on the ground."""
    codes, names = flight.phase_codes
    rows = np.maximum(np.searchsorted(flight.time_s, t + 1e-9, side="right") - 1, 0)
    return np.asarray((names == "ground")[codes[rows]])


def _samples(flight: Flight, first: int, end: int) -> dict[str, tuple[Array, Array]]:
    """Readings of the IMU within the rows, as they came."""
    found = {}
    for name, columns in (("acc", ACC), ("gyro", GYRO)):
        if flight.has(*columns):
            t, values = flight.signal(columns)
            low, high = np.searchsorted(t, [first / GRID_HZ - 1e-9, end / GRID_HZ - 1e-9])
            found[name] = t[low:high], values[low:high]
    return found
