"""Equations of motion of our own plant, for many flights at once.

Thrust of a rotor from blade elements and momentum.

With the inflow x and climb c in units of the induced velocity of hover at the same rotor speed,
and h the speed along the disc in the same unit:

    blade element   T / T_hover = 1 + gain (1 - x),     gain = solidity lift_slope / (8 lambda)
    momentum        (x - c) sqrt(h^2 + x^2) = T / T_hover

Source: Leishman, Principles of Helicopter Aerodynamics, 2nd ed., eq. 3.22 (blade element at
constant pitch, uniform inflow) and 2.126 (Glauert's momentum theory at any advance ratio).

    m dv/dt     = m g e_z + R F + contact + pull of the load        (NED)
    J domega/dt = M - omega x (J omega)                             (body FRD)

Every array has a last axis over flights; only element-wise operations are used, so that a flight
comes out the same to the last bit in whatever company it is computed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from .parameters import AIR_DENSITY_KG_M3, GRAVITY_M_S2, Array, Batch


def cross(a: Array, b: Array) -> Array:
    """Cross product over the first axis; one shape must hold the other."""
    c = np.empty(a.shape if a.size >= b.size else b.shape)
    c[0] = a[1] * b[2] - a[2] * b[1]
    c[1] = a[2] * b[0] - a[0] * b[2]
    c[2] = a[0] * b[1] - a[1] * b[0]
    return c


def rotation(q: Array) -> Array:
    """Matrix body to NED of unit quaternions, shape (3, 3, n)."""
    w, x, y, z = q
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    wx, wy, wz = w * x, w * y, w * z
    r = np.empty((3, 3, q.shape[1]))
    r[0, 0], r[1, 1], r[2, 2] = 1 - 2 * (yy + zz), 1 - 2 * (xx + zz), 1 - 2 * (xx + yy)
    r[0, 1], r[1, 0] = 2 * (xy - wz), 2 * (xy + wz)
    r[0, 2], r[2, 0] = 2 * (xz + wy), 2 * (xz - wy)
    r[1, 2], r[2, 1] = 2 * (yz - wx), 2 * (yz + wx)
    return r


def to_ned(r: Array, v: Array) -> Array:
    """Body vectors in NED."""
    return np.asarray((r * v).sum(axis=1))


def to_body(r: Array, v: Array) -> Array:
    """NED vectors in body axes."""
    return np.asarray((r * v[:, None]).sum(axis=0))


def quaternion_rate(q: Array, omega: Array) -> Array:
    """Time derivative of quaternions body to NED turning with body rates."""
    half = 0.5 * omega
    rate = np.empty_like(q)
    rate[0] = -(q[1:] * half).sum(axis=0)
    rate[1:] = q[0] * half + cross(q[1:], half)
    return rate


def turned(q: Array, angle: Array) -> Array:
    """Attitudes after small turns about the body axes, rad; shapes (4, n) and (3, n)."""
    w, v = q[0], q[1:]
    half = 0.5 * angle
    q = np.concatenate([(w - (v * half).sum(axis=0))[None], v + w * half + cross(v, half)])
    return np.asarray(q / np.sqrt((q * q).sum(axis=0)))


_NEWTON_STEPS = 6


def induced_velocity(thrust: Array, radius: Array | float) -> Array:
    """Induced velocity in hover, m/s. Source: Leishman, eq. 2.14."""
    return np.asarray(np.sqrt(thrust / (2 * AIR_DENSITY_KG_M3 * np.pi * radius**2)))


def thrust_ratio(gain: Array | float, climb: Array, along: Array) -> Array:
    """Thrust over that in hover at the same rotor speed.

    Args:
        gain: Relative change of thrust per relative change of inflow.
        climb: Speed of the rotor along its thrust over the induced velocity in hover.
        along: Speed along the disc over the same.

    Valid for: climb > -1; slower than the vortex ring.
    """
    x = np.maximum(1 + climb / (2 + gain), 0.2)
    for _ in range(_NEWTON_STEPS):
        root = np.sqrt(along * along + x * x)
        value = (x - climb) * root - 1 - gain * (1 - x)
        slope = root + (x - climb) * x / root + gain
        x = np.maximum(x - value / slope, 0.05)
    return np.asarray(1 + gain * (1 - x))


def climb_slope(gain: float, hover_velocity: float) -> float:
    """Share of the thrust lost per climb speed about hover, s/m: the derivative of the above."""
    return gain / ((2 + gain) * hover_velocity)


_PAD_RAD_S, _PAD_DAMPING = 80.0, 0.7
"""Natural frequency and damping of the ground under the whole weight."""


def rotor_forces(batch: Batch, rotor: Array, air: Array, omega: Array, height: Array) -> Array:
    """Force of each rotor in body axes, N, shape (3, r, n); `height` of the hubs, m."""
    p, on = batch.p, batch.on
    force = np.zeros((3, *rotor.shape))
    hover = p.thrust_k * p.hover_speed**2
    thrust = p.thrust_k * rotor * rotor
    if np.any(p.thrust_exponent != 1.0):
        curved = hover * (thrust / hover) ** p.thrust_exponent
        thrust = np.where(p.thrust_exponent == 1.0, thrust, curved)
    if not any(on(k) for k in ("inflow_gain", "rotor_h", "flap", "ground_effect", "tilt")):
        force[2] = -thrust
        return force
    hub = cross(np.broadcast_to(omega[:, None], (3, *rotor.shape)), p.hubs.transpose(1, 0, 2))
    hub += air[:, None]
    if on("inflow_gain"):
        unit = induced_velocity(hover, p.radius) * rotor / p.hover_speed
        along = np.sqrt(hub[0] ** 2 + hub[1] ** 2)
        ratio = thrust_ratio(
            p.inflow_gain, -hub[2] / unit * p.inflow_axial, along / unit * p.inflow_forward
        )
        thrust = np.where(p.inflow_gain == 0.0, thrust, thrust * ratio)
    if on("ground_effect"):
        near = p.radius / (4 * np.maximum(height, 0.9 * p.radius))
        thrust = thrust / (1 - p.ground_effect * near * near)
    back = p.rotor_h * rotor + p.flap * thrust / (rotor * p.radius)
    force[0] = p.tilt[0] * thrust - back * hub[0]
    force[1] = p.tilt[1] * thrust - back * hub[1]
    force[2] = -thrust * np.sqrt(1 - p.tilt[0] ** 2 - p.tilt[1] ** 2)
    return force


def air_forces(batch: Batch, air: Array, command: Array, t: float) -> tuple[Array, Array]:
    """Force and moment on the body that do not pass through the rotors, body axes."""
    p, on = batch.p, batch.on
    force = -(p.drag_linear + p.drag_quadratic * np.abs(air)) * air
    moment = np.zeros_like(air)
    if on("parasitic") or on("drag_cubic"):
        square = (air * air).sum(axis=0)
        force = force - (p.parasitic * np.sqrt(square) + p.drag_cubic * square) * air
    if on("lee_drag"):
        force[1] -= p.lee_drag * np.maximum(air[1], 0.0)
    if on("shudder"):
        force = force + p.shudder * np.sin(2 * np.pi * p.shudder_hz * t)
    if on("duct_leak"):
        front = p.hubs[:, 0] > 1e-6
        force = force + p.duct_leak * (command * front).sum(axis=0) / front.sum(axis=0)
    return force, moment


def pad_forces(
    batch: Batch, down: Array, vel: Array, omega: Array, r: Array
) -> tuple[Array, Array]:
    """Force and moment of the ground, body axes: a soft, level and rough pad."""
    p = batch.p
    depth = down + p.leg
    if not np.any(depth > 0):
        return np.zeros_like(vel), np.zeros_like(vel)
    lift = _PAD_RAD_S**2 * depth + 2 * _PAD_DAMPING * _PAD_RAD_S * vel[2]
    lift = np.where(depth > 0, np.maximum(lift, 0.0), 0.0)
    load = np.minimum(lift / GRAVITY_M_S2, 1.0)
    push = np.stack([-20.0 * load * vel[0], -20.0 * load * vel[1], -lift]) * p.mass
    lean = np.stack([r[2, 1], -r[2, 0], np.zeros_like(down)])
    twist = -p.inertia * load * (400.0 * lean + 40.0 * omega)
    return to_body(r, push), twist


def unbalance(batch: Batch, rotor: Array, phase: Array) -> Array:
    """Once per turn in the plane of the rotor, twice per turn across; grows with speed squared."""
    load = (rotor / batch.p.hover_speed) ** 2
    c, s = np.cos(phase), np.sin(phase)
    return np.stack([(load * c).sum(0), (load * s).sum(0), (load * 0.5 * (c * c - s * s)).sum(0)])


_SWING_DAMPING_1_S = 0.05
"""Of the load on its rope, by the air; made up."""
ROPE_RAD_S, _ROPE_DAMPING = 2 * np.pi * 20.0, 0.3
"""Natural frequency of the load along its taut rope, and the damping ratio; made up, stiff enough
for a stretch of some millimetres."""


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
    """Pull of a point mass on a rope, NED, N, and the acceleration of the mass from the vehicle.

    Newton's law of both bodies; the rope is a spring with a damper that pulls and never pushes.
    `rope` leads from vehicle to load, `swing` is its rate.
    """
    p = batch.p
    length = np.sqrt((rope * rope).sum(axis=0))
    along = rope / length
    stretch, rate = length - p.load_length, (along * swing).sum(axis=0)
    strain = ROPE_RAD_S * ROPE_RAD_S * stretch + 2 * _ROPE_DAMPING * ROPE_RAD_S * rate
    tension = np.where(stretch > 0, np.maximum(strain, 0.0), 0.0)  # over the mass of the load
    pull = p.load_mass * tension * along
    bend = -(force + pull) / p.mass - tension * along - _SWING_DAMPING_1_S * swing
    return pull, bend


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
