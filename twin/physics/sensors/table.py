"""The sensors that are compared with flights: one complete declaration each.

Every list of sensors is made from these rows: columns of the flight table and their physical
limits, components of the whole twin, channels and slopes of `explain`, the noise measured by a
draft, signals that live flights decode and miss, outputs of the compensator, readings sent to an
autopilot in the loop. No field has a default, so an incomplete sensor cannot be imported:
docs/dev/extending/sensor.md. The position sensor is no row: it measures the motion along which the
twin is evaluated.

A row names its component, which is built, with CasADi, on demand: readers of logs need the rows
only.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from importlib import import_module
from typing import TYPE_CHECKING, cast

import numpy as np

from ...errors import ModelError
from ...vehicle import GRAVITY_M_S2, Vehicle
from ...vehicle.vehicle import Sensors

if TYPE_CHECKING:
    from ...component import Component

BODY = "body"
"""Group of the sensors that measure forces and rotation of the body."""
EARTH_FIELD_T = 5e-5
"""Magnetic flux density of the Earth, T; 2.5e-5 to 6.5e-5 over its surface (WMM 2025)."""
FLOW_PA = 200.0
"""Dynamic pressure at 18 m/s, Pa: possible error of a pressure port."""
_NUMBERS = {f.metadata["key"]: f.name for f in fields(Sensors) if f.metadata}
"""Attribute of `vehicle.sensors` by its key in the vehicle file."""


@dataclass(frozen=True, slots=True)
class Rate:
    """Rate of change of a reading, for a sensor whose reading is itself part of the motion.

    Attributes:
        unit: Unit in printed form.
        title: Name as the heading of a list.
        words: Name within a sentence.
    """

    unit: str
    title: str
    words: str


@dataclass(frozen=True, slots=True)
class Usual:
    """Usual range of a sensor while a multirotor flies.

    Attributes:
        low: Lower bound of the median magnitude, in the unit of the flight table.
        high: Upper bound of the median magnitude, in the unit of the flight table.
        other_units: Units in which it is written by mistake, with their factors to the unit of the
            flight table.
    """

    low: float
    high: float
    other_units: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """One sensor: a row of the table.

    Attributes:
        name: Identifier.
        component: Component of the sensor, alone or with others: name of a module of this package,
            and of the function `(vehicle, effects) -> component` in it.
        signal: Name of its readings in `Effect.needs`, limits and live samples.
        columns: Columns of the flight table, and outputs of the component, of the same names.
        meanings: Meaning of each column, for the definition of the flight table.
        unit: Unit of a reading in printed form.
        title: Measured quantity as the heading of a list.
        words: Measured quantity within a sentence.
        group: Sensors and effects of one group compete with each other; those of different groups
            have no reading in common. `BODY`: predicted from the motion of the body; any other:
            from the pose.
        needs: Measured motion that is necessary to predict its reading from the pose: "pos", "vel",
            "q". Other inputs of its component come from columns of their names where the flight has
            them, else they are at their start values.
        size: Typical relevant change of each column's reading, in `channel_unit`; far smaller
            changes are negligible.
        rate: Rate of change that is compared in place of its readings; None: the readings are
            compared.
        fixed_in_space: Whether it measures a vector that is constant in Earth-fixed axes.
        cutoff_hz: Cut-off of a low-pass in the vehicle's sensor that is known but not applied to
            its readings; None: no such filter.
        noise_key: Key of its white noise in the vehicle file, which a draft measures.
        least_count: Quantisation step of a typical sensor of the kind, in `unit`. No noise level is
            assumed below that of rounding to it.
        limit: Magnitude of a component of a reading that no flight reaches, in `unit`.
        damaged: Possible cause of a reading beyond the limit, as a question.
        usual: Usual range of its readings, by which another unit is recognised; None: any value is
            plausible.
        messages: MAVLink messages with its readings in live flight, the one to request first; ():
            none.
        without: Consequence for a live flight without it; "": none.
        learned: Whether a compensator corrects it.
        hil: Whether an autopilot in the loop receives it.
    """

    name: str
    component: str
    signal: str
    columns: tuple[str, ...]
    meanings: tuple[str, ...]
    unit: str
    title: str
    words: str
    group: str
    needs: tuple[str, ...]
    size: Callable[[Vehicle], tuple[float, ...]]
    rate: Rate | None
    fixed_in_space: bool
    cutoff_hz: Callable[[Vehicle], float | None]
    noise_key: str
    least_count: float
    limit: float
    damaged: str
    usual: Usual | None
    messages: tuple[str, ...]
    without: str
    learned: bool
    hil: bool

    def __post_init__(self) -> None:
        """Refuse an inconsistent row.

        Raises:
            ModelError: A column has no meaning, or the vehicle file has no such noise.
        """
        if len(self.meanings) != len(self.columns):
            raise ModelError(
                f"sensor {self.name}: {len(self.columns)} columns, {len(self.meanings)} meanings; "
                f"give each column one."
            )
        if self.noise_key not in _NUMBERS:
            raise ModelError(
                f"sensor {self.name}: no number of twin/vehicle/vehicle.py: {self.noise_key!r}. "
                f"Add it to Sensors."
            )

    def make(self, vehicle: Vehicle, effects: Iterable[str] = ()) -> "Component":
        """Build its component.

        Args:
            vehicle: Numbers of the aircraft, and the effects that are switched on.
            effects: Effects to build in, switched off: identifiers of `twin.effects.EFFECTS`; those
                of other components are ignored.
        """
        module = import_module(f".{self.component}", __package__)
        maker = cast("Callable[[Vehicle, Iterable[str]], Component]", vars(module)[self.component])
        return maker(vehicle, effects)

    def noise(self, vehicle: Vehicle) -> float:
        """Standard deviation of a reading by the vehicle file; 0: not known."""
        return float(getattr(vehicle.sensors, _NUMBERS[self.noise_key]))

    @property
    def plain_unit(self) -> str:
        """Unit of a reading as written in files: `m/s^2`."""
        return self.unit.replace("²", "^2")

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the compared quantities: its columns, or their rates of change."""
        if self.rate is None:
            return self.columns
        return tuple(c.replace(self.signal, f"{self.signal}_rate", 1) for c in self.columns)

    @property
    def channel_unit(self) -> str:
        """Unit of the compared quantities."""
        return self.unit if self.rate is None else self.rate.unit


