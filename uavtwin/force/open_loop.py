"""Open-loop replay of flights through a driven twin: its error some time after its last correction.

`driving_inputs` turns a flight into the inputs of the twin that a log drives, `export
corrected-twin --drive`. The exported FMU follows the measured motion once the aircraft is clear of
the ground, since ground contact would be estimated as a disturbance. Repeatedly its state is saved,
it runs open loop on the recorded commands for the longest horizon, and the state is restored.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.slave import Slave
from learning.data.channels import phase_codes
from learning.force.windows import EVERY_S, WARM_S, apart, clear, left_alone, true_motion
from twin.errors import LogError
from twin.frames import AXES, multiply
from twin.logs import AnyFlight
from twin.representation import ShortRepr
from twin.residuals.aligned import AlignedFlight, align_flight
from twin.residuals.measured import Signal
from twin.residuals.teacher_forced import GRID_S, RIGID, SPIN_RATE
from twin.vehicle import Vehicle

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
VOLTAGE = "vbat_v"
"""Column of the battery voltage, V."""
PREFIX = "airframe."
"""Prefix of the airframe's inputs and outputs in the fused FMU."""
HORIZONS_S = (0.05, 0.2, 0.5, 1.0, 2.0)
"""Durations of open-loop prediction, s."""
DISTANCE = "residual_force.distance"
"""Output of a twin with a learned force: distance from the training data, 1 at the envelope's
edge."""
QUANTITIES = (("position", "m"), ("velocity", "m/s"), ("attitude", "rad"), ("rates", "rad/s"))
"""Compared quantities and their units."""


@dataclass(frozen=True, slots=True)
class OpenLoop(ShortRepr):
    """Open-loop errors of an FMU on one flight.

    Attributes:
        t_s: Start times of the open-loop runs, s, shape (w,).
        off: Twin minus aircraft per horizon and quantity of `QUANTITIES`, along x, y and z:
            position and velocity NED, attitude and rates in body axes; shape (w, horizons, 4, 3).
        watched: Watched outputs at the horizons, shape (w, horizons, k).
        begin: Watched outputs at the start of each run, shape (w, k).
    """

    t_s: Array
    off: Array
    watched: Array
    begin: Array

    @property
    def rms(self) -> Array:
        """Root mean square over the runs of the flight, shape (horizons, 4, 3)."""
        return np.asarray(np.sqrt(np.mean(self.off**2, axis=0)))


