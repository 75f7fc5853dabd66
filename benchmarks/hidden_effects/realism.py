"""What real aircraft have besides what is hidden: days, wrong files, defects, many effects.

What differs from flight to flight of one aircraft: constants of the day.

Sizes by section 7 of the notes on inference from real flights: the battery is put in anew, the
accelerometer is warmer, the weather has changed, the motion capture was calibrated again. Wind is
that of a calm day outdoors; a clock is late by half a normal distribution, never early.

Vehicle files whose numbers are off by the standard deviations that they state themselves.

The aircraft flies as it is; only the file is wrong. A deviation in per cent is one of what the
file says: true = file (1 + sd z), z standard normal. Places of rotors move together, as they do
when the centre of mass is not where the file has it.

Sizes are made up: a scale, a bifilar pendulum, a bench of thrust, a ruler. Each is taken half, once
or one and a half times, drawn by case and entry, so that who does not read it cannot know it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from .cases import MAGNITUDES, SENSORS, Conditions
from .hiding import AXES, Number, Truth, direction, factor, factors, vector
from .plants.aircraft import Aircraft
from .plants.kinds import EFFECTS, Plant
from .plants.own.parameters import STEP_S, Array, Parameters

ACCEL_BIAS_M_S2 = 0.1
CENTRE_ARMS = 0.015
PRESSURE_PA = 20.0
HEADING_RAD = 0.1
WIND_M_S = 0.5
DELAY_S = 0.02


@dataclass(frozen=True)
class Day:
    """Constants of one flight; vectors body FRD, wind NED.

    Attributes:
        accel_bias_m_s2: On top of what is hidden.
        centre_m: Centre of mass forward and right of where it is on average.
        pressure_pa: Of the ground above the file's.
        heading_rad: Of the compass, shown minus true.
        wind_m_s: North, east, down.
        delay_steps: Of position and velocity, in steps of the plant.
    """

    accel_bias_m_s2: Array
    centre_m: Array
    pressure_pa: float
    heading_rad: float
    wind_m_s: Array
    delay_steps: int

    @property
    def as_json(self) -> dict[str, Any]:
        """For the truth file, delay in s."""
        return {
            "accel_bias_m_s2": self.accel_bias_m_s2.tolist(),
            "centre_m": self.centre_m.tolist(),
            "pressure_pa": self.pressure_pa,
            "heading_rad": self.heading_rad,
            "wind_m_s": self.wind_m_s.tolist(),
            "position_delay_s": self.delay_steps * STEP_S,
        }


def draw_day(aircraft: Aircraft, rng: np.random.Generator) -> Day:
    """Constants of a flight of this aircraft."""
    flat = np.array([1.0, 1.0, 0.0])
    return Day(
        ACCEL_BIAS_M_S2 * rng.standard_normal(3),
        CENTRE_ARMS * aircraft.arm * flat * rng.standard_normal(3),
        PRESSURE_PA * float(rng.standard_normal()),
        HEADING_RAD * float(rng.standard_normal()),
        WIND_M_S * aircraft.pace * flat * rng.standard_normal(3),
        round(DELAY_S * abs(float(rng.standard_normal())) / STEP_S),
    )


def mean_deviations(days: Sequence[Day], aircraft: Aircraft) -> dict[str, float]:
    """How far the mean of some days is from what it is expected to be, in its own standard
    deviations, by the effect that has such a constant: of several numbers the farthest."""
    flat = slice(0, 2)
    drawn = {
        "accel_bias": [d.accel_bias_m_s2 / ACCEL_BIAS_M_S2 for d in days],
        "cog_offset": [d.centre_m[flat] / (CENTRE_ARMS * aircraft.arm) for d in days],
        "baro_bias": [np.array([d.pressure_pa / PRESSURE_PA]) for d in days],
        "heading_offset": [np.array([d.heading_rad / HEADING_RAD]) for d in days],
        "steady_wind": [d.wind_m_s[flat] / (WIND_M_S * aircraft.pace) for d in days],
    }
    root = float(np.sqrt(len(days)))
    return {k: root * float(np.abs(np.mean(v, axis=0)).max()) for k, v in drawn.items()}


def on_day(plant: Parameters, day: Day) -> Parameters:
    """What flies on that day."""
    return replace(
        plant,
        accel_bias=plant.accel_bias + day.accel_bias_m_s2,
        hubs=plant.hubs - day.centre_m,
        imu_arm=plant.imu_arm - day.centre_m,
        marker=plant.marker - day.centre_m,
        baro_bias=plant.baro_bias + day.pressure_pa,
        heading=plant.heading + day.heading_rad,
        wind=plant.wind + day.wind_m_s,
        position_delay=plant.position_delay + day.delay_steps,
    )


_SD = {"mass": 0.02, "inertia": 0.15, "thrust": 0.08, "torque": 0.15, "lag": 0.15}
"""Of what the file says."""
_PLACE_SD = {"rotors.position": 0.02, "imu.position": 0.08}
"""Of the arm."""
_TIMES = (0.5, 1.0, 1.5)


@dataclass(frozen=True)
class FileError:
    """One number of the file.

    Attributes:
        key: Entry of the vehicle file, with the axis where there are several.
        effect: Effect of the library that would put it right.
        true: SI; 1 where a map is meant as a whole.
        file: What the file has.
        sd: Standard deviation of `true` about `file`.
    """

    key: str
    effect: str
    true: float
    file: float
    sd: float

    @property
    def z(self) -> float:
        """How many standard deviations the truth is off."""
        return (self.true - self.file) / self.sd


@dataclass(frozen=True)
class WrongFile:
    """What the user believes.

    Attributes:
        believed: The aircraft of the vehicle file.
        sd: Standard deviations of entries as TOML, by "section.key".
        errors: Number by number.
    """

    believed: Aircraft
    sd: dict[str, str]
    errors: tuple[FileError, ...]


def wrong_file(aircraft: Aircraft, by_speed: bool, rng: np.random.Generator) -> WrongFile:
    """Draw what the file of an aircraft says; `by_speed`: its rotor speeds are measured."""
    p, errors = aircraft.nominal, list[FileError]()
    by_command = aircraft.by_command and not by_speed
    texts: dict[str, str] = {}

    def share(what: str, key: str) -> float:
        """A deviation in per cent, and its text."""
        sd = _SD[what] * float(rng.choice(_TIMES))
        texts[key] = f'"{100 * sd:g} %"'
        return sd

    def off(key: str, effect: str, true: float, sd: float) -> float:
        """What the file says where its relative deviation is `sd`."""
        file = true / (1 + sd * float(rng.standard_normal()))
        errors.append(FileError(key, effect, true, file, abs(sd * file)))
        return file

    mass = off("body.mass", "mass_offset", p.mass, share("mass", "body.mass"))
    sd = share("inertia", "body.inertia")
    inertia = [
        off(f"body.inertia.{a}", "inertia_error", float(v), sd)
        for a, v in zip(AXES, p.inertia, strict=True)
    ]
    thrust_key = f"rotors.thrust_from_{'command' if by_command else 'speed'}"
    thrust = off(thrust_key, "thrust_scale", 1.0, share("thrust", thrust_key))
    torque_key = f"rotors.torque_{'per_thrust' if by_command else 'from_speed'}"
    torque = off(torque_key, "yaw_torque_scale", 1.0, share("torque", torque_key)) * (
        thrust if by_command else 1.0
    )
    lag = p.lag if by_speed else off("rotors.lag", "motor_lag", p.lag, share("lag", "rotors.lag"))

    def moved(key: str, effect: str, true: Array) -> Array:
        """A place that is off, m."""
        sd = round(_PLACE_SD[key] * aircraft.arm * float(rng.choice(_TIMES)), 6)
        texts[key] = repr(sd)
        file = true - sd * rng.standard_normal(len(true))
        errors.extend(
            FileError(f"{key}.{a}", effect, float(t), float(f), sd)
            for a, t, f in zip(AXES, true, file, strict=False)
        )
        return np.asarray(file)

    middle = p.hubs[:, :2].mean(axis=0)
    shift = np.array([*(moved("rotors.position", "cog_offset", middle) - middle), 0.0])
    believed = replace(
        p,
        mass=mass,
        inertia=np.array(inertia),
        thrust_k=p.thrust_k * thrust,
        torque_k=p.torque_k * torque,
        lag=lag,
        hubs=p.hubs + shift,
        imu_arm=moved("imu.position", "imu_lever_arm", p.imu_arm),
    )
    user = replace(
        aircraft,
        nominal=believed,
        thrust_of_rpm=_times(thrust, aircraft.thrust_of_rpm),
        torque_of_rpm=_times(torque, aircraft.torque_of_rpm),
    )
    return WrongFile(user, texts, tuple(errors))


def _times(k: float, coefficients: tuple[float, ...] | None) -> tuple[float, ...] | None:
    return None if coefficients is None else tuple(k * c for c in coefficients)


def seen_from(file: Parameters, plant: Parameters) -> dict[str, Truth]:
    """Numbers by which what flies differs from a file, by the effect that has them: what is hidden
    and what is wrong with the file together.

    A rotor that has lost some of its thrust is no part of `thrust_scale`: the median of the rotors
    counts.
    """
    centre = np.mean(file.hubs - plant.hubs, axis=0)
    return {
        "mass_offset": {"mass_kg": Number(plant.mass - file.mass, "kg")},
        "inertia_error": factors("scale_{}", plant.inertia / file.inertia),
        "thrust_scale": {"scale": factor(float(np.median(plant.thrust_k / file.thrust_k)))},
        "yaw_torque_scale": {"scale": factor(float(np.median(plant.torque_k / file.torque_k)))},
        "motor_lag": {"tau_s": Number(plant.lag - file.lag, "s")},
        "cog_offset": vector("{}_m", centre[:2], "m"),
        "imu_lever_arm": vector("{}_m", plant.imu_arm - file.imu_arm + centre, "m"),
    }


Happened = tuple[Parameters, dict[str, Truth]]
Defect = Callable[[Parameters, Aircraft, np.random.Generator], Happened]


def _rotor(p: Parameters, a: Aircraft, rng: np.random.Generator) -> Happened:
    """One rotor loses thrust, and as much of its torque."""
    i, loss = int(rng.integers(len(p.hubs))), float(rng.uniform(0.05, 0.3))
    left = np.ones(len(p.hubs))
    left[i] -= loss
    hurt = replace(p, thrust_k=p.thrust_k * left, torque_k=p.torque_k * left)
    return hurt, {"rotor_efficiency_loss": {f"loss_{i + 1}": Number(loss, "1")}}


def _payload(p: Parameters, a: Aircraft, rng: np.random.Generator) -> Happened:
    """A point mass fixed below, off the centre: mass, centre of mass and inertia follow."""
    extra = float(rng.uniform(0.05, 0.25)) * p.mass
    place = direction(rng, float(rng.uniform(0.2, 0.5)) * a.arm, axes=2)
    place[2] = float(rng.uniform(0.05, 0.2)) * a.arm
    centre = extra / (p.mass + extra) * place
    reduced = extra * p.mass / (p.mass + extra)
    loaded = replace(
        p,
        mass=p.mass + extra,
        inertia=p.inertia + reduced * (place @ place - place**2),
        hubs=p.hubs - centre,
        imu_arm=p.imu_arm - centre,
        marker=p.marker - centre,
    )
    return loaded, {
        "mass_offset": {"mass_kg": Number(extra, "kg")},
        "cog_offset": vector("{}_m", centre[:2], "m"),
    }


def _library(name: str, smallest: float, largest: float) -> Defect:
    """An effect of the library of a size between two."""

    def happen(p: Parameters, a: Aircraft, rng: np.random.Generator) -> Happened:
        """The plant with it."""
        changed, truth = EFFECTS[name].hide(p, a, float(rng.uniform(smallest, largest)), rng)
        return changed, {name: truth}

    return happen


DEFECTS: dict[str, Defect] = {
    "rotor": _rotor,
    "payload": _payload,
    "slung": _library("slung_load", 0.05, 0.2),
    "accelerometer": _library("accel_bias", 0.25, 0.8),
    "gyroscope": _library("gyro_bias", 0.01, 0.06),
    "none": lambda p, a, rng: (p, {}),
}
"""By class; sizes of biases are above those of days, twice to eight times."""


def as_logged(table: pd.DataFrame, rotor: Array, conditions: Conditions) -> pd.DataFrame:
    """The flight table that is left under some conditions.

    Args:
        table: With all sensors.
        rotor: Speeds of the rotors at its rows, rad/s, shape (k, r).
        conditions: Which sensors are there.
    """
    if conditions.rotors:
        commands = [c for c in table if c.startswith("cmd_")]
        names = [f"rotor_{i + 1}" for i in range(rotor.shape[1])]
        measured = pd.DataFrame(rotor, columns=names)
        table = pd.concat(
            [table[["time"]], measured, table.drop(columns=["time", *commands])], axis=1
        )
    if conditions.without:
        gone = SENSORS[conditions.without]
        table = table[[c for c in table if not c.startswith(gone)]]
    return table


FEWEST, MOST = 6, 12
_NO_MEAN = {"gust", "vibration", "sensor_noise_level", "stuck_sensor"}
_OF_COMMANDS = {"motor_lag", "command_delay", "battery_sag"}
"""What measured rotor speeds leave no place for."""
_ONE_OF = (
    {"motor_lag", "command_delay", "position_delay"},  # else the controller loses the aircraft
    {"induced_inflow", "translational_lift"},  # one rotor has one inflow
)
_SENSED_BY = {
    "accel_": ("acc_",),
    "imu_": ("acc_", "gyro_"),
    "gyro_": ("gyro_",),
    "mag_": ("mag_",),
    "heading_": ("mag_",),
    "baro_": ("baro_",),
}


def can_show(name: str, conditions: Conditions) -> bool:
    """Whether an effect of the library moves the mean of a reading that the log has."""
    if EFFECTS[name].outside or name in _NO_MEAN or (conditions.rotors and name in _OF_COMMANDS):
        return False
    gone = SENSORS.get(conditions.without, ())
    sensors = next((s for k, s in _SENSED_BY.items() if name.startswith(k)), None)
    return sensors is None or any(s not in gone for s in sensors)


def draw_effects(plant: Plant, conditions: Conditions, rng: np.random.Generator) -> tuple[str, ...]:
    """Names of a case with many effects."""
    wanted = int(rng.integers(FEWEST, MOST + 1))
    possible = [n for n in plant.effects if can_show(n, conditions)]
    drawn: list[str] = []
    for name in rng.permutation(np.array(possible)).tolist():
        rivals = [group for group in _ONE_OF if name in group]
        if not any(group & {*drawn} for group in rivals):
            drawn.append(name)
    return tuple(sorted(drawn[:wanted]))


def draw_magnitude(name: str, rng: np.random.Generator) -> str:
    """Small, medium or large; what makes the loop slower is never large."""
    level = int(rng.integers(3))
    return MAGNITUDES[min(level, 1) if name in _ONE_OF[0] else level]
