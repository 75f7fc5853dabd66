"""A flight and its twin on one grid: inputs, measured states, and times in the air.

In the air means carried by the rotors and above the resting place. The modelled thrust that carries
the vehicle is estimated from the flight, not from the weight of the vehicle file: thrust or mass of
the file may be wrong, which other modules estimate. Evidence of being in the air is, in this order,
the land detector of the log, its height, and a specific force that follows the thrust: on the
ground the legs carry the difference.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import Component
from ..component.rows import OverRows
from ..draft.consistency import consistency
from ..effects import EFFECTS, NoiseFloor, acting_late
from ..errors import LogError
from ..logs import AnyFlight
from ..logs.columns import ACC
from ..logs.samples import runs
from ..logs.stored import phases_at, rows_before
from ..physics.airframe import airframe
from ..physics.rotors import Drive
from ..physics.sensors.imu import imu
from ..representation import ShortRepr
from ..vehicle import Vehicle
from .measured import MeasuredMotion, measured_motion, signal_of
from .teacher_forced import (
    GRID_S,
    Inputs,
    InputSignals,
    RotorStates,
    choose_drive,
    hidden_of,
    measured_states,
)

Array = NDArray[np.float64]
LIFT_OFF_HEIGHT_M = 0.1
"""Height above the resting place from which a vehicle is airborne."""
CLEAR_HEIGHT_M = 0.5
"""Height above the lowest point from which a vehicle is in the air, wherever its resting place
is."""
CLEAR_S = 1.0
"""Shortest time above that height."""
_ROUNDING = 1e-9
"""Relative deviation below which a signal is constant: rounding of float64 sums."""
FOLLOWS, BLOCK_S, FEWEST_BLOCKS = 0.7, 0.25, 12
"""Correlation from which the specific force follows the thrust, length of the blocks whose means
are compared, and smallest number of blocks."""
LEAST_CARRY, TRUSTED_CARRY = 0.15, 1.5
"""Modelled thrust over weight below which no vehicle flies, however wrong the file (idling rotors);
largest error factor of the file that is tolerated here."""
START_S = 0.2
"""Start of a record, s, that decides whether it begins in the air. Made up."""


def starts_in_air(carried: NDArray[np.bool_], grounded: NDArray[np.bool_], step_s: float) -> bool:
    """Whether a record begins in the air.

    Args:
        carried: Whether the rotors carry half of the weight, from the first grid point on.
        grounded: Whether the land detector reports ground.
        step_s: Step of the grid.
    """
    soon = slice(None, max(1, round(START_S / step_s)))
    return bool(np.median(carried[soon])) and not grounded[0]


def carry(
    thrust_n: NDArray[np.floating[Any]],
    grounded: NDArray[np.bool_],
    height_m: Array,
    force: Callable[[], Array],
    step_s: float,
) -> float | None:
    """Modelled thrust that carries the vehicle in a flight, N, independent of the weight in its
    file; None: the flight does not show that it is in the air.

    Args:
        thrust_n: Modelled thrust, shape (n,).
        grounded: Whether the log reports ground, shape (n,).
        height_m: Height, NaN where unknown, shape (n,); empty without a position.
        force: Function that returns the specific force along the thrust, m/s^2, NaN where unknown,
            shape (n,); empty without an accelerometer.
        step_s: Step of the grid.
    """
    least = CLEAR_S / step_s
    if grounded.any() and np.sum(~grounded) > least:
        return float(np.median(thrust_n[~grounded]))
    above = clear(grounded, height_m, step_s)
    if above.any():
        return float(np.median(thrust_n[above]))
    along = force()
    if not len(along):
        return None
    block = max(round(BLOCK_S / step_s), 1)
    whole = len(along) // block * block
    pushed, along = (v[:whole].reshape(-1, block).mean(axis=1) for v in (thrust_n, along))
    strong = np.isfinite(along)
    strong &= pushed > np.quantile(pushed, 0.9, method="lower") / 2 if len(pushed) else False
    x, y = pushed[strong], along[strong]
    if len(x) < FEWEST_BLOCKS:
        return None
    x_apart, y_apart = x - np.mean(x), y - np.mean(y)
    sizes = float(np.sqrt(np.sum(x_apart**2) * np.sum(y_apart**2)))
    if not sizes > _ROUNDING * float(np.sqrt(np.sum(x**2) * np.sum(y**2))):
        return None  # one of them is constant
    return float(np.median(x)) if np.sum(x_apart * y_apart) / sizes > FOLLOWS else None


def clear(grounded: NDArray[np.bool_], height_m: Array, step_s: float) -> NDArray[np.bool_]:
    """Whether a flight is in the air by its height, shape (n,): above its lowest point for long
    enough, else nowhere; arguments as in `carry`."""
    known_m = height_m[np.isfinite(height_m)]
    if not len(known_m):
        return np.zeros(len(grounded), dtype=np.bool_)
    above = ~grounded & (height_m > np.quantile(known_m, 0.01) + CLEAR_HEIGHT_M)
    return np.asarray(above & (np.sum(above) > CLEAR_S / step_s))


def resting_height(height_m: Array, carried: NDArray[np.bool_]) -> float | None:
    """Height of the resting place, m: median height while the rotors carry nothing; None: not
    known."""
    rest = height_m[np.isfinite(height_m) & ~carried]
    return float(np.median(rest)) if len(rest) else None


def in_flight(
    carried: NDArray[np.bool_],
    grounded: NDArray[np.bool_],
    height_m: Array,
    resting_m: float | None,
) -> NDArray[np.bool_]:
    """Mask of the grid points in flight, shape (n,).

    Args:
        carried: Whether the rotors carry the vehicle, shape (n,).
        grounded: Whether the log reports ground, shape (n,).
        height_m: Height, shape (n,); not used without a resting place.
        resting_m: Height of the resting place; None: height is not used.
    """
    airborne = carried & ~grounded
    if resting_m is not None:
        airborne &= ~(height_m < resting_m + LIFT_OFF_HEIGHT_M)
    return np.asarray(airborne)


def why_grounded(motion: MeasuredMotion, said: bool) -> str:
    """Remedy for a flight without a sample in the air, `said` to be on the ground throughout."""
    if said:
        return "the whole flight is in phase ground."
    if motion.position is not None:
        down = motion.position.values[:, 2]
        if (
            np.max(down) - down[0] > 5 * LIFT_OFF_HEIGHT_M
            and down[0] - np.min(down) < LIFT_OFF_HEIGHT_M
        ):
            return (
                f"pos_z rises to {np.max(down):.2f} m and never goes below its start. It counts "
                f"down: is it an altitude?"
            )
    return (
        "its rotors never carry half of the weight more than 0.1 m above the resting place. Check "
        "the vehicle file, the scale of the commands and the length of the record."
    )


def rotor_thrust(body: Component, rotors: int) -> OverRows:
    """Function for the total thrust in still air, N, shape (n, 1), from states and inputs."""
    moving = [i for i, s in enumerate(body.states) if s.name.startswith(("rotor_", "effort_"))]
    r, u = ca.SX.sym("r", len(moving)), ca.SX.sym("u", len(body.inputs))
    p = body.parameter_values()
    x = ca.SX(body.initial(body.input_values(), p))
    x[moving] = r
    each = [body.output_names.index(f"thrust_{i}") for i in range(1, rotors + 1)]
    total = ca.sum1(body.outputs(x, u, p)[each])
    return OverRows(ca.Function("thrust", [r, u], [ca.densify(total)]), 2)


LONGEST_FLIGHT_S = 10_000.0
"""Longest flight that is aligned at once: memory holds one signal of the flight, or all states at
200 Hz."""
AT_LIMIT = 1e-3
"""Distance of a command from 0 or 1 at which it is saturated and does not determine the motor's
speed."""
BLOCK_ROWS = 1 << 18
"""Rows of a block: some 70 MB with inputs and states."""


@dataclass(frozen=True, slots=True)
class AlignedFlight(ShortRepr):
    """A flight on the grid of its twin.

    Attributes:
        airframe: Airframe with the vehicle's effects, except delays of commands: these are applied
            to the inputs.
        imu: IMU with the vehicle's effects, but without noise.
        inputs: Inputs of the airframe, commands at their time of arrival.
        motion: Measured motion.
        states: States of the airframe, shape (n, n_x); NaN where not measured.
        phases: Phase of flight, shape (n,).
        airborne: Whether the vehicle is in the air, shape (n,).
        notes: Notes on assumptions and omissions.
    """

    airframe: Component
    imu: Component
    inputs: Inputs
    motion: MeasuredMotion
    states: Array
    phases: NDArray[np.str_]
    airborne: NDArray[np.bool_]
    notes: tuple[str, ...]

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """Whether the command of any rotor is at an end of its range, shape (n,)."""
        columns = [i for i, n in enumerate(self.inputs.columns) if n.startswith("cmd_")]
        commands = self.inputs.u[:, columns]
        return np.asarray(np.any((commands <= AT_LIMIT) | (commands >= 1 - AT_LIMIT), axis=1))

    def predicted(self, *stems: str) -> tuple[Array, ...]:
        """Outputs of the airframe at every grid point whose names begin with each stem.

        Arrays of shape (n, k).
        """
        y = self.airframe.outputs_along(self.states, self.inputs.u)
        names = self.airframe.output_names
        return tuple(y[:, [i for i, n in enumerate(names) if n.startswith(s)]] for s in stems)


def align_flight(
    flight: AnyFlight,
    vehicle: Vehicle,
    grid_s: float = GRID_S,
    effects: Iterable[str] = (),
    motion: MeasuredMotion | None = None,
) -> AlignedFlight:
    """Put a flight onto the grid of a twin, in one piece.

    Args:
        flight: Flight from `twin.logs.read_flight`.
        vehicle: Vehicle from `twin.vehicle_file.load_vehicle`.
        grid_s: Step of the grid, s; also the step of integration of unmeasured states.
        effects: Effects to build into the airframe, switched off.
        motion: Measured motion of the flight, where it is known already.

    Raises:
        LogError: The flight lacks signals that the vehicle needs, is too short, or is never in the
            air.
    """
    alignment = Alignment(flight, vehicle, grid_s, effects, motion)
    (block,) = alignment.blocks([0, alignment.rows])
    return alignment.piece(block, alignment.airborne([block]), alignment.phases(0, alignment.rows))


@dataclass(frozen=True, slots=True)
class Block(ShortRepr):
    """Consecutive rows of the grid of a twin.

    Attributes:
        first: Number of the first row.
        inputs: Inputs of the airframe.
        states: States of the airframe, shape (n, n_x); NaN where not measured.
    """

    first: int
    inputs: Inputs
    states: Array

    @property
    def end(self) -> int:
        """Number of the row after the last."""
        return self.first + len(self.states)


class TwinGrid:
    """Grid points of a twin, one block after another: inputs, and states that are measured or
    integrated along the measured ones."""

    def __init__(self, vehicle: Vehicle, airframe: Component, step_s: float) -> None:
        self._vehicle, self._airframe = vehicle, airframe
        self._rotors = RotorStates(airframe, step_s)
        self._hidden = hidden_of(airframe, step_s)

    def block(self, signals: InputSignals, motion: MeasuredMotion, first: int, t_s: Array) -> Block:
        """The next block of rows.

        Args:
            signals: Input signals of the flight, or of its last seconds.
            motion: Measured motion of the same flight.
            first: Number of the first row.
            t_s: Times of the rows, shape (n,); n may be 1.
        """
        u = signals.at(t_s)
        inputs = Inputs(signals.columns, t_s, u, self._rotors.along(u), signals.notes)
        return Block(first, inputs, measured_states(self._airframe, motion, inputs, self._hidden))


def components_of(
    vehicle: Vehicle, drive: Drive, effects: Iterable[str] = ()
) -> tuple[Component, Component]:
    """Airframe and IMU as in `AlignedFlight`.

    Args:
        vehicle: Numbers of the aircraft.
        drive: Input of its rotors.
        effects: Effects to build into the airframe, switched off.
    """
    body = airframe(vehicle, drive, effects)
    switches = {v.name for v in body.parameters}
    late = [f"{e.name}.enabled" for e in acting_late() if e.name in vehicle.effects]
    off = {name: 0.0 for name in late if name in switches}
    return body.with_starts(off), _quiet(imu(vehicle))


class Alignment:
    """A flight and a vehicle to be aligned on the twin's grid: whole, or in blocks of rows with the
    same result.

    Attributes:
        airframe: Airframe as in `AlignedFlight`.
        imu: IMU as in `AlignedFlight`.
        motion: Measured motion.
        rows: Number of grid points.
        step_s: Step of the grid.
        notes: Notes on assumptions and omissions.
        carries: Modelled thrust over weight in the air, where `airborne` found a value far from 1.
    """

    def __init__(
        self,
        flight: AnyFlight,
        vehicle: Vehicle,
        grid_s: float = GRID_S,
        effects: Iterable[str] = (),
        motion: MeasuredMotion | None = None,
    ) -> None:
        """Arguments and errors as in `align_flight`; `airborne` raises where the vehicle is never
        in the air."""
        early = flight.filter_delays_s  # an IMU that steps in time cannot be early by a delay
        punctual = replace(
            vehicle,
            accel_cutoff_hz=None if "acc" in early else vehicle.accel_cutoff_hz,
            gyro_cutoff_hz=None if "gyro" in early else vehicle.gyro_cutoff_hz,
        )
        self.airframe, self.imu = components_of(punctual, choose_drive(flight, vehicle), effects)
        time = flight.time_s
        if len(time) < 2 or time[-1] - time[0] < 2 * grid_s:
            raise LogError(f"{flight.name}: too short: {len(time)} samples.")
        if time[-1] - time[0] > LONGEST_FLIGHT_S:
            raise LogError(
                f"{flight.name}: {time[-1] - time[0]:.0f} s long, more than "
                f"{LONGEST_FLIGHT_S:.0f} s. Cut the log, or check its clock."
            )
        self._first = round(float(time[0]) / grid_s)
        self.rows = int(np.floor(float(time[-1]) / grid_s + 1e-6)) + 1 - self._first
        self._flight, self._vehicle, self._grid_s = flight, vehicle, grid_s
        start_s, next_s = self.times(0, 2)
        self.step_s = float(next_s - start_s)
        self.motion = motion or measured_motion(flight)
        self._signals = InputSignals(flight, vehicle, self.airframe)
        warnings = consistency(flight, vehicle).warnings
        self.notes = (*warnings, *self.motion.notes, *self._signals.notes)
        self.carries = 1.0

    def times(self, first: int, end: int) -> Array:
        """Times of some rows, s."""
        rows = np.arange(self._first + first, self._first + end)
        return np.asarray(rows.astype(np.float64) * self._grid_s)

    def phases(self, first: int, end: int) -> NDArray[np.str_]:
        """Phases of some rows, as from `phases_at`."""
        return phases_at(self._flight, self.times(first, end))

    def spans(self) -> tuple[tuple[str, float, float], ...]:
        """Name, first and last time of each phase on the grid."""
        codes_of_table, names = self._flight.phase_codes
        codes = np.empty(self.rows, dtype=codes_of_table.dtype)
        for a, b in pairwise(self.edges(BLOCK_ROWS)):
            codes[a:b] = codes_of_table[self._table_rows(a, b)]
        spans = [(str(names[codes[a]]), a, min(b, self.rows - 1)) for a, b in runs(codes)]
        return tuple(
            (name, float(self.times(a, a + 1)[0]), float(self.times(b, b + 1)[0]))
            for name, a, b in spans
            if name
        )

    def _table_rows(self, first: int, end: int) -> NDArray[np.intp]:
        """The last row of the table at or before each row."""
        return rows_before(self._flight, self.times(first, end))

    def edges(self, rows: int) -> list[int]:
        """Row numbers at which blocks of limited size begin, and the end of the last one."""
        return [*range(0, self.rows, rows), self.rows]

    def blocks(self, edges: Sequence[int]) -> Iterator[Block]:
        """The rows between neighbouring edges, from the first row on, without gaps."""
        grid = TwinGrid(self._vehicle, self.airframe, self.step_s)
        for first, end in pairwise(edges):
            yield grid.block(self._signals, self.motion, first, self.times(first, end))

    def airborne(self, blocks: Iterable[Block]) -> NDArray[np.bool_]:
        """Mask of the grid points in flight: not reported on the ground, carried by the rotors, and
        above the resting place where the record starts at rest and contains a position.

        Rotors carry the vehicle where the modelled thrust is at least half of that which carries it
        in this flight (`carry`).

        Args:
            blocks: All rows.

        Raises:
            LogError: There are none, or it flies at almost none of the thrust of the file.
        """
        weight = self._vehicle.mass_kg * self._vehicle.gravity_m_s2
        thrust = rotor_thrust(self.airframe, self._vehicle.rotors.count)
        pushing = np.zeros(self.rows, dtype=np.float32)
        grounded = np.zeros(self.rows, dtype=np.bool_)
        height = np.full(self.rows if self.motion.position is not None else 0, np.nan)
        down = [s.name for s in self.airframe.states].index("pos_z")
        codes, names = self._flight.phase_codes
        for block in blocks:
            rows = slice(block.first, block.end)
            inputs = block.inputs
            pushing[rows] = thrust(inputs.rotor_states, inputs.u)[:, 0]
            grounded[rows] = (names == "ground")[codes[self._table_rows(block.first, block.end)]]
            if len(height):
                height[rows] = -block.states[:, down]
        settled = self._flight.settled
        if settled is None:  # a live recording used the weight of the file
            self.carries = self._carries(pushing, grounded, height, weight)
        carried = pushing > 0.5 * weight * self.carries
        if not len(height) or starts_in_air(carried, grounded, self.step_s):
            resting_m = None
        elif settled is not None:
            resting_m = None if settled.resting_down_m is None else -settled.resting_down_m
        else:
            resting_m = resting_height(height, carried)
        airborne = in_flight(carried, grounded, height, resting_m)
        if not airborne.any():
            raise LogError(
                f"{self._flight.name}: never airborne with {self._vehicle.name}: "
                f"{why_grounded(self.motion, bool(grounded.all()))}"
            )
        return np.asarray(airborne)

    def _carries(
        self,
        pushing: NDArray[np.float32],
        grounded: NDArray[np.bool_],
        height_m: Array,
        weight_n: float,
    ) -> float:
        """Modelled thrust over the weight of the file in the air; 1 where that is nearly so, or the
        flight does not show it.

        Raises:
            LogError: Land detector and height report flight at almost no modelled thrust.
        """

        def force() -> Array:
            if not self._flight.has(*ACC):
                return np.zeros(0)
            return -signal_of(self._flight, ACC[2:]).at(self.times(0, self.rows))[:, 0]

        own = carry(pushing, grounded, height_m, force, self.step_s)
        share = 1.0 if own is None else own / weight_n
        if share < LEAST_CARRY and grounded.any() and clear(grounded, height_m, self.step_s).any():
            raise LogError(
                f"{self._flight.name}: {self._vehicle.name} carries {100 * share:.2g} % of its "
                f"weight at the commands that this flight flies with: another vehicle, mass or "
                f"thrust map? `uavtwin vehicle draft` writes a vehicle file from the flight."
            )
        near = share < LEAST_CARRY or 1 / TRUSTED_CARRY < share < TRUSTED_CARRY
        return 1.0 if near else share

    def piece(
        self, block: Block, airborne: NDArray[np.bool_], phases: NDArray[np.str_]
    ) -> AlignedFlight:
        """A block as a separate aligned flight.

        Args:
            block: Block of rows.
            airborne: Whether the vehicle is in the air, for these rows.
            phases: Phase of flight of these rows.
        """
        notes = (*self.notes, *self.left_out(airborne))
        return AlignedFlight(
            self.airframe,
            self.imu,
            block.inputs,
            self.motion,
            block.states,
            phases,
            airborne,
            notes,
        )

    def left_out(self, airborne: NDArray[np.bool_]) -> list[str]:
        """Notes on the time on the ground, and on modelled thrust over weight in the air where it
        is far from 1."""
        on_ground = float(np.mean(~airborne))
        first_s, last_s = self.times(0, 1)[0], self.times(self.rows - 1, self.rows)[0]
        seconds = on_ground * (last_s - first_s)
        notes = [f"{seconds:.1f} s on the ground are left out"] if on_ground > 0 else []
        if self.carries != 1.0:
            notes.append(
                f"in the air the rotors of {self._vehicle.name} carry "
                f"{100 * self.carries:.0f} % of its weight: check its mass, its thrust and the "
                f"scale of the commands"
            )
        return notes


def _quiet(sensor: Component) -> Component:
    """The sensor without its noise: its mean reading is compared with the flight."""
    louder = (e.name for e in EFFECTS.values() if isinstance(e.observable_as, NoiseFloor))
    ends = ("_noise", "_bias_walk", *(f"{name}.enabled" for name in louder))
    noise = [v.name for v in sensor.parameters if v.name.endswith(ends)]
    return sensor.with_starts(dict.fromkeys(noise, 0.0))
