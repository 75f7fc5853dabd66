"""RotorPy's Hummingbird (PyPI, spencerfolk/rotorpy): its aerodynamic wrench, rotor by rotor.

Thrust and torque, parasitic drag, the drag of each rotor by its own airspeed, and translational
lift are those of `Multirotor.compute_body_wrench`; rotors follow with its time constant. Its axes
are forward, left, up. A rotor that loses thrust turns slower by the root of what it has left.
"""

from functools import cache
from typing import Any

import numpy as np

from benchmarks.hidden_effects.plants.aircraft import Aircraft
from benchmarks.hidden_effects.plants.own.parameters import (
    GRAVITY_M_S2,
    Array,
    Batch,
    Parameters,
)
from benchmarks.hidden_effects.plants.own.physics import Instant, cross, pad_forces

_FLIP = np.array([1.0, -1.0, -1.0])
"""Forward-left-up to forward-right-down and back."""
IDLE_RAD_S, SPAN_RAD_S = 80.0, 900.0
"""Speed of its rotors at no command, and what the whole command adds: with the 1500 rad/s of its
file they would lift ten times its weight."""


ORDER = ("r2", "r4", "r1", "r3")
"""Of its rotors as PX4 numbers an X: `why` knows usual frames alone, and a log in another order has
to state it."""


@cache
def _vehicle() -> Any:
    from rotorpy.vehicles.hummingbird_params import quad_params
    from rotorpy.vehicles.multirotor import Multirotor

    places, turns = quad_params["rotor_pos"], quad_params["rotor_directions"]
    turns = np.array([turns[[*places].index(name)] for name in ORDER])
    ordered = {"rotor_pos": {name: places[name] for name in ORDER}, "rotor_directions": turns}
    return Multirotor(quad_params | ordered)


@cache
def hummingbird() -> Aircraft:
    """It as a nominal plant."""
    its = _vehicle()
    thrust_k, torque_k = float(its.k_eta), float(its.k_m)
    nominal = Parameters(
        mass=float(its.mass),
        inertia=np.diag(its.inertia),
        hubs=its.rotor_geometry * _FLIP,
        direction=its.rotor_dir.astype(float),
        thrust_k=np.full(4, thrust_k),
        torque_k=np.full(4, torque_k),
        speed_0=IDLE_RAD_S,
        speed_1=SPAN_RAD_S,
        lag=float(its.tau_m),
        hover_speed=float(np.sqrt(its.mass * GRAVITY_M_S2 / (4 * thrust_k))),
        radius=0.1,
        leg=0.08,
        drag_linear=np.zeros(3),
        drag_quadratic=np.zeros(3),
        accel_cutoff_hz=60.0,
        hover_current=8.0,
        full_v=12.6,
        empty_v=9.9,
    )
    return Aircraft("hummingbird", nominal, by_command=False, pace=0.8, spin_inertia=0.0)


def hummingbird_dynamics(batch: Batch, now: Instant) -> tuple[Array, Array]:
    """Force without weight and angular acceleration, body axes."""
    p, nominal, its = batch.p, hummingbird().nominal, _vehicle()
    rates, air = now.omega.T * _FLIP, now.air.T * _FLIP
    speeds = (now.rotor * np.sqrt(p.thrust_k / nominal.thrust_k[:, None])).T
    force, moment = np.empty((2, 3, batch.n))
    for i in range(batch.n):
        its.rotor_geometry = p.hubs[:, :, i] * _FLIP
        f, m = its.compute_body_wrench(rates[i], speeds[i], air[i])
        force[:, i], moment[:, i] = f * _FLIP, m * _FLIP
    push, twist = pad_forces(batch, now.pos[2], now.vel, now.omega, now.r)
    turn = (moment + twist - cross(now.omega, p.inertia * now.omega)) / p.inertia
    return force + push, turn
