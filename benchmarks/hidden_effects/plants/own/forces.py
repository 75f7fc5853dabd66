"""Forces and moments on the body of our own plant, body axes, for many flights at once."""

import numpy as np

from .parameters import GRAVITY_M_S2, Array, Batch
from .rotor import induced_velocity, thrust_ratio
from .vectors import cross, to_body

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
