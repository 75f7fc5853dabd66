"""Equations of motion of our own plant, for many flights at once.

    m dv/dt     = m g e_z + R F + contact + pull of the load        (NED)
    J domega/dt = M - omega x (J omega)                             (body FRD)

Every array has a last axis over flights; only element-wise operations are used, so that a flight
comes out the same to the last bit in whatever company it is computed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from .forces import air_forces, pad_forces, rotor_forces, unbalance
from .parameters import GRAVITY_M_S2, Array, Batch
from .vectors import cross, quaternion_rate, rotation, to_body, to_ned

_SWING_DAMPING_1_S = 0.05
"""Of the load on its rope, by the air; made up."""


class Layout:
    """Where each state lies in the first axis of the state array."""

    def __init__(self, rotors: int) -> None:
        self.pos, self.vel, self.q, self.omega = (
            slice(0, 3),
            slice(3, 6),
            slice(6, 10),
            slice(10, 13),
        )
        self.rope, self.swing = slice(13, 16), slice(16, 19)
        self.acc, self.acc_rate = slice(19, 22), slice(22, 25)
        self.charge = 25
        self.rotor = slice(26, 26 + rotors)
        self.phase = slice(26 + rotors, 26 + 2 * rotors)
        self.size = 26 + 2 * rotors


@dataclass(frozen=True)
class Instant:
    """What a plant knows of itself when it computes its accelerations.

    Attributes:
        pos: NED, m, shape (3, n).
        vel: NED, m/s.
        air: Velocity through the air, body, m/s.
        q: Attitude body to NED, unit quaternions, shape (4, n).
        r: The same as matrices, shape (3, 3, n).
        omega: Body rates, rad/s.
        rotor: Rotor speeds, rad/s, shape (rotors, n).
        target: Speeds that the rotors strive for.
        command: As the motors receive them, 0..1.
        t: Time since the start, s.
    """

    pos: Array
    vel: Array
    air: Array
    q: Array
    r: Array
    omega: Array
    rotor: Array
    target: Array
    command: Array
    t: float


Dynamics = Callable[[Batch, Instant], tuple[Array, Array]]
"""Force without weight, N, and angular acceleration, rad/s2, both in body axes."""


@runtime_checkable
class Simulator(Protocol):
    """Dynamics with a state of their own, which they integrate themselves."""

    def begin(self, batch: Batch, start: Array) -> None:
        """Be ready for a batch, at rest at these positions, NED, m."""

    def __call__(self, batch: Batch, now: Instant) -> tuple[Array, Array]:
        """Force without weight and angular acceleration at the state of the simulator."""

    def step(self, layout: Layout, x: Array, command: Array, wind: Array) -> None:
        """Go on by one step and write position, velocity, attitude, rates and rotors to `x`."""


@dataclass(frozen=True)
class Motion:
    """What follows from a state.

    Attributes:
        angular_acceleration: Body, rad/s2, shape (3, n).
        imu_force: Specific force at the accelerometer, body, m/s2.
        shaken: Body rates at the gyroscope, rad/s.
        rate: Time derivative of the state.
        target: Speed that the rotors strive for, rad/s, shape (r, n).
        voltage: Of the battery, V, shape (n,).
        current: A.
    """

    angular_acceleration: Array
    imu_force: Array
    shaken: Array
    rate: Array
    target: Array
    voltage: Array
    current: Array


def own_dynamics(batch: Batch, now: Instant) -> tuple[Array, Array]:
    """Force and angular acceleration of our own plant, without the load on its rope."""
    p, omega, rotor, air = batch.p, now.omega, now.rotor, now.air
    hubs = p.hubs.transpose(1, 0, 2)
    height = -now.pos[2] - (now.r[2][:, None] * hubs).sum(axis=0)
    at_rotors = rotor_forces(batch, rotor, air, omega, height)
    force, moment = air_forces(batch, air, now.command, now.t)
    force = force + at_rotors.sum(axis=1)
    moment = moment + cross(hubs, at_rotors).sum(axis=1)
    moment[2] -= (p.direction * (p.torque_k * rotor * rotor)).sum(axis=0)
    if batch.on("flap"):
        raised = p.flap / (rotor * p.radius) * p.thrust_k * rotor * rotor * p.flap_height
        moment[0] -= (raised * air[1]).sum(axis=0)
        moment[1] += (raised * air[0]).sum(axis=0)
    if batch.on("spin_inertia_yaw"):
        spin_up = (now.target - rotor) / p.lag
        moment[2] -= (p.direction * p.spin_inertia_yaw * spin_up).sum(axis=0)
    if batch.on("spin_inertia_gyro"):
        spin = p.spin_inertia_gyro * (p.direction * rotor).sum(axis=0)
        moment[0] -= omega[1] * spin
        moment[1] += omega[0] * spin
    if batch.on("pitch_per_yaw"):
        moment[1] += p.pitch_per_yaw * omega[2]
    push, twist = pad_forces(batch, now.pos[2], now.vel, omega, now.r)
    moment = moment + twist
    return force + push, (moment - cross(omega, p.inertia * omega)) / p.inertia


def motion(
    batch: Batch,
    layout: Layout,
    x: Array,
    command: Array,
    wind: Array,
    t: float,
    dynamics: Dynamics = own_dynamics,
) -> Motion:
    """Everything that follows from a state.

    Args:
        batch: Parameters.
        layout: Of the state.
        x: States, shape (layout.size, n); unit quaternions to second order of the step.
        command: As the motors receive them, 0..1, shape (r, n).
        wind: Velocity of the air, NED, m/s, shape (3, n).
        t: Time since the start, s.
        dynamics: The plant; rotor lag, battery, load and sensors are the same for all.
    """
    p = batch.p
    omega, rotor, q = x[layout.omega], x[layout.rotor], x[layout.q]
    unit = q / np.sqrt((q * q).sum(axis=0))
    r = rotation(unit)
    voltage, current = _battery(batch, rotor, x[layout.charge])
    target = _target(batch, command, voltage)
    air = to_body(r, x[layout.vel] - wind)
    force, alpha = dynamics(
        batch,
        Instant(x[layout.pos], x[layout.vel], air, unit, r, omega, rotor, target, command, t),
    )
    rate = np.empty_like(x)
    if batch.on("load_mass"):
        rope, swing = x[layout.rope], x[layout.swing]
        pull, rate[layout.swing] = _load(batch, rope, swing, to_ned(r, force))
        rate[layout.rope] = swing
        force = force + to_body(r, pull)
    else:
        rate[layout.rope] = rate[layout.swing] = 0.0
    specific = force / p.mass
    imu_force, shaken = specific, omega
    if batch.on("imu_arm"):
        imu_force = specific + cross(alpha, p.imu_arm) + cross(omega, cross(omega, p.imu_arm))
    if batch.on("shake_accel") or batch.on("shake_gyro"):
        shake = unbalance(batch, rotor, x[layout.phase])
        imu_force, shaken = imu_force + p.shake_accel * shake, omega + p.shake_gyro * shake
    acceleration = to_ned(r, specific)
    acceleration[2] += GRAVITY_M_S2
    low = 2 * np.pi * p.accel_cutoff_hz
    rate[layout.pos], rate[layout.vel] = x[layout.vel], acceleration
    rate[layout.q], rate[layout.omega] = quaternion_rate(q, omega), alpha
    rate[layout.acc] = x[layout.acc_rate]
    rate[layout.acc_rate] = (
        low * low * (imu_force - x[layout.acc]) - np.sqrt(2.0) * low * x[layout.acc_rate]
    )
    rate[layout.charge] = -current / p.capacity
    rate[layout.rotor], rate[layout.phase] = (target - rotor) / p.lag, rotor
    return Motion(alpha, imu_force, shaken, rate, target, voltage, current)


def _load(batch: Batch, rope: Array, swing: Array, force: Array) -> tuple[Array, Array]:
    """Pull of a point mass on a straight rope, NED, N, and the acceleration of its direction.

    From Lagrange's equations with the length of the rope as a constraint, as in Sreenath, Michael
    & Kumar, ICRA 2013, eq. 2 to 5. `rope` is the unit vector from vehicle to load.
    """
    p = batch.p
    free = force / p.mass
    along = (rope * free).sum(axis=0)
    square = (swing * swing).sum(axis=0)
    reduced = p.load_mass * p.mass / (p.load_mass + p.mass)
    tension = reduced * (p.load_length * square - along)
    bend = (along * rope - free) / p.load_length - square * rope - _SWING_DAMPING_1_S * swing
    return tension * rope, bend


def _target(batch: Batch, command: Array, voltage: Array) -> Array:
    """Speed that the rotors strive for."""
    p = batch.p
    target = p.speed_0 + p.speed_1 * command
    if not batch.on("voltage_exponent"):
        return np.asarray(target)
    sag = (voltage / p.reference_v) ** p.voltage_exponent
    return np.asarray(target * np.where(p.voltage_exponent == 0.0, 1.0, sag))


def _battery(batch: Batch, rotor: Array, charge: Array) -> tuple[Array, Array]:
    """Voltage and current: induced power grows with thrust^1.5, so with speed^3."""
    p = batch.p
    load = rotor / p.hover_speed
    current = p.hover_current * (0.03 + (load * load * load).sum(axis=0) / batch.rotors)
    voltage = p.empty_v + (p.full_v - p.empty_v) * charge - p.resistance * current
    return voltage, current
