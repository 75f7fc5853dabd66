"""Noise levels of the sensors, as standard deviations of one reading."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Noise:
    """White noise of one reading.

    Attributes:
        accel: m/s2.
        gyro: rad/s.
        position: m.
        velocity: m/s.
        attitude: rad, about each body axis.
        mag: T.
        baro: Pa.
        voltage: V.
        quantised: Whether readings of the IMU are multiples of the last bit.
    """

    accel: float
    gyro: float
    position: float
    velocity: float
    attitude: float
    mag: float
    baro: float
    voltage: float
    quantised: bool = True


NOISE = {
    "none": Noise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, quantised=False),
    "low": Noise(0.02, 0.001, 5e-4, 0.005, 5e-4, 1e-7, 2.0, 0.002),
    "medium": Noise(0.08, 0.004, 2e-3, 0.02, 1.5e-3, 3e-7, 5.0, 0.01),
    "high": Noise(0.3, 0.012, 1e-2, 0.06, 4e-3, 1e-6, 12.0, 0.03),
}
"""Made up: a good, a usual and a poor set of sensors; "none" is for tests."""
ACCEL_BIT_M_S2 = 16 * 9.80665 / 2**15
"""Last bit of a 16-bit accelerometer of +-16 g."""
GYRO_BIT_RAD_S = 2000.0 / 2**15 * 0.017453292519943295
"""Last bit of a 16-bit gyroscope of +-2000 deg/s."""
