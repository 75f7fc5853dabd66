"""Our own plant: finer physics than the twin's, a controller in the loop, many flights at once.

Fixed steps of `STEP_S` by the two-step Adams-Bashforth rule; commands at 200 Hz, held. Delays
are whole steps and are taken from the fine simulation itself.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..missions import CONTROL_HZ
from ..orders import Draws, Order, between, draw
from .control import Controller, Setpoint
from .parameters import GRAVITY_M_S2, STEP_S, Array, Batch
from .physics import Dynamics, Layout, Motion, Simulator, motion, own_dynamics
from .vectors import cross, rotation, to_ned, turned

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
    if batch.on("load_mass"):
        rope = later[layout.rope] / np.sqrt((later[layout.rope] ** 2).sum(axis=0))
        later[layout.swing] -= (rope * later[layout.swing]).sum(axis=0) * rope
        later[layout.rope] = rope
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
    x[layout.rope][2] = 1.0
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
    return {"felt": at.imu_force, "acc": x[layout.acc], "gyro": at.shaken}


def _truth(layout: Layout, x: Array, at: Motion, wind: Array) -> Array:
    air = x[layout.vel] - wind
    last = np.stack([at.current, at.voltage, (air * air).sum(axis=0)])
    return np.concatenate([x[:13], at.angular_acceleration, last])


def _setpoints(orders: list[Order]) -> list[Array]:
    """Position, velocity, acceleration, heading, its rate and arming, flights last."""
    names = ("pos", "vel", "acc", "yaw", "yaw_rate", "armed")
    return [np.stack([getattr(o.setpoints, name) for o in orders], axis=-1) for name in names]
