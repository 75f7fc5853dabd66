"""From cases to flights, vehicle files and truth files.

How large a hidden effect shows, without noise: readings of the flight minus those of the
aircraft as the vehicle file has it, in the same true motion and with the same commands.

How clearly one of many hidden effects shows: what it alone changes in the readings of a flight.

The flight is the one with all effects. At its true motion and commands the readings of the aircraft
with this one effect, less those of the aircraft without any, by channel, rms in the air, over what
one reading is uncertain by: its noise in the band of the residuals and, where flights have days,
the constant of a day.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.polynomial.polynomial import polyval
from scipy.signal import lfilter

from twin.logs.autopilot import Autopilot, setpoints_of_mission

from .cases import SENSORS, Case, Conditions
from .hiding import Number, Truth
from .planning import Plan, aircraft_of, hidden, missions_of, plan, sizes
from .plants.aircraft import NOISE, Aircraft, Noise, vehicle_toml
from .plants.kinds import EFFECTS, PLANTS
from .plants.missions import CONTROL_HZ, Setpoints
from .plants.own.flight import STEPS, Trace, fly
from .plants.own.parameters import FIELD_T, GRAVITY_M_S2, STEP_S, Array, Batch, Parameters
from .plants.own.physics import Dynamics, Layout, Simulator, motion, own_dynamics, rotation, to_body
from .plants.sensing import (
    accelerometer,
    barometer,
    flight_table,
    gyroscope,
    magnetometer,
    measured_pose,
)
from .realism import (
    ACCEL_BIAS_M_S2,
    HEADING_RAD,
    PRESSURE_PA,
    as_logged,
    mean_deviations,
    seen_from,
)

UNITS = {
    "acc": "m/s^2",
    "angacc": "rad/s^2",
    "gyro": "rad/s",
    "mag": "T",
    "baro": "Pa",
    "pos": "m",
    "vel": "m/s",
    "att": "rad",
}
AIRBORNE_M = 0.1


def true_gap(
    aircraft: Aircraft,
    plant: Parameters,
    trace: Trace,
    i: int,
    dynamics: Dynamics = own_dynamics,
) -> dict[str, Array]:
    """Residuals by channel of the i-th flight over its samples in the air, shape (m,)."""
    nominal = aircraft.nominal
    truth = trace.truth[:, :, i].T
    expected, alpha = _nominal(aircraft, truth, trace.command[:, :, i].T, dynamics)
    pose = measured_pose(plant, trace, i)
    inverse = truth[6:10] * np.array([1.0, -1, -1, -1])[:, None]
    residual = {
        "acc": accelerometer(plant, trace.imu_force[:, :, i].T) - expected,
        "angacc": truth[13:16] - alpha,
        "gyro": gyroscope(plant, trace, i) - truth[10:13],
        "mag": magnetometer(plant, trace, i)
        - to_body(rotation(truth[6:10]), np.array(FIELD_T)[:, None]),
        "baro": (barometer(plant, trace, i) - barometer(nominal, trace, i))[None],
        "pos": pose[:3] - truth[:3],
        "vel": pose[3:6] - truth[3:6],
        "att": 2 * _vector_part(inverse, pose[6:]),
    }
    airborne = -truth[2] > nominal.leg + AIRBORNE_M
    names = {
        name: [name] if len(rows) == 1 else [f"{name}_{a}" for a in "xyz"]
        for name, rows in residual.items()
    }
    return {
        channel: row[airborne]
        for name, rows in residual.items()
        for channel, row in zip(names[name], rows, strict=True)
    }


def gap_json(flights: list[dict[str, Array]]) -> dict[str, dict[str, float | str]]:
    """Rms by channel over several flights."""
    pooled = {c: np.concatenate([f[c] for f in flights]) for c in flights[0]}
    return {
        channel: {
            "unit": UNITS[channel.split("_")[0]],
            "rms": float(f"{np.sqrt(np.mean(values**2)):.6g}"),
        }
        for channel, values in pooled.items()
    }


def _nominal(
    aircraft: Aircraft, truth: Array, command: Array, dynamics: Dynamics
) -> tuple[Array, Array]:
    """Specific force at the accelerometer and angular acceleration of the aircraft of the file."""
    nominal = aircraft.nominal
    batch, layout = Batch([nominal]), Layout(len(command))
    x = np.zeros((layout.size, truth.shape[1]))
    x[:13] = truth[:13]
    x[layout.rope][2] = 1.0
    x[layout.charge] = 1.0
    target = polyval(command, aircraft.speed_of_command or (nominal.speed_0, nominal.speed_1))
    stay = float(np.exp(-1 / (CONTROL_HZ * nominal.lag)))
    begin = np.full((len(command), 1), nominal.speed_0)
    speed, _ = lfilter([0.0, 1 - stay], [1.0, -stay], target, axis=1, zi=begin)
    x[layout.rotor] = speed
    at = motion(batch, layout, x, command, np.zeros((3, 1)), 0.0, dynamics)
    return at.imu_force, at.angular_acceleration


def _vector_part(a: Array, b: Array) -> Array:
    """Vector part of the product of two quaternions, scalar part made positive."""
    flip = np.where((a[0] * b[0] - (a[1:] * b[1:]).sum(axis=0)) < 0, -1.0, 1.0)
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    return np.asarray(flip * np.stack([x, y, z]))


_BAND_HZ = 18.0
"""Of the residuals."""
_LEFT = float(np.sqrt(2 * _BAND_HZ / CONTROL_HZ))
"""Of white noise of the IMU in that band."""
_PER_S = 2 * np.pi * _BAND_HZ / np.sqrt(3)
"""Rms of the derivative of noise in that band over that of the noise."""


def shown(
    aircraft: Aircraft,
    alone: Parameters,
    trace: Trace,
    i: int,
    noise: Noise,
    conditions: Conditions,
    dynamics: Dynamics = own_dynamics,
) -> float:
    """Largest ratio of a channel that the log has, for the i-th flight of a trace."""
    airborne = -trace.truth[:, 2, i] > aircraft.nominal.leg + AIRBORNE_M
    changes = _changes(aircraft, alone, trace, i, dynamics)
    uncertain = _uncertain(noise, conditions)
    gone = SENSORS.get(conditions.without, ())
    return max(
        float(np.sqrt(np.mean(row[airborne] ** 2))) / uncertain[name]
        for name, rows in changes.items()
        if not name.startswith(gone or ("-",))
        for row in rows
    )


def _changes(
    aircraft: Aircraft, alone: Parameters, trace: Trace, i: int, dynamics: Dynamics
) -> dict[str, Array]:
    """Readings with the effect less those without, rows over time."""
    nominal, truth = aircraft.nominal, trace.truth[:, :, i].T
    imu_force, turning = _moved(aircraft, alone, trace, i, dynamics)
    imu_force_0, turning_0 = _moved(aircraft, nominal, trace, i, dynamics)
    late = alone.imu_delay * STEP_S
    rates, pose_late = truth[10:13], alone.position_delay * STEP_S
    acceleration = np.gradient(truth[3:6], 1 / CONTROL_HZ, axis=1)
    return {
        "acc_": accelerometer(alone, imu_force)
        - accelerometer(nominal, imu_force_0)
        - late * np.gradient(imu_force_0, 1 / CONTROL_HZ, axis=1),
        "gyro_": (alone.gyro_scale - 1)[:, None] * rates
        + alone.gyro_bias[:, None]
        - late * truth[13:16],
        "turn_": turning - turning_0,
        "mag_": magnetometer(alone, trace, i) - magnetometer(nominal, trace, i),
        "baro_": (barometer(alone, trace, i) - barometer(nominal, trace, i))[None],
        "pos_": -pose_late * truth[3:6],
        "vel_": -pose_late * acceleration,
        "att_": -pose_late * alone.late_attitude * rates,
    }


def _uncertain(noise: Noise, conditions: Conditions) -> dict[str, float]:
    """Of one reading, by channel."""
    day = float(conditions.days)
    north = float(np.hypot(*FIELD_T[:2]))
    return {
        "acc_": float(np.hypot(_LEFT * noise.accel, day * ACCEL_BIAS_M_S2)),
        "gyro_": _LEFT * noise.gyro,
        "turn_": _LEFT * noise.gyro * float(_PER_S),
        "mag_": float(np.hypot(noise.mag, day * HEADING_RAD * north)),
        "baro_": float(np.hypot(noise.baro, day * PRESSURE_PA)),
        "pos_": noise.position,
        "vel_": noise.velocity,
        "att_": noise.attitude,
    }


def _moved(
    aircraft: Aircraft, p: Parameters, trace: Trace, i: int, dynamics: Dynamics
) -> tuple[Array, Array]:
    """Specific force at the accelerometer and angular acceleration of `p` in the flown motion."""
    truth, command = trace.truth[:, :, i].T, trace.command[:, :, i].T
    batch, layout = Batch([p]), Layout(len(command))
    x = np.zeros((layout.size, truth.shape[1]))
    x[:13] = truth[:13]
    x[layout.rope][2] = 1.0
    current, voltage = truth[16:18]
    x[layout.charge] = (voltage - p.empty_v + p.resistance * current) / (p.full_v - p.empty_v)
    steps = np.arange(command.shape[1]) - p.command_delay / STEPS
    command = np.array([np.interp(steps, np.arange(len(row)), row) for row in command])
    target = polyval(command, aircraft.speed_of_command or (p.speed_0, p.speed_1))
    target = target * (voltage / p.reference_v) ** p.voltage_exponent
    stay = float(np.exp(-1 / (CONTROL_HZ * p.lag)))
    begin = np.full((len(command), 1), p.hover_speed) * stay
    x[layout.rotor] = lfilter([0.0, 1 - stay], [1.0, -stay], target, axis=1, zi=begin)[0]
    wind = np.asarray(p.wind)[:, None]
    at = motion(batch, layout, x, command, wind, 0.0, dynamics)
    return at.imu_force, at.angular_acceleration


MATERIAL = 0.5
"""An effect that shows by less than this, in noise of a reading, need not be found."""


def truth_json(case: Case, truth: dict[str, Truth]) -> dict[str, Any]:
    """The part of the truth file that every plant writes."""
    return {
        "case": case.id,
        "plant": case.plant,
        "kind": case.kind,
        "magnitude": case.magnitude,
        "noise": case.noise,
        "seed": case.seed,
        "missions": missions_of(case),
        "effects": [
            {
                "name": name,
                "outside": EFFECTS[name].outside,
                "parameters": {k: _number(v) for k, v in numbers.items()},
            }
            for name, numbers in truth.items()
        ],
    }


def life_json(
    case: Case, planned: Plan, trace: Trace, last: int, dynamics: Dynamics
) -> dict[str, Any]:
    """What the truth file of a case of `life` has on top; `last` is its last flight."""
    ratios = {}
    for name in case.effects if case.kind != "since" else ():
        alone = hidden(case, aircraft_of(case).nominal, name)[0]
        ratios[name] = shown(
            aircraft_of(case), alone, trace, last, NOISE[case.noise], case.life, dynamics
        )
    fitted = [day for name, day in planned.days.items() if name.startswith("fit")]
    content: dict[str, Any] = {
        "life": case.life.as_json,
        "class": (*case.effects, "none")[0] if case.kind == "since" else None,
        "sizes": sizes(case) if case.kind != "since" else {},
        "shown": ratios,
        "material": [name for name, ratio in ratios.items() if ratio >= MATERIAL],
        "days": {name: day.as_json for name, day in planned.days.items()},
        "day_means": mean_deviations(fitted, aircraft_of(case)) if fitted else {},
        "file": [
            {**asdict(error), "z": error.z}
            for error in (planned.file.errors if planned.file else ())
        ],
    }
    believed = planned.file.believed if planned.file else aircraft_of(case)
    seen = seen_from(believed.nominal, planned.plant)
    if fitted:
        late = [day.delay_steps * STEP_S for day in fitted]
        steps = planned.plant.position_delay * STEP_S
        seen["position_delay"] = {"delay_s": Number(steps + float(np.mean(late)), "s")}
    content["seen_from_file"] = {
        name: {k: _number(v) for k, v in numbers.items()} for name, numbers in seen.items()
    }
    return content


def _number(number: Number) -> dict[str, Any]:
    return {
        "value": number.value,
        "unit": number.unit,
        "neutral": number.neutral,
        "exact": number.exact,
    }


@dataclass(frozen=True)
class Produced:
    """One finished case.

    Attributes:
        case: What it is.
        flights: Flight tables by name.
        asked: What the mission of each asks for.
        vehicle: Text of the vehicle file.
        truth: What the truth file holds.
    """

    case: Case
    flights: dict[str, pd.DataFrame]
    asked: dict[str, Autopilot]
    vehicle: str
    truth: dict[str, Any]


def produce(batch: list[Case]) -> Iterator[Produced]:
    """Fly cases of one plant all at once, with aircraft that may fly together."""
    _, dynamics = PLANTS[batch[0].plant].load(batch[0].aircraft)
    plans = [plan(case) for case in batch]
    trace = fly([order for p in plans for order in p.flights.values()], dynamics)
    pure = own_dynamics if isinstance(dynamics, Simulator) else dynamics
    first = 0
    for case, planned in zip(batch, plans, strict=True):
        rows = range(first, first + len(planned.flights))
        first += len(planned.flights)
        aircraft = planned.file.believed if planned.file else aircraft_of(case)
        gaps = [
            true_gap(aircraft, order.plant, trace, i, pure)
            for i, order in zip(rows, planned.flights.values(), strict=True)
        ]
        yield Produced(
            case,
            {
                name: as_logged(flight_table(order, trace, i), trace.rotor[:, :, i], case.life)
                for i, (name, order) in zip(rows, planned.flights.items(), strict=True)
            },
            {name: _asked(order.setpoints) for name, order in planned.flights.items()},
            vehicle_toml(
                aircraft,
                NOISE[case.noise],
                planned.file.sd if planned.file else None,
                case.life.rotors,
            ),
            {
                **truth_json(case, planned.truth),
                "aircraft": aircraft.name,
                "gap": gap_json(gaps),
                **(life_json(case, planned, trace, rows[-1], pure) if case.life.key else {}),
            },
        )


def _asked(mission: Setpoints) -> Autopilot:
    """What a mission asks for, as an autopilot logs it."""
    rows = np.column_stack([mission.pos, mission.vel, mission.acc, mission.yaw])
    return setpoints_of_mission(rows, 1 / CONTROL_HZ, GRAVITY_M_S2)