def _agility(vehicle: Vehicle) -> tuple[float, ...]:
    """Angular acceleration by a moment of the weight at the arm, rad/s^2, about x, y and z."""
    moment = vehicle.mass_kg * GRAVITY_M_S2 * vehicle.arm_m
    return tuple(moment / float(vehicle.inertia_kg_m2[i, i]) for i in range(3))


def _unfiltered(_: Vehicle) -> float | None:
    return None


ACCELEROMETER = Sensor(
    name="accelerometer",
    component="imu",
    signal="acc",
    columns=("acc_x", "acc_y", "acc_z"),
    meanings=(
        "specific force along body x (forward), FRD",
        "specific force along body y (right), FRD",
        "specific force along body z (down), FRD; about -9.8 at rest",
    ),
    unit="m/s²",
    title="Specific force (accelerometer)",
    words="specific force",
    group=BODY,
    needs=(),
    size=lambda v: (GRAVITY_M_S2,) * 3,
    rate=None,
    fixed_in_space=False,
    cutoff_hz=lambda v: v.accel_cutoff_hz,
    noise_key="imu.accel_noise",
    least_count=GRAVITY_M_S2 / 2048,  # 16 bits over 16 g either way: ICM-20602
    limit=2e3,
    damaged="in mg? An accelerometer at rest reads 9.8 m/s^2",
    usual=Usual(5.0, 20.0, (("g", GRAVITY_M_S2), ("mg", 1e-3 * GRAVITY_M_S2), ("cm/s^2", 1e-2))),
    messages=("HIGHRES_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "RAW_IMU"),
    without="no residuals of forces: drag, thrust, mass",
    learned=True,
    hil=True,
)  # reads specific force, m/s2
GYROSCOPE = Sensor(
    name="gyroscope",
    component="imu",
    signal="gyro",
    columns=("gyro_x", "gyro_y", "gyro_z"),
    meanings=(
        "body rate about x (roll), FRD",
        "body rate about y (pitch), FRD",
        "body rate about z (yaw), FRD",
    ),
    unit="rad/s",
    title="Body rates",
    words="body rate",
    group=BODY,
    needs=(),
    size=_agility,
    rate=Rate("rad/s²", "Angular acceleration", "angular acceleration"),
    fixed_in_space=False,
    cutoff_hz=lambda v: v.gyro_cutoff_hz,
    noise_key="imu.gyro_noise",
    least_count=float(np.radians(1 / 16.4)),  # 16 bits over 2000 deg/s either way: ICM-20602
    limit=1e2,
    damaged="in degrees per second? 1 rad/s = 57.3",
    usual=None,
    messages=("HIGHRES_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "RAW_IMU"),
    without="no residuals of moments",
    learned=True,
    hil=True,
)  # reads body rates, rad/s
MAGNETOMETER = Sensor(
    name="magnetometer",
    component="magnetometer",
    signal="mag",
    columns=("mag_x", "mag_y", "mag_z"),
    meanings=tuple(f"magnetic flux density along body {a}, FRD" for a in "xyz"),
    unit="T",
    title="Magnetic field",
    words="magnetic field",
    group="magnetometer",
    needs=("q",),
    size=lambda v: (EARTH_FIELD_T,) * 3,
    rate=None,
    fixed_in_space=True,
    cutoff_hz=_unfiltered,
    noise_key="magnetometer.noise",
    least_count=1e-4 / 6842,  # 16 bits over 4 gauss either way: LIS3MDL
    limit=1e-2,
    damaged="in gauss? The Earth has 2.5e-5 to 6.5e-5 T (1 gauss = 1e-4 T)",
    usual=Usual(1.5e-5, 1e-4, (("gauss", 1e-4), ("mgauss", 1e-7), ("uT", 1e-6), ("nT", 1e-9))),
    messages=("HIGHRES_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "RAW_IMU"),
    without="",
    learned=True,
    hil=True,
)  # reads the magnetic flux density, T
BAROMETER = Sensor(
    name="barometer",
    component="barometer",
    signal="baro",
    columns=("baro_pa",),
    meanings=("static pressure",),
    unit="Pa",
    title="Air pressure",
    words="air pressure",
    group="barometer",
    needs=("pos",),
    size=lambda v: (FLOW_PA,),
    rate=None,
    fixed_in_space=False,
    cutoff_hz=_unfiltered,
    noise_key="barometer.noise",
    least_count=1.0,  # 0.01 mbar: MS5611
    limit=2e5,
    damaged="another unit?",
    usual=Usual(3e4, 1.1e5, (("hPa", 1e2), ("kPa", 1e3), ("tenths of a Pa", 0.1))),
    messages=("HIGHRES_IMU", "SCALED_PRESSURE"),
    without="",
    learned=False,
    hil=True,
)  # reads static pressure, Pa
SENSORS: tuple[Sensor, ...] = (
    ACCELEROMETER,
    GYROSCOPE,
    MAGNETOMETER,
    BAROMETER,
)
"""All sensors, in the order of the flight table."""


def components_of_sensors() -> dict[str, Callable[[Vehicle, Iterable[str]], "Component"]]:
    """Function that builds each component that is a sensor, by its name."""
    return {s.component: s.make for s in SENSORS}


def sensor_of(column: str) -> Sensor | None:
    """The sensor of a column of the flight table, or of a channel; None without one."""
    return next((s for s in SENSORS if column in (*s.columns, *s.channels)), None)
