"""A plan flown by a vehicle with its effects, recorded as the flights so far were."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...component import Component
from ...component.sampled import noiseless_outputs
from ...flight.closed_loop import STEP_S, fly, standing
from ...flight.control.lqr_cascade import controller
from ...flight.stability import FARTHEST_ARMS, FARTHEST_M, STEEPEST_RAD
from ...logs import Flight
from ...logs.columns import MAX_MOTORS, POS, QUAT, VEL, motor_columns
from ...physics.airframe import airframe
from ...physics.sensors.barometer import barometer
from ...physics.sensors.imu import imu
from ...physics.sensors.magnetometer import magnetometer
from ...vehicle import Vehicle
from ..model.channels import GRID_HZ
from .manoeuvres import Plan

Array = NDArray[np.float64]
EVERY = round(1 / (GRID_HZ * STEP_S))
"""Steps of the simulation per row of a record."""
_LATE = {
    "command_delay": {
        *motor_columns("cmd", MAX_MOTORS),
        *motor_columns("rotor", MAX_MOTORS),
    },
    "position_delay": {*POS, *VEL, *QUAT},
}
"""Effects that shift a record, and the columns that they shift."""


def simulate_flight(
    flown: Plan, vehicle: Vehicle, plant: Vehicle, like: Sequence[Flight], voltage: float = 1.0
) -> Flight:
    """Fly a plan in closed loop and record it without noise.

    The controller reads the true motion. A late command is recorded early and a late pose late;
    neither reaches the controller. The record ends where the vehicle is lost.

    Args:
        flown: Setpoints.
        vehicle: What the controller is designed for.
        plant: What really flies, with its effects.
        like: Flights whose columns are recorded, at their rates, as far as the twin has them.
        voltage: Of the battery, over that of these flights.
    """
    punctual = _punctual(plant)
    body = airframe(punctual)
    body = body.with_starts(standing(body, punctual))
    volts = volts_of(like, vehicle) * voltage
    held = {"vbat_v": volts} if "vbat_v" in body.input_names else {}
    states, inputs = fly(body, controller(_punctual(vehicle)), flown.setpoints, held)
    end = _lost(flown, body, states, plant)
    states, inputs, phases = states[:end:EVERY], inputs[:end:EVERY], flown.phases[:end:EVERY]
    truth = body.outputs_along(states, inputs)
    known = dict(zip(body.output_names, truth.T, strict=True))
    known |= dict(zip(body.input_names, inputs.T, strict=True))
    known["vbat_v"] = np.full(len(states), volts)
    late_s = {e: plant.effects[e]["delay_s"] for e in _LATE if e in plant.effects}
    for effect, delay in late_s.items():
        for column in known.keys() & _LATE[effect]:
            known[column] = _later(known[column], delay if effect == "position_delay" else -delay)
    for sensor in (imu(punctual), magnetometer(punctual), barometer(punctual)):
        if not any(f.has(*sensor.output_names[:1]) for f in like):
            continue
        read = np.tile(sensor.input_values(), (len(states), 1))
        for i, name in enumerate(sensor.input_names):
            read[:, i] = known.get(name, read[:, i])
        shown = noiseless_outputs(sensor, read, 1 / GRID_HZ)
        known |= dict(zip(sensor.output_names, shown.T, strict=True))
    table = pd.DataFrame({"time": np.arange(len(states)) / GRID_HZ})
    for column, values in known.items():
        periods = [_period(f, column) for f in like if f.has(column)]
        if periods:
            recorded = np.arange(len(states)) % max(1, round(min(periods) * GRID_HZ)) == 0
            table[column] = np.where(recorded, values, np.nan)
    table["phase"] = phases
    return Flight("next", table)


def _lost(flown: Plan, body: Component, states: Array, plant: Vehicle) -> int:
    """Number of rows until the vehicle tumbles or strays from its setpoints."""
    column = [s.name for s in body.states].index
    off = states[:, [column(f"pos_{a}") for a in "xyz"]] - flown.setpoints[:, :3]
    tilt = 2 * np.arcsin(np.hypot(states[:, column("q_x")], states[:, column("q_y")]).clip(0, 1))
    far = max(FARTHEST_M, FARTHEST_ARMS * plant.arm_m)
    near = (np.linalg.norm(off, axis=1) < far) & (tilt < STEEPEST_RAD)
    near |= np.array([phase == "ground" for phase in flown.phases])
    return len(near) if near.all() else int(np.argmin(near))


def volts_of(flights: Sequence[Flight], vehicle: Vehicle) -> float:
    """Median battery voltage of flights, that of the vehicle where none says it."""
    read = [f.signal(["vbat_v"])[1] for f in flights if f.has("vbat_v")]
    return float(np.median(np.concatenate(read))) if read else vehicle.voltage_v


def _punctual(vehicle: Vehicle) -> Vehicle:
    """The same without the delays that a record shows and a flight does not."""
    return vehicle.with_effects({k: v for k, v in vehicle.effects.items() if k not in _LATE})


def _later(values: Array, delay_s: float) -> Array:
    t = np.arange(len(values)) / GRID_HZ
    return np.interp(t - delay_s, t, values)


def _period(flight: Flight, column: str) -> float:
    """Median time between two samples, s."""
    return float(np.median(np.diff(flight.signal([column])[0])))