class Replay:
    """A flight, prepared for replay through driven twins.

    Attributes:
        speed_m_s: Median speed in the air, m/s.
        start_s: Time of the flight at which the twin starts, s.
    """

    def __init__(
        self,
        flight: AnyFlight,
        vehicle: Vehicle,
        horizons_s: Sequence[float] = HORIZONS_S,
        every_s: float | None = None,
    ) -> None:
        """Resample the flight to the grid of its twin.

        Args:
            flight: Flight to replay.
            vehicle: Vehicle of the twin.
            horizons_s: Horizons at which it is compared, s.
            every_s: Time between the starts of two open-loop runs, s; None: `EVERY_S`.

        Raises:
            LogError: The flight cannot be replayed, or is nowhere long enough in the air.
        """
        aligned = self._drive(flight, vehicle)
        motion = aligned.motion
        parts = {n: getattr(motion, n) for n in ("position", "velocity", "attitude", "rates")}
        if missing := [name for name, part in parts.items() if part is None]:
            raise LogError(
                f"{flight.name}: no measured {', '.join(missing)}: the twin cannot be compared. "
                f"Give a flight with position and attitude."
            )
        self.start_s = float(aligned.inputs.t_s[0])
        self._measured = true_motion(vehicle, aligned)
        self._steps = [round(h / GRID_S) for h in horizons_s]
        known = clear(aligned) & np.isfinite(self._measured).all(axis=1)
        self._left = left_alone(known, self._steps[-1], every_s or EVERY_S)
        self.speed_m_s = _median_speed(self._measured[known])
        if not len(self._left):
            raise LogError(
                f"{flight.name}: nowhere {WARM_S + horizons_s[-1]:g} s in the air without a gap, "
                f"which it takes to follow it and then to fly alone. Give a longer flight."
            )

    def driven_as(self, flight: AnyFlight, vehicle: Vehicle) -> "Replay":
        """The same start times and measured motion, with the inputs of another vehicle's twin.

        Args:
            flight: Flight of this replay.
            vehicle: Vehicle whose twin gets the inputs.

        Raises:
            LogError: The flight cannot be put on the grid of its twin.
        """
        other = copy(self)
        other._drive(flight, vehicle)
        return other

    def _drive(self, flight: AnyFlight, vehicle: Vehicle) -> AlignedFlight:
        """Set the inputs of a vehicle's twin over a flight; returns the flight on the twin's
        grid."""
        aligned = align_flight(flight, vehicle)
        self._table = driving_inputs(flight, vehicle, aligned, np.flatnonzero(clear(aligned)))
        self._changes = _changes(self._table)
        return aligned

    def through(
        self,
        fmu: Path,
        starts: Mapping[str, float] | None = None,
        watch: Sequence[str] = (),
    ) -> OpenLoop:
        """Replay the flight through an FMU.

        Args:
            fmu: FMU from `export corrected-twin --drive`.
            starts: Start values of the FMU, by name of the parameter.
            watch: Other outputs to record at the horizons.
        """
        reads = (*(PREFIX + s for s in RIGID), *watch)
        slave, found, begin = Slave("driven", fmu), [], []
        try:
            names, given = taken_by(slave, self._table)
            slave.begin(names, reads, starts or {})
            alone = np.array(names) != f"{PREFIX}restart"
            state, due = slave.save(), set(self._left.tolist())
            for row in range(int(self._left[-1]) + 1):
                if row in due:
                    slave.save(state)
                    slave.read_outputs()
                    begin.append(slave.outputs[len(RIGID) :].copy())
                    found.append(self._alone(slave, given, alone, row))
                    slave.restore(state)
                _step(slave, row, 1, given[row])
        finally:
            slave.close()
        values = np.array(found)
        watched = values[..., len(RIGID) :], np.array(begin)
        return self._compared(values[..., : len(RIGID)], *watched)

    def last_reading(self) -> OpenLoop:
        """Errors of the prediction that the motion at the start does not change (persistence)."""
        return self._compared(self._held())

    def last_motion(self) -> OpenLoop:
        """Errors of the prediction with constant velocity and body rates from the start."""
        held = self._held()
        at = {stem: [RIGID.index(f"{stem}_{a}") for a in AXES] for stem in ("pos", "vel", "omega")}
        q = [RIGID.index(f"q_{a}") for a in "wxyz"]
        ahead_s = GRID_S * np.array(self._steps)[:, None]
        held[..., at["pos"]] += ahead_s * held[..., at["vel"]]
        half = ahead_s * held[..., at["omega"]] / 2
        angle = np.linalg.norm(half, axis=-1, keepdims=True)
        turn = np.concatenate([np.cos(angle), half * np.sinc(angle / np.pi)], axis=-1)
        before = np.moveaxis(held[..., q], -1, 0)
        held[..., q] = np.stack(multiply(list(before), list(np.moveaxis(turn, -1, 0))), axis=-1)
        return self._compared(held)

    def _held(self) -> Array:
        """Measured motion at the start of each run, repeated for each horizon, shape (w, h, 13)."""
        return np.repeat(self._measured[self._left][:, None, :], len(self._steps), axis=1)

    def _compared(
        self, motion: Array, watched: Array | None = None, begin: Array | None = None
    ) -> OpenLoop:
        """Errors of the motion at the horizons, shape (w, h, 13), against the aircraft's."""
        measured = np.stack([self._measured[self._left + k] for k in self._steps], axis=1)
        left_s = np.asarray(GRID_S * self._left, dtype=np.float64)
        return OpenLoop(
            left_s,
            apart(motion, measured),
            np.zeros((*motion.shape[:2], 0)) if watched is None else watched,
            np.zeros((len(motion), 0)) if begin is None else begin,
        )

    def _alone(self, slave: Slave, given: Array, taken: BoolArray, row: int) -> list[Array]:
        """Outputs at the horizons after a row; integrates from one change of an input to the next
        at once.

        Inputs that are not `taken`, shape (k,), are set to 0.
        """
        first = np.searchsorted(self._changes, row + 1)
        last = np.searchsorted(self._changes, row + self._steps[-1])
        stops = {*(self._changes[first:last] - row).tolist(), *self._steps}
        rows, now = [], 0
        for stop in sorted(stops):
            _step(slave, row + now, stop - now, given[row + now] * taken)
            now = stop
            if now in self._steps:
                slave.read_outputs()
                rows.append(slave.outputs.copy())
        return rows


