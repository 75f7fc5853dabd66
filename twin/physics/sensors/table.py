"""The sensors that a flight is compared by: one row each.

Every list of sensors is made from these rows, so that a new sensor is its module, its
row, its columns of the flight table and its numbers in the vehicle file:
docs/dev/extending/sensor.md. The position sensor is no row: what it measures is the motion along
which the twin is evaluated.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from ...component import Component
from ...effects import ComponentName
from ...vehicle import GRAVITY_M_S2, Vehicle
from .barometer import barometer
from .imu import imu
from .magnetometer import magnetometer

BODY = "body"
"""Group of the sensors that measure what acts on the body."""
EARTH_FIELD_T = 5e-5
"""Magnetic flux density of the earth, roughly."""
FLOW_PA = 200.0
"""Dynamic pressure at 18 m/s: what a port may be off by."""


def _unknown(_: Vehicle) -> float:
    return 0.0


def _unfiltered(_: Vehicle) -> float | None:
    return None


@dataclass(frozen=True, slots=True)
class Sensor:
    """One sensor: a row of the table.

    Attributes:
        name: Identifier.
        component: Name of the component that it is, alone or with others.
        make: `(vehicle, effects) -> component`.
        signal: What `Effect.needs` calls its readings.
        columns: Of the flight table, and outputs of the component, of the same names.
        unit: Of a reading, for people.
        title: What it measures, as the heading of a list.
        words: The same within a sentence.
        group: Sensors and effects of one group compete with each other; those of different groups
            have no reading in common. `BODY`: predicted from the motion of the body; any other:
            from the pose.
        needs: Measured motion without which its reading cannot be predicted from the pose: "pos",
            "vel", "q". Its component's other inputs are taken from columns of their names where
            the flight has them, and stay at their start values otherwise.
        size: Of each column, a change of the reading of the order of what it is there for, in
            `channel_unit`; of a far smaller one nobody needs to speak.
        rate_unit: Unit of its rate of change, for a sensor that is compared by that: what it reads
            is itself a part of the motion. Empty: compared by its readings.
        fixed_in_space: Whether it reads a vector that the earth holds still.
        cutoff_hz: Low-pass of the vehicle's sensor, known to it but not to its readings; None.
        noise: Standard deviation of a reading by the vehicle file; 0: not known.
        least_count: Quantisation step of a usual sensor of the kind, in `unit`. No noise level is
            taken to be below that of rounding to it.
    """

    name: str
    component: ComponentName
    make: Callable[[Vehicle, Iterable[str]], Component]
    signal: str
    columns: tuple[str, ...]
    unit: str
    title: str
    words: str
    group: str
    needs: tuple[str, ...]
    size: Callable[[Vehicle], tuple[float, ...]]
    least_count: float
    rate_unit: str = ""
    fixed_in_space: bool = False
    cutoff_hz: Callable[[Vehicle], float | None] = _unfiltered
    noise: Callable[[Vehicle], float] = _unknown

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of what is compared: its columns, or their rates of change."""
        if not self.rate_unit:
            return self.columns
        return tuple(c.replace(self.signal, f"{self.signal}_rate", 1) for c in self.columns)

    @property
    def channel_unit(self) -> str:
        """Unit of what is compared."""
        return self.rate_unit or self.unit


def _agility(vehicle: Vehicle) -> tuple[float, ...]:
    """Angular acceleration by a moment of the weight at the arm, rad/s^2, about x, y and z."""
    moment = vehicle.mass_kg * GRAVITY_M_S2 * vehicle.arm_m
    return tuple(moment / float(vehicle.inertia_kg_m2[i, i]) for i in range(3))


SENSORS: tuple[Sensor, ...] = (
    Sensor(
        "accelerometer",
        "imu",
        imu,
        "acc",
        ("acc_x", "acc_y", "acc_z"),
        "m/s²",
        "Specific force (accelerometer)",
        "specific force",
        BODY,
        (),
        lambda v: (GRAVITY_M_S2,) * 3,
        GRAVITY_M_S2 / 2048,  # 16 bits over 16 g either way: ICM-20602
        cutoff_hz=lambda v: v.accel_cutoff_hz,
        noise=lambda v: v.sensors.accel_noise_m_s2,
    ),
    Sensor(
        "gyroscope",
        "imu",
        imu,
        "gyro",
        ("gyro_x", "gyro_y", "gyro_z"),
        "rad/s",
        "Body rates",
        "body rate",
        BODY,
        (),
        _agility,
        float(np.radians(1 / 16.4)),  # 16 bits over 2000 deg/s either way: ICM-20602
        rate_unit="rad/s²",
        cutoff_hz=lambda v: v.gyro_cutoff_hz,
        noise=lambda v: v.sensors.gyro_noise_rad_s,
    ),
    Sensor(
        "magnetometer",
        "magnetometer",
        magnetometer,
        "mag",
        ("mag_x", "mag_y", "mag_z"),
        "T",
        "Magnetic field",
        "magnetic field",
        "magnetometer",
        ("q",),
        lambda v: (EARTH_FIELD_T,) * 3,
        1e-4 / 6842,  # 16 bits over 4 gauss either way: LIS3MDL
        fixed_in_space=True,
        noise=lambda v: v.sensors.mag_noise_t,
    ),
    Sensor(
        "barometer",
        "barometer",
        barometer,
        "baro",
        ("baro_pa",),
        "Pa",
        "Air pressure",
        "air pressure",
        "barometer",
        ("pos",),
        lambda v: (FLOW_PA,),
        1.0,  # 0.01 mbar: MS5611
        noise=lambda v: v.sensors.baro_noise_pa,
    ),
)
"""All of them, in the order of the flight table."""


def components_of_sensors() -> dict[str, Callable[[Vehicle, Iterable[str]], Component]]:
    """Maker of each component that is a sensor, by its name."""
    return {s.component: s.make for s in SENSORS}


def sensor_of(column: str) -> Sensor | None:
    """The sensor that a column of the flight table, or a channel, belongs to; None: of none."""
    return next((s for s in SENSORS if column in (*s.columns, *s.channels)), None)
