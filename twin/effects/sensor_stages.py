"""Stages of the sensors' equations that effects change, in the order of the computation."""

from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True, slots=True)
class Mounting:
    """Where the accelerometer sits: from the centre of mass, body FRD, m."""

    arm_b: list[ca.SX]


@dataclass(frozen=True, slots=True)
class ImuMotion:
    """What arrives at the IMU.

    Attributes:
        specific_force_b: At the accelerometer, m/s2.
        omega_b: Body rates, rad/s.
        spin: Rotor speeds over that in hover; empty where no effect asks for them.
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
    """How old a reading is when it comes out.

    Attributes:
        late: Whether readings are delayed samples at all, 0 or 1.
        delay_s: Their age, s.
    """

    late: ca.SX
    delay_s: ca.SX


@dataclass(frozen=True, slots=True)
class Freezing:
    """Which readings stand still.

    Attributes:
        time_s: Time since the start, s.
        stuck: Per channel, 0 or 1: from this sample instant on the last value is repeated.
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
        field_b: Body FRD, T.
        current: Of the battery, A; 0 where no effect asks for it.
    """

    field_b: list[ca.SX]
    current: ca.SX


@dataclass(frozen=True, slots=True)
class BaroReading:
    """Reading of the barometer before noise.

    Attributes:
        pressure: Pa.
        dynamic: Dynamic pressure of the air relative to the vehicle, Pa; 0 where no effect asks
            for it.
    """

    pressure: ca.SX
    dynamic: ca.SX