def _step(slave: Slave, row: int, steps: int, inputs: Array) -> None:
    """Integrate from a row to a later one with the inputs of the first."""
    slave.inputs[:] = inputs
    slave.write_inputs()
    slave.step(row * GRID_S, steps * GRID_S)


def driving_inputs(
    flight: AnyFlight,
    vehicle: Vehicle,
    aligned: AlignedFlight,
    restarts: NDArray[np.intp],
    compensated: bool = False,
) -> NDArray[Any]:
    """Inputs of a driven twin at the start of each step of `GRID_S`, as FMPy expects them.

    A step that begins with `restart` ends at the given motion; hence the motion of the next row is
    given.

    Args:
        flight: Flight to replay.
        vehicle: Vehicle of the twin; if it has a pose delay, the measured poses are corrected for
            it.
        aligned: The flight on the grid of the twin.
        restarts: Rows, from 1 on, at which the twin is set to the measured motion, shape (k,);
            where the motion is unknown the twin continues open loop.
        compensated: Whether the twin has a compensator, which gets the phase of the flight.

    Returns:
        A row per grid point: One row per grid point: `time` from 0 on, commands or rotor speeds
            (with their derivatives, where the twin needs them) and voltage of the flight,
            `airframe.restart` and `airframe.restart.pos_x` to `airframe.restart.omega_z`; with a
            compensator also `compensator.phase`.
    """
    t_s = aligned.inputs.t_s
    given = {c: Signal(*flight.signal([c])).held(t_s)[:, 0] for c in aligned.inputs.columns}
    if VOLTAGE not in given and flight.has(VOLTAGE):
        given[VOLTAGE] = Signal(*flight.signal([VOLTAGE])).held(t_s)[:, 0]
    names = aligned.airframe.input_names
    measured = [n for n in names if n.startswith((SPIN_RATE, "rotor_"))]
    given |= {n: aligned.inputs.u[:, names.index(n)] for n in measured}
    ahead = np.vstack([true_motion(vehicle, aligned)[1:], np.full((1, len(RIGID)), np.nan)])
    known = np.isfinite(ahead).all(axis=1)
    given["restart"] = (np.isin(np.arange(len(t_s)) + 1, restarts) & known).astype(np.float64)
    given |= dict(zip((f"restart.{s}" for s in RIGID), np.nan_to_num(ahead).T, strict=True))
    columns = {PREFIX + name: values for name, values in given.items()}
    if compensated:
        columns["compensator.phase"] = phase_codes(aligned.phases).astype(np.float64)
    kinds = [(c, bool if c == f"{PREFIX}restart" else float) for c in columns]
    table = np.zeros(len(t_s), dtype=[("time", float), *kinds])
    table["time"] = GRID_S * np.arange(len(t_s))
    for name, values in columns.items():
        table[name] = values
    return table


def taken_by(slave: Slave, table: NDArray[Any]) -> tuple[list[str], Array]:
    """Columns of a table of `driving_inputs` that are inputs of a driven twin: names, and values,
    shape (n, k).

    The voltage is omitted for a twin that does not depend on it.
    """
    names = [n for n in table.dtype.names or () if n != "time"]
    if PREFIX + VOLTAGE not in slave.interface.ports:
        names = [n for n in names if n != PREFIX + VOLTAGE]
    return names, np.column_stack([table[n] for n in names]).astype(np.float64)


def _changes(table: NDArray[Any]) -> NDArray[np.intp]:
    """Rows at which an input changes that affects the open-loop twin."""
    names = [n for n in table.dtype.names or () if n != "time"]
    matter = [n for n in names if not n.startswith(f"{PREFIX}restart")]
    return np.flatnonzero(np.any([np.diff(table[n]) != 0 for n in matter], axis=0)) + 1


def _median_speed(motion: Array) -> float:
    """Median speed in rows of `RIGID`, m/s; 0 without rows."""
    velocity = motion[:, [RIGID.index(f"vel_{a}") for a in AXES]]
    return float(np.median(np.linalg.norm(velocity, axis=1))) if len(motion) else 0.0
