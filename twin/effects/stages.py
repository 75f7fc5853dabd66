"""Stages of the components' equations that effects change, in the order of the computation."""

from dataclasses import dataclass

import casadi as ca

from ..frames import cross

AIR_DENSITY_KG_M3 = 1.225
"""Density of the air, ISA at sea level, ICAO Doc 7488."""


@dataclass(frozen=True, slots=True)
class Body:
    """Mass properties about the centre of mass, body FRD.

    Attributes:
        mass: Mass, kg.
        inertia: Inertia matrix, kg m2, 3 rows of 3.
        hubs: Positions of the rotor hubs, m, one [x, y, z] per rotor.
        origin: Centre of mass by the numbers of the vehicle, m.
    """

    mass: ca.SX
    inertia: list[list[ca.SX]]
    hubs: list[list[ca.SX]]
    origin: list[ca.SX]


@dataclass(frozen=True, slots=True)
class Air:
    """The air around the vehicle: velocity NED, m/s."""

    wind_n: list[ca.SX]


@dataclass(frozen=True, slots=True)
class Motors:
    """Motor commands and lags of the rotors.

    Attributes:
        command: Motor commands 0..1.
        lag_up: Time constant when speeding up, s.
        lag_down: Time constant when slowing down, s.
    """

    command: list[ca.SX]
    lag_up: ca.SX
    lag_down: ca.SX


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion of the vehicle through the air; later stages do not change it.

    Attributes:
        body: Mass properties.
        pos_n: Position NED, m.
        vel_n: Velocity NED, m/s.
        q_nb: Attitude, body to NED.
        omega_b: Body rates, rad/s.
        air_b: Velocity through the air, body FRD, m/s.
        height: Height of the centre of mass over the ground, m.
        density: Air density relative to that for which the vehicle's numbers are valid.
        gravity: Gravity, m/s2.
        voltage: Battery voltage, V.
        start_vel_n: Velocity NED at the start of the simulation, m/s.
    """

    body: Body
    pos_n: list[ca.SX]
    vel_n: list[ca.SX]
    q_nb: list[ca.SX]
    omega_b: list[ca.SX]
    air_b: list[ca.SX]
    height: ca.SX
    density: ca.SX
    gravity: ca.SX
    voltage: ca.SX
    start_vel_n: list[ca.SX]

    @property
    def hubs_air_b(self) -> list[list[ca.SX]]:
        """Velocity of each rotor hub through the air, body FRD, m/s."""
        return [
            [v + c for v, c in zip(self.air_b, cross(self.omega_b, hub), strict=True)]
            for hub in self.body.hubs
        ]


@dataclass(frozen=True, slots=True)
class Thrust:
    """Thrust and torque of each rotor.

    Attributes:
        motion: Motion of the vehicle.
        direction: Direction of rotation: +1 clockwise seen from above, -1 counter-clockwise.
        hover: Thrust of one rotor in hover by the vehicle's numbers, N.
        spin: Rotor speed relative to hover.
        spin_rate: Time derivative of the relative rotor speed, 1/s.
        thrust: Thrust along body -z, N.
        torque: Reaction torque, N m, a positive number.
    """

    motion: Motion
    direction: list[float]
    hover: float
    spin: list[ca.SX]
    spin_rate: list[ca.SX]
    thrust: list[ca.SX]
    torque: list[ca.SX]


@dataclass(frozen=True, slots=True)
class Wrench:
    """Force, N, and moment about the centre of mass, N m, body FRD, without contact with the
    ground."""

    rotors: Thrust
    force: list[ca.SX]
    moment: list[ca.SX]

    @property
    def motion(self) -> Motion:
        """Motion of the vehicle."""
        return self.rotors.motion


@dataclass(frozen=True, slots=True)
class Mounting:
    """Position of the accelerometer from the centre of mass, body FRD, m."""

    arm_b: list[ca.SX]


@dataclass(frozen=True, slots=True)
class ImuMotion:
    """Motion at the IMU.

    Attributes:
        specific_force_b: Specific force at the accelerometer, m/s2.
        omega_b: Body rates, rad/s.
        spin: Rotor speeds relative to hover; empty where no effect needs them.
    """

    specific_force_b: list[ca.SX]
    omega_b: list[ca.SX]
    spin: list[ca.SX]


@dataclass(frozen=True, slots=True)
class ImuReading:
    """Readings of the IMU before noise: accelerometer, m/s2, and gyroscope, rad/s."""

    acc: list[ca.SX]
    gyro: list[ca.SX]


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """Standard deviation of the white noise of accelerometer, m/s2, and gyroscope, rad/s."""

    acc: ca.SX
    gyro: ca.SX


@dataclass(frozen=True, slots=True)
class Latency:
    """Age of a reading at the output.

    Attributes:
        late: Whether readings are delayed samples, 0 or 1.
        delay_s: Age of the readings, s.
    """

    late: ca.SX
    delay_s: ca.SX


@dataclass(frozen=True, slots=True)
class Freezing:
    """Readings that are frozen.

    Attributes:
        time_s: Time since the start, s.
        stuck: Per channel, 0 or 1: from this sample instant the last value is repeated.
    """

    time_s: ca.SX
    stuck: list[ca.SX]


@dataclass(frozen=True, slots=True)
class EarthField:
    """Magnetic flux density around the vehicle, NED, T."""

    field_n: list[ca.SX]


@dataclass(frozen=True, slots=True)
class MagReading:
    """Reading of the magnetometer before noise.

    Attributes:
        field_b: Magnetic flux density, body FRD, T.
        current: Current of the battery, A; 0 where no effect needs it.
    """

    field_b: list[ca.SX]
    current: ca.SX


@dataclass(frozen=True, slots=True)
class BaroReading:
    """Reading of the barometer before noise.

    Attributes:
        pressure: Static pressure, Pa.
        dynamic: Dynamic pressure of the air relative to the vehicle, Pa; 0 where no effect needs
            it.
    """

    pressure: ca.SX
    dynamic: ca.SX
