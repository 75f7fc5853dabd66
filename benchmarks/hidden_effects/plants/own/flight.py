"""Our own plant in flight: finer physics than the twin's, a controller in the loop, many at once.

Flight controller of our own plant: position, velocity, attitude and rate loops in cascade.

It knows the aircraft as the vehicle file has it, and what the sensors tell: the pose at 100 Hz,
the gyroscope at 200 Hz. Source of the attitude loop: Mellinger & Kumar, ICRA 2011, eq. 10.

Fixed steps of `STEP_S` by the two-step Adams-Bashforth rule; commands at 200 Hz, held. Delays
are whole steps and are taken from the fine simulation itself.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..missions import CONTROL_HZ, Draws, Order, between, draw
from .parameters import GRAVITY_M_S2, STEP_S, Array, Batch
from .physics import (
    ROPE_RAD_S,
    Dynamics,
    Layout,
    Motion,
    Simulator,
    cross,
    motion,
    own_dynamics,
    rotation,
    to_ned,
    turned,
)

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


STEPS = round(1 / (CONTROL_HZ * STEP_S))
"""Steps of the plant per sample of controller and IMU."""
POSE_EVERY = 2
"""Samples of the IMU per sample of the position sensor."""


@dataclass(frozen=True)
class Trace:
    """True course of the flights at 200 Hz, shape (k, channels, n); no sensor errors.

    Readings of the IMU and the position sensor are taken earlier by their delays.

    Attributes:
        imu_force: Specific force at the accelerometer, unfiltered, delayed.
        acc: The same behind the low-pass.
        gyro: Body rates at the gyroscope, delayed.
        pose: Position and velocity of the marker, attitude, delayed.
        truth: Position, velocity, attitude, body rates of the centre of mass, then angular
            acceleration, current, voltage and square of the air speed; not delayed.
        rotor: Rotor speeds.
        command: As the controller gave them.
    """

    imu_force: Array
    acc: Array
    gyro: Array
    pose: Array
    truth: Array
    rotor: Array
    command: Array
    draws: Draws


def fly(orders: list[Order], dynamics: Dynamics = own_dynamics) -> Trace:
    """Fly missions all at once, with aircraft of equally many rotors."""
    batch = Batch([o.plant for o in orders])
    layout = Layout(batch.rotors)
    draws = draw(orders)
    simulator = dynamics if isinstance(dynamics, Simulator) else None
    about_hover = own_dynamics if simulator else dynamics
    controller = Controller(
        Batch([o.aircraft.nominal for o in orders]), -_hover_error(batch, layout, about_hover)
    )
    want = _setpoints(orders)
    x = _start(batch, layout)
    if simulator:
        simulator.begin(batch, x[layout.pos].copy())
    applied = np.zeros((batch.rotors, batch.n))
    at = motion(batch, layout, x, applied, draws.gust[0], 0.0, dynamics)
    k_max = len(draws.gust)
    records = {
        name: np.repeat(now[None], k_max, axis=0)
        for name, now in {
            **_readings(layout, x, at),
            "pose": _pose(batch, layout, x),
            "truth": _truth(layout, x, at, draws.gust[0]),
            "rotor": x[layout.rotor],
            "command": applied,
        }.items()
    }
    before = at.rate
    imu, pose = _Schedule(batch.p.imu_delay), _Schedule(batch.p.position_delay)
    commands = _Schedule(-batch.p.command_delay)

    for step in range(k_max * STEPS):
        k, j = divmod(step, STEPS)
        for flights, rows in pose(step, k_max):
            records["pose"][rows, :, flights] = _pose(batch, layout, x)[:, flights].T
        if j == 0:
            if k % POSE_EVERY == 0:
                sensed = _sensed(layout, x, records["pose"][k], draws, k)
            gyro = batch.p.gyro_scale * x[layout.omega] + batch.p.gyro_bias + draws.gyro[k]
            setpoint = Setpoint(*(w[k] for w in want))
            records["command"][k] = controller(setpoint, *sensed, gyro)
        for flights, rows in commands(step, k_max):
            applied[:, flights] = records["command"][rows, :, flights].T
        wind = batch.p.wind + between(draws.gust, k, j / STEPS)
        at = motion(batch, layout, x, applied, wind, step * STEP_S, dynamics)
        if j == 0:
            records["truth"][k] = _truth(layout, x, at, wind)
            records["rotor"][k] = x[layout.rotor]
        for flights, rows in imu(step, k_max):
            for name, now in _readings(layout, x, at).items():
                records[name][rows, :, flights] = now[:, flights].T
        x, before = advance(batch, layout, x, at, before)
        if simulator:
            simulator.step(layout, x, applied, wind)
    if not np.all(np.isfinite(records["truth"])):
        k, _, i = np.argwhere(~np.isfinite(records["truth"]))[0]
        raise FloatingPointError(
            f"flight {i} of {orders[i].aircraft.name}, seed {orders[i].seed}, is not finite "
            f"from {k / CONTROL_HZ} s on"
        )
    return Trace(**records, draws=draws)


def advance(
    batch: Batch, layout: Layout, x: Array, at: Motion, before: Array
) -> tuple[Array, Array]:
    """One step; returns the new state and the rates for the next step.

    Two-step Adams-Bashforth rule; rotor speeds, whose target jumps with the commands, by their
    exact solution.
    """
    later = x + STEP_S * (1.5 * at.rate - 0.5 * before)
    rotor = x[layout.rotor]
    later[layout.rotor] = at.target + (rotor - at.target) * np.exp(-STEP_S / batch.p.lag)
    later[layout.phase] = x[layout.phase] + 0.5 * STEP_S * (rotor + later[layout.rotor])
    later[layout.q] /= np.sqrt((later[layout.q] ** 2).sum(axis=0))
    return later, at.rate


def _hover_error(batch: Batch, layout: Layout, dynamics: Dynamics) -> Array:
    """Angular acceleration in level hover at the rotor speeds of the vehicle file, rad/s2."""
    p = batch.p
    x = _start(batch, layout)
    x[layout.pos][2] = -100.0
    x[layout.rotor] = p.hover_speed
    command = np.broadcast_to((p.hover_speed - p.speed_0) / p.speed_1, x[layout.rotor].shape)
    at = motion(batch, layout, x, command, np.zeros((3, batch.n)), 0.0, dynamics)
    return at.angular_acceleration


class _Schedule:
    """Which flights take a sample at a step, when each takes row k at step k STEPS - lead."""

    def __init__(self, leads: Array | int) -> None:
        lead = np.asarray(leads, dtype=np.int64)
        self._groups: list[tuple[int, NDArray[np.int64]]] = [
            (int(d), np.flatnonzero(lead == d)) for d in np.unique(lead)
        ]

    def __call__(self, step: int, rows: int) -> Iterator[tuple[NDArray[np.int64], int]]:
        """Flights, and the row that they take."""
        for lead, flights in self._groups:
            row, rest = divmod(step + lead, STEPS)
            if rest == 0 and 0 <= row < rows:
                yield flights, row


def _start(batch: Batch, layout: Layout) -> Array:
    """At rest on the ground, rotors idle, load hanging straight down."""
    p = batch.p
    x = np.zeros((layout.size, batch.n))
    x[layout.pos][2] = GRAVITY_M_S2 / 80.0**2 - p.leg
    x[layout.q][0] = 1.0
    x[layout.rope][2] = p.load_length + GRAVITY_M_S2 / ROPE_RAD_S**2
    x[layout.acc][2] = -GRAVITY_M_S2
    x[layout.charge] = p.charge
    x[layout.rotor] = p.speed_0
    x[layout.phase] = np.arange(batch.rotors)[:, None]
    return x


def _pose(batch: Batch, layout: Layout, x: Array) -> Array:
    """Position and velocity of the marker, and attitude, shape (10, n)."""
    r = rotation(x[layout.q])
    arm = to_ned(r, batch.p.marker)
    swing = to_ned(r, cross(x[layout.omega], batch.p.marker))
    return np.concatenate([x[layout.pos] + arm, x[layout.vel] + swing, x[layout.q]])


def _sensed(
    layout: Layout, x: Array, late: Array, draws: Draws, k: int
) -> tuple[Array, Array, Array]:
    """Position and velocity that the controller gets, and attitude, its own and never late."""
    attitude = turned(x[layout.q], draws.attitude[k])
    return late[:3] + draws.pos[k], late[3:6] + draws.vel[k], attitude


def _readings(layout: Layout, x: Array, at: Motion) -> dict[str, Array]:
    return {"imu_force": at.imu_force, "acc": x[layout.acc], "gyro": at.shaken}


def _truth(layout: Layout, x: Array, at: Motion, wind: Array) -> Array:
    air = x[layout.vel] - wind
    last = np.stack([at.current, at.voltage, (air * air).sum(axis=0)])
    return np.concatenate([x[:13], at.angular_acceleration, last])


def _setpoints(orders: list[Order]) -> list[Array]:
    """Position, velocity, acceleration, heading, its rate and arming, flights last."""
    names = ("pos", "vel", "acc", "yaw", "yaw_rate", "armed")
    return [np.stack([getattr(o.setpoints, name) for o in orders], axis=-1) for name in names]
