"""A flight beside its twin: the inputs and the measured states of a flight on the twin's grid."""

from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import Component
from ..component.rows import OverRows
from ..effects import EFFECTS, NoiseFloor, acting_late
from ..errors import LogError
from ..logs import Flight
from ..physics.airframe import airframe
from ..physics.sensors.imu import imu
from ..representation import short_repr
from ..vehicle import Vehicle
from .measured import MeasuredMotion, measured_motion
from .teacher_forced import GRID_S, Inputs, airframe_inputs, choose_drive, measured_states

Array = NDArray[np.float64]
LONGEST_FLIGHT_S = 3600.0
"""Everything is held in memory on a 1 ms grid, about 0.5 MB per second of flight."""
LIFT_OFF_HEIGHT_M = 0.1
"""Above its resting place by this much, a vehicle counts as airborne."""


@dataclass(frozen=True, slots=True)
class AlignedFlight:
    """A flight on the grid of its twin.

    Attributes:
        airframe: With the vehicle's effects, but for those by which commands act late: they are
            in the inputs.
        imu: With the vehicle's effects, but without noise.
        inputs: Of the airframe, commands as they arrive.
        motion: Measured motion.
        states: Of the airframe, shape (n, n_x); NaN where nothing was measured.
        phases: Of the flight, shape (n,).
        airborne: Shape (n,).
        notes: What was assumed or left out.
    """

    airframe: Component
    imu: Component
    inputs: Inputs
    motion: MeasuredMotion
    states: Array
    phases: NDArray[np.str_]
    airborne: NDArray[np.bool_]
    notes: tuple[str, ...]

    __repr__ = short_repr

    def predicted(self, *stems: str) -> tuple[Array, ...]:
        """Outputs of the airframe at every grid point, for each stem those that begin with it.

        Shape (n, k) each.
        """
        y = self.airframe.outputs_along(self.states, self.inputs.u)
        names = self.airframe.output_names
        return tuple(y[:, [i for i, n in enumerate(names) if n.startswith(s)]] for s in stems)


def align_flight(
    flight: Flight, vehicle: Vehicle, grid_s: float = GRID_S, effects: Iterable[str] = ()
) -> AlignedFlight:
    """Put a flight onto the grid of a twin.

    Args:
        flight: As read by `twin.logs.read_flight`.
        vehicle: As read by `twin.vehicle.file.load_vehicle`.
        grid_s: Step of the grid, s; unmeasured states are integrated with it.
        effects: Effects to build into the airframe, switched off.

    Raises:
        LogError: The flight lacks what the vehicle needs, is too short, or never flies.
    """
    body = airframe(vehicle, choose_drive(flight, vehicle), effects)
    switches = {v.name for v in body.parameters}
    late = [f"{e.name}.enabled" for e in acting_late() if e.name in vehicle.effects]
    body = body.with_starts({name: 0.0 for name in late if name in switches})
    time = flight.table["time"].to_numpy(dtype=np.float64)
    if len(time) < 2 or time[-1] - time[0] < 2 * grid_s:
        raise LogError(f"{flight.name}: too short: {len(time)} samples.")
    if time[-1] - time[0] > LONGEST_FLIGHT_S:
        raise LogError(
            f"{flight.name}: {time[-1] - time[0]:.0f} s long, more than {LONGEST_FLIGHT_S:.0f} s. "
            f"Cut the log, or check its clock."
        )
    first = round(float(time[0]) / grid_s)
    last = int(np.floor(float(time[-1]) / grid_s + 1e-6))
    t: Array = np.arange(first, last + 1).astype(np.float64) * grid_s
    motion = measured_motion(flight)
    inputs = airframe_inputs(flight, vehicle, body, t)
    phases = _phases(flight, t)
    airborne = _airborne(vehicle, body, inputs, motion, phases)
    if not airborne.any():
        raise LogError(
            f"{flight.name}: never airborne with {vehicle.name}: {_why_grounded(motion, phases)}"
        )
    states = measured_states(body, motion, inputs)
    on_ground = float(np.mean(~airborne))
    notes = list(motion.notes + inputs.notes)
    if on_ground > 0:
        notes.append(f"{on_ground * (t[-1] - t[0]):.1f} s on the ground are left out")
    return AlignedFlight(
        body, _quiet(imu(vehicle)), inputs, motion, states, phases, airborne, tuple(notes)
    )


def _quiet(sensor: Component) -> Component:
    """The sensor without its noise: what it reads on average is compared with the flight."""
    louder = (e.name for e in EFFECTS.values() if isinstance(e.seen_as, NoiseFloor))
    ends = ("_noise", "_bias_walk", *(f"{name}.enabled" for name in louder))
    noise = [v.name for v in sensor.parameters if v.name.endswith(ends)]
    return sensor.with_starts(dict.fromkeys(noise, 0.0))


def _phases(flight: Flight, t_s: Array) -> NDArray[np.str_]:
    """Phase of the last row at or before each time, "" where the flight says nothing."""
    if "phase" not in flight.table:
        return np.full(len(t_s), "", dtype="<U8")
    rows = np.searchsorted(flight.table["time"].to_numpy(), t_s + 1e-9, side="right") - 1
    text = flight.table["phase"].fillna("").to_numpy(dtype="<U8")
    return np.asarray(text[np.maximum(rows, 0)])


def _why_grounded(motion: MeasuredMotion, phases: NDArray[np.str_]) -> str:
    """Way out for a flight without a sample in the air."""
    if np.all(phases == "ground"):
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


def _rotor_thrust(body: Component, rotors: int, inputs: Inputs) -> Array:
    """Thrust of all rotors together in still air, N, shape (n,)."""
    moving = [i for i, s in enumerate(body.states) if s.name.startswith(("rotor_", "effort_"))]
    r, u = ca.SX.sym("r", len(moving)), ca.SX.sym("u", len(body.inputs))
    p = body.parameter_values()
    x = ca.SX(body.initial(inputs.u[0], p))
    x[moving] = r
    each = [body.output_names.index(f"thrust_{i}") for i in range(1, rotors + 1)]
    total = ca.sum1(body.outputs(x, u, p)[each])
    thrust = OverRows(ca.Function("thrust", [r, u], [ca.densify(total)]), 2)
    return thrust(inputs.rotor_states, inputs.u)[:, 0]


def _airborne(
    vehicle: Vehicle,
    body: Component,
    inputs: Inputs,
    motion: MeasuredMotion,
    phases: NDArray[np.str_],
) -> NDArray[np.bool_]:
    """Grid points in flight: not said to be on the ground, carried by the rotors, and above the
    resting place where the record starts at rest and holds a position."""
    thrust = _rotor_thrust(body, vehicle.rotors.count, inputs)
    carried = thrust > 0.5 * vehicle.mass_kg * vehicle.gravity_m_s2
    airborne = carried & (phases != "ground")
    starts_in_air = (
        bool(np.median(carried[: max(1, round(0.2 / inputs.step_s))])) and phases[0] != "ground"
    )
    if motion.position is not None and not starts_in_air:
        height = -motion.position.at(inputs.t_s)[:, 2]
        rest = height[np.isfinite(height) & ~carried]
        if len(rest):
            airborne &= ~(height < float(np.median(rest)) + LIFT_OFF_HEIGHT_M)
    return np.asarray(airborne, dtype=np.bool_)
