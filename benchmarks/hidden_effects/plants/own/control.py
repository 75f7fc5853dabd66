"""Flight controller of our own plant: position, velocity, attitude and rate loops in cascade.

It knows the aircraft as the vehicle file has it, and what the sensors tell: the pose at 100 Hz,
the gyroscope at 200 Hz. Source of the attitude loop: Mellinger & Kumar, ICRA 2011, eq. 10.
"""

from dataclasses import dataclass

import numpy as np

from ..missions import CONTROL_HZ
from .parameters import GRAVITY_M_S2, Array, Batch
from .vectors import cross, rotation

_DT_S = 1 / CONTROL_HZ


@dataclass(frozen=True)
class Setpoint:
    """What the controller is asked for at one instant; vectors of shape (3, n), others (n,)."""

    pos: Array
    vel: Array
    acc: Array
    yaw: Array
    yaw_rate: Array
    armed: np.ndarray[tuple[int], np.dtype[np.bool_]]


class Controller:
    """Cascade of the flights of one batch.

    Gains are for a rotor lag near 35 ms: rate loop 9 rad/s, attitude 4.5, velocity 2.6,
    position 1.2. Yaw gets what 45 % of the rotors' reaction torque gives, no more.

    Args:
        believed: The aircraft as the vehicle files have them.
        trim: Angular acceleration that hover needs, rad/s2, shape (3, n): what a pilot has
            trimmed on an earlier flight. It goes with the thrust.
    """

    def __init__(self, believed: Batch, trim: Array) -> None:
        p = believed.p
        self._p = p
        rotors, n = p.thrust_k.shape
        self._mix = np.empty((rotors, 4, n))
        for i in range(n):
            effect_of = [  # of each thrust on total thrust and moments
                np.ones(rotors),
                -p.hubs[:, 1, i],
                p.hubs[:, 0, i],
                -(p.direction * p.torque_k / p.thrust_k)[:, i],
            ]
            self._mix[:, :, i] = np.linalg.pinv(np.stack(effect_of))
        ratio = (p.torque_k / p.thrust_k).mean(axis=0)
        self._yaw_limit = 0.45 * ratio * p.mass * GRAVITY_M_S2 / p.inertia[2]
        self._velocity_integral = np.zeros((3, n))
        self._trim = trim
        self._rate_integral = np.zeros((3, n))
        self._gyro_before = np.zeros((3, n))

    def __call__(self, want: Setpoint, pos: Array, vel: Array, q: Array, gyro: Array) -> Array:
        """Commands 0..1, shape (r, n)."""
        p = self._p
        velocity_error = want.vel + 1.2 * (want.pos - pos) - vel
        armed = want.armed.astype(np.float64)
        self._velocity_integral += 0.6 * _DT_S * armed * velocity_error
        acc = want.acc + np.clip(2.6 * velocity_error, -6, 6) + self._velocity_integral
        acc[2] -= GRAVITY_M_S2
        torque, lift = self._attitude(want, acc, q, gyro, armed)
        wrench = np.stack([p.mass * lift, *(p.inertia * torque)])
        thrust = (self._mix * wrench).sum(axis=1)
        level = np.sqrt(np.maximum(thrust, 0.0) / p.thrust_k)
        return np.asarray(np.clip((level - p.speed_0) / p.speed_1, 0.0, 1.0) * armed)

    def _attitude(
        self, want: Setpoint, acc: Array, q: Array, gyro: Array, armed: Array
    ) -> tuple[Array, Array]:
        """Angular acceleration wanted, and specific thrust."""
        r = rotation(q / np.sqrt((q * q).sum(axis=0)))
        down = -acc / np.sqrt((acc * acc).sum(axis=0))
        heading = np.arctan2(r[1, 0], r[0, 0])
        off = np.angle(np.exp(1j * (want.yaw - heading)))
        heading = heading + np.clip(off, -0.5, 0.5)
        nose = np.stack([np.cos(heading), np.sin(heading), 0 * heading])
        right = cross(down, nose)
        right /= np.sqrt((right * right).sum(axis=0))
        forward = cross(right, down)
        x, y, z = r[:, 0], r[:, 1], r[:, 2]
        error = 0.5 * np.stack(
            [
                (down * y - right * z).sum(axis=0),
                (forward * z - down * x).sum(axis=0),
                (right * x - forward * y).sum(axis=0),
            ]
        )
        rate = -4.5 * error
        rate[2] = 0.5 * rate[2] + want.yaw_rate
        rate_error = np.clip(rate, -6, 6) - gyro
        self._rate_integral += 8.0 * _DT_S * armed * rate_error
        bend = (gyro - self._gyro_before) / _DT_S
        self._gyro_before = gyro
        lift = np.maximum(-(acc * z).sum(axis=0), 0.3 * GRAVITY_M_S2)
        trim = self._trim * lift / GRAVITY_M_S2
        torque = 9.0 * rate_error + self._rate_integral - 0.08 * bend + trim
        wanted = 0.5 * torque[2]
        torque[2] = np.clip(wanted, -self._yaw_limit, self._yaw_limit)
        self._rate_integral[2] += torque[2] - wanted  # no wind-up
        return torque, lift
