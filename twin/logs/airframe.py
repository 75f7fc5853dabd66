"""Facts of the aircraft that its log contains; each reader of an autopilot's logs fills them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import date
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..representation import ShortRepr
from ..vehicle.layouts import Layout

T = TypeVar("T")
Array = NDArray[np.float64]


class SourcedValue(NamedTuple, Generic[T]):
    """A fact of the aircraft, with the parameter or topic that states it.

    Attributes:
        value: Value in SI units.
        source: Parameter or topic of the log, with its content.
    """

    value: T
    source: str


def positive_parameter(params: Mapping[str, float], name: str) -> SourcedValue[float] | None:
    """A parameter that is valid where it is positive; None where it is not, or missing."""
    value = params.get(name, 0.0)
    return SourcedValue(value, f"{name} of the log") if value > 0.0 else None


NO_MULTIROTOR = {
    1: "a fixed-wing aircraft",
    3: "a coaxial helicopter",
    4: "a helicopter",
    5: "an antenna tracker",
    6: "a ground station",
    7: "an airship",
    8: "a balloon",
    9: "a rocket",
    10: "a rover",
    11: "a boat",
    12: "a submarine",
    16: "a flapping wing",
    17: "a kite",
    **dict.fromkeys((*range(19, 26), 47), "a VTOL aircraft, with wings"),
    28: "a parafoil",
    45: "a spacecraft",
    46: "a walking robot",
    **dict.fromkeys((18, 26, 27, *range(30, 35), *range(36, 43), 44, 48), "a device, no aircraft"),
}
"""Vehicles that are no multirotor, by MAV_TYPE of the MAVLink common message set."""


@dataclass(frozen=True, slots=True)
class Place:
    """Place and date of a log.

    Attributes:
        latitude_rad: Geodetic latitude, north positive.
        longitude_rad: Longitude, east positive.
        height_m: Height above the ellipsoid, or above sea level where the log has no other.
        year: Decimal year; None: the log has no date.
    """

    latitude_rad: float
    longitude_rad: float
    height_m: float
    year: float | None

    @classmethod
    def of_degrees(
        cls, latitude: float, longitude: float, height_m: float, year: float | None = None
    ) -> "Place":
        """Place from latitude and longitude in degrees."""
        return cls(math.radians(latitude), math.radians(longitude), float(height_m), year)


def decimal_year(day: date) -> float:
    """Decimal year of a date."""
    return day.year + (day.timetuple().tm_yday - 1) / 365.25


_EARTH_M = 6_371_000.0
"""Mean radius of the Earth, IUGG."""


def local_ned(latitude_deg: Array, longitude_deg: Array, up_m: Array) -> Array:
    """NED coordinates from the first of several places, shape (n,) each, m, shape (n, 3).

    Valid for: some kilometres.
    """
    lat, lng = np.radians(latitude_deg), np.radians(longitude_deg)
    north = _EARTH_M * (lat - lat[0])
    east = _EARTH_M * np.cos(lat[0]) * (lng - lng[0])
    return np.column_stack([north, east, up_m[0] - up_m])


@dataclass(frozen=True, slots=True)
class Cells:
    """The battery as described by the autopilot's parameters.

    Attributes:
        count: Cells in series.
        full_v: Voltage of a full cell.
        empty_v: Voltage of an empty cell.
        capacity_a_s: Capacity of the battery, A s; None: not logged.
        resistance_ohm: Resistance of the whole battery; None: not logged.
    """

    count: int
    full_v: float
    empty_v: float
    capacity_a_s: float | None = None
    resistance_ohm: float | None = None


@dataclass(frozen=True, slots=True)
class ThrustCurve:
    """Thrust over motor command, as the autopilot models it.

    With x = (u - start) / (full - start) of the command u, thrust over that at full command is
    f x^2 + (1 - f) x.

    Attributes:
        factor: f, 0..1: THR_MDL_FAC of PX4, MOT_THST_EXPO of ArduPilot.
        start: Command of no thrust.
        full: Command of full thrust.
    """

    factor: float
    start: float = 0.0
    full: float = 1.0

    def thrust(self, command: Array) -> Array:
        """Thrust over that at full command, for commands of any shape."""
        x = np.clip((command - self.start) / (self.full - self.start), 0.0, 1.0)
        return np.asarray(self.factor * x * x + (1.0 - self.factor) * x)

    def elasticity(self, command: float) -> float:
        """Relative thrust per relative command, at a command above the start."""
        f, reach = self.factor, self.full - self.start
        x = (command - self.start) / reach
        return command / reach * (2.0 * f * x + 1.0 - f) / (f * x * x + (1.0 - f) * x)


def origin_of(airframe: "Airframe | None") -> Place | None:
    """Origin of the positions of a flight; None where its log does not contain it."""
    return None if airframe is None or airframe.origin is None else airframe.origin.value


@dataclass(frozen=True, slots=True)
class Airframe(ShortRepr):
    """Facts of an aircraft in its log besides the signals; None where the log has no such fact.

    Attributes:
        no_multirotor: Why the vehicle is no multirotor, "" where it may be one.
        rotors: Number of rotors.
        layout: Positions and directions of rotation of the rotors, in the order of `cmd_1..n`.
        thrust: Thrust over command, as the autopilot models it.
        pulse_us: Pulse widths that stand for the commands 0 and 1, us.
        cells: The battery.
        imu_position_m: Position of the accelerometer from the centre of mass, body FRD, three
            numbers.
        accel_cutoff_hz: Cut-off of the low-pass applied to the logged accelerometer.
        gyro_cutoff_hz: Cut-off of the low-pass applied to the logged gyroscope.
        place: Place of the flight.
        origin: Origin of the positions; its height is above sea level.
        filters: Description of filters on board that were not applied to the logged signals.
    """

    no_multirotor: str = ""
    rotors: SourcedValue[int] | None = None
    layout: Layout | None = None
    thrust: SourcedValue[ThrustCurve] | None = None
    pulse_us: SourcedValue[tuple[float, float]] | None = None
    cells: SourcedValue[Cells] | None = None
    imu_position_m: SourcedValue[tuple[float, float, float]] | None = None
    accel_cutoff_hz: SourcedValue[float] | None = None
    gyro_cutoff_hz: SourcedValue[float] | None = None
    place: SourcedValue[Place] | None = None
    filters: str = ""
    origin: SourcedValue[Place] | None = None

    @classmethod
    def together(cls, several: Sequence["Airframe"]) -> "Airframe":
        """Facts of several logs of one aircraft: each from the first log that contains it."""
        facts: dict[str, Any] = {
            f.name: next((v for a in several if (v := getattr(a, f.name))), f.default)
            for f in fields(cls)
        }
        return cls(**facts)
