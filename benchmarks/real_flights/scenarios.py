"""Recorded flights, and the vehicle files that they are held against."""

import runpy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import numpy as np
import pandas as pd
import tomlkit

from twin.logs import Flight, read_flight
from twin.vehicle import Vehicle
from twin.vehicle_file import parse_vehicle, vehicle_text

EXAMPLES = Path(__file__).parents[2] / "examples"


@dataclass(frozen=True, slots=True)
class Change:
    """What is made wrong in a vehicle file.

    Attributes:
        key: Section and name.
        factor: On its value; None: it is left out.
    """

    key: str
    factor: float | None

    def __call__(self, text: str) -> str:
        """The text of a vehicle file with the change, comments kept."""
        document = tomlkit.parse(text)
        section, _, name = self.key.partition(".")
        entries = cast(dict[str, dict[str, object]], document[section])
        if self.factor is None:
            del entries[name]
        else:
            true = np.asarray(entries[name]["value"], dtype=np.float64)
            wrong = (true * self.factor).tolist()
            source = f"deliberately wrong: {self.factor:g} times the true one"
            entries[name].update({"value": wrong, "source": source})
        return tomlkit.dumps(document)


@dataclass(frozen=True, slots=True)
class Scenario:
    """Flights of one aircraft; each in turn is held out.

    Attributes:
        name: Of the files that hold what was found.
        title: For people.
        about: What a reader must know, in Markdown.
        flights: Files, below the folder of the data.
        vehicle: Built-in vehicle.
        change: Made to its file.
        expected: What a right answer has among its numbers, "effect.number" -> value.
        indoors: Whether the flights were within walls; None: the logs say it themselves.
        turning_goal_rad_s2: Rms of angular acceleration about its mean that effects should leave at
            most; None: no goal was set.
    """

    name: str
    title: str
    about: str
    flights: tuple[str, ...]
    vehicle: str
    change: Change | None = None
    expected: Mapping[str, float] = field(default_factory=dict)
    indoors: bool | None = None
    turning_goal_rad_s2: float | None = None

    @property
    def vehicle_text(self) -> str:
        """The vehicle file."""
        text, _ = vehicle_text(self.vehicle)
        return text if self.change is None else self.change(text)

    def read_vehicle(self) -> Vehicle:
        """The vehicle, as wrong as it is meant to be."""
        return parse_vehicle(self.vehicle_text, f"{self.vehicle}.toml")


def sources(flight: str) -> tuple[Path, ...]:
    """Scripts on which the reading of a flight depends."""
    converter = EXAMPLES / f"{Path(flight).parts[0]}_to_flight_table.py"
    return () if flight.endswith(".ulg") else (converter,)


def read(data: Path, flight: str) -> Flight:
    """A PX4 log as it is, another recording through its converter in `examples/`."""
    path = data / flight
    if path.suffix == ".ulg":
        return read_flight(path)
    (script,) = sources(flight)
    convert = cast(Callable[[pd.DataFrame, str], Flight], runpy.run_path(str(script))["convert"])
    return convert(pd.read_parquet(path).astype(np.float64), path.stem)


REAL = tuple(f"rflysimdt/real_{i}.ulg" for i in (1, 2, 3))
SIMULATED = tuple(f"rflysimdt/sim_{i}.ulg" for i in (1, 2, 3))
CRAZYFLIE = tuple(f"crazyflie_motor_delay/log{i}.parquet" for i in (10, 15, 16))
NANOBENCH = tuple(
    f"nanobench/{name}.parquet"
    for name in (
        "B2_circle_slow_rep2",
        "B2_circle_medium_rep2",
        "B3_figure8_medium_rep2",
        "B5_helix_slow_rep1",
    )
)

SCENARIOS = (
    Scenario(
        "real",
        "RflySimDT, real flights",
        "Quadrotor of 0.32 kg, take-off, hover and landing indoors, with motion capture and PX4; "
        "vehicle file `feisi_x150`, as published. Its thrust map carries 63 % of the weight, "
        "it has no motor lag, `torque_per_thrust` is made up. Ground pressure and the field of the "
        "place are in no vehicle file.",
        REAL,
        "feisi_x150",
    ),
    Scenario(
        "simulated",
        "RflySimDT, simulated flights",
        "PX4 in the loop with CopterSim, take-off, hover and landing; vehicle file "
        "`copter_default`, the parameters of that simulator as far as published. Position, "
        "velocity and attitude are those of PX4's estimator.",
        SIMULATED,
        "copter_default",
    ),
    Scenario(
        "simulated_heavy",
        "RflySimDT, simulated flights, mass wrong",
        "The same flights with a deliberately wrong file: mass 1.68 kg instead of 1.4 kg.",
        SIMULATED,
        "copter_default",
        Change("body.mass", 1.2),
        {"mass_offset.mass_kg": -0.28},
    ),
    Scenario(
        "simulated_quick",
        "RflySimDT, simulated flights, motor lag missing",
        "The same flights with a deliberately wrong file: the motors follow at once instead of "
        "with a time constant of 0.05 s.",
        SIMULATED,
        "copter_default",
        Change("rotors.lag", None),
        {"motor_lag.tau_s": 0.05},
    ),
    Scenario(
        "nanobench",
        "NanoBench, Crazyflie 2.1",
        "Circles, figure of eight and helix indoors with Vicon; vehicle file `crazyflie`, of "
        "another specimen. The clocks of IMU and Vicon differ and drift. No magnetometer, no "
        "barometer. No mission asks for yaw, so that its response is not told; nor is a motor lag "
        "below 52 ms (the climb included).",
        NANOBENCH,
        "crazyflie",
        indoors=True,
        turning_goal_rad_s2=6.0,
    ),
    Scenario(
        "crazyflie_motor_delay",
        "Crazyflie of Eschmann et al.",
        "IMU and commands at 1 kHz, no pose, no voltage: only `acc_*` and `gyro_rate_*`. log10 "
        "excites thrust, log15 roll and pitch, log16 yaw, so that each held-out flight does what "
        "the others do not. Vehicle file `crazyflie`, whose lag comes from log10.",
        CRAZYFLIE,
        "crazyflie",
        indoors=True,
    ),
    Scenario(
        "crazyflie_quick",
        "Crazyflie of Eschmann et al., motor lag missing",
        "The same flights with the lag of 0.075 s taken out of the vehicle file: the effect that "
        "the paper is about.",
        CRAZYFLIE,
        "crazyflie",
        Change("rotors.lag", None),
        {"motor_lag.tau_s": 0.075},
        indoors=True,
    ),
)
