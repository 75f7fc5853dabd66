"""Plants from other people's simulators, flown by our controller and seen by our sensors.

drone-models (PyPI, learnsyslab): first-principles dynamics with the parameters that its authors
fitted to real Crazyflies. Hidden effects go in through its own parameters (mass, inertia, drag
matrix, thrust, torque and rotor coefficients, mixing matrix, propeller inertia, wind) and its
disturbance force and torque. Two of its parameters are set so that a vehicle file can describe
the aircraft exactly: rotors follow its linear `rotor_dyn_coef_simple`, and propellers have no
inertia unless that is what is hidden. It asks for `SCIPY_ARRAY_API=1` in the environment before
scipy is imported; `generate` sees to that in the processes that fly.
"""

from functools import cache
from typing import Any

import numpy as np

from .aircraft import Aircraft
from .forces import air_forces, pad_forces
from .parameters import GRAVITY_M_S2, Array, Batch, Parameters
from .physics import Dynamics, Instant
from .vectors import to_body, to_ned

CRAZYFLIES = ("cf21B_500", "cf2x_T350")
RPM = 30 / np.pi
_FLIP = np.array([1.0, -1.0, -1.0])
"""Forward-left-up to forward-right-down and back, in the body as in the world."""


@cache
def _parameters(model: str) -> dict[str, Array]:
    from drone_models.core import load_params  # type: ignore[import-not-found]

    return {
        k: np.asarray(v, dtype=np.float64)
        for k, v in load_params("first_principles", model).items()
    }


@cache
def crazyflie(model: str) -> Aircraft:
    """One of the aircraft of drone-models as a nominal plant."""
    its = _parameters(model)
    mass, arm, mix = float(its["mass"]), float(its["L"]), its["mixing_matrix"]
    hubs = arm * np.stack([-mix[1], -mix[0], np.zeros(4)], axis=1)
    hover = _rpm(its["rpm2thrust"], mass * GRAVITY_M_S2 / 4) / RPM
    top = _rpm(its["rpm2thrust"], float(its["thrust_max"])) / RPM
    thrust, torque = (_polynomial(its[k], hover * RPM) for k in ("rpm2thrust", "rpm2torque"))
    nominal = Parameters(
        mass=mass,
        inertia=np.diag(its["J"]),
        hubs=hubs,
        direction=mix[2],
        thrust_k=np.full(4, thrust / hover**2),
        torque_k=np.full(4, torque / hover**2),
        speed_0=0.1 * top,
        speed_1=0.9 * top,
        lag=1 / float(its["rotor_dyn_coef_simple"]),
        hover_speed=hover,
        radius=float(its["prop_radius"]),
        leg=0.03,
        drag_linear=-np.diag(its["drag_matrix"]),
        drag_quadratic=np.zeros(3),
        accel_cutoff_hz=60.0,
        full_v=4.2, empty_v=3.0, reference_v=3.7, resistance=0.05, capacity=900.0,
        hover_current=3.0,
    )  # fmt: skip
    return Aircraft(
        model,
        nominal,
        by_command=False,
        pace=0.6,
        spin_inertia=float(its["prop_inertia"]),
        thrust_of_rpm=tuple(its["rpm2thrust"].tolist()),
        torque_of_rpm=tuple(its["rpm2torque"].tolist()),
    )


@cache
def crazyflie_dynamics(model: str) -> Dynamics:
    """Dynamics of drone-models for a batch that flies one of its aircraft."""
    from drone_models.first_principles import (  # type: ignore[import-not-found]
        dynamics,
    )

    nominal, its = crazyflie(model).nominal, _parameters(model)

    def accelerations(batch: Batch, now: Instant) -> tuple[Array, Array]:
        p = batch.p
        settings = _settings(p, nominal, its)
        force, twist = air_forces(batch, now.air, now.command, now.t)
        force = force + p.drag_linear * now.air  # the drag matrix has it
        if batch.on("pitch_per_yaw"):
            twist[1] += p.pitch_per_yaw * now.omega[2]
        push, lean = pad_forces(batch, now.pos[2], now.vel, now.omega, now.r)
        _, _, acceleration, spin, _ = dynamics(
            _outside(now.pos),
            _quaternion(now.r),
            _outside(to_ned(now.r, now.air)),
            _outside(now.omega),
            now.target.T * RPM,
            now.rotor.T * RPM,
            _outside(to_ned(now.r, force + push)),
            _outside(to_ned(now.r, twist + lean)),
            **settings,
        )
        acceleration = acceleration * _FLIP - np.array([0.0, 0.0, GRAVITY_M_S2])
        return to_body(now.r, p.mass * acceleration.T), (spin * _FLIP).T

    return accelerations


def _settings(p: Parameters, nominal: Parameters, its: dict[str, Array]) -> dict[str, Any]:
    """Keyword arguments of the dynamics, flights first."""
    inertia = np.apply_along_axis(np.diag, 1, p.inertia.T)
    drag = p.drag_linear.copy()
    drag[:2] += 4 * p.rotor_h * p.hover_speed
    mixing = np.stack([-p.hubs[:, 1], -p.hubs[:, 0], p.direction]).transpose(2, 0, 1)
    mixing[:, :2] /= float(its["L"])
    stiff = 1 / p.lag[:, None]  # type: ignore[index]
    return {
        "mass": p.mass[:, None],  # type: ignore[index]
        "L": float(its["L"]),
        "prop_inertia": p.spin_inertia_yaw[:, None],  # type: ignore[index]
        "gravity_vec": np.array([0.0, 0.0, -GRAVITY_M_S2]),
        "J": inertia,
        "J_inv": np.apply_along_axis(np.diag, 1, 1 / p.inertia.T),
        "rpm2thrust": its["rpm2thrust"][:, None, None] * (p.thrust_k.T / nominal.thrust_k),
        "rpm2torque": its["rpm2torque"][:, None, None] * (p.torque_k.T / nominal.torque_k),
        "mixing_matrix": mixing,
        "drag_matrix": -np.apply_along_axis(np.diag, 1, drag.T),
        "rotor_dyn_coef": np.stack([stiff, 0 * stiff, stiff, 0 * stiff]),
    }


def _outside(v: Array) -> Array:
    """North-east-down or forward-right-down to theirs, flights first."""
    return np.asarray(v.T * _FLIP)


def _quaternion(r: Array) -> Array:
    """Theirs: x, y, z, w, forward-left-up to up."""
    from scipy.spatial.transform import Rotation

    flip = np.diag(_FLIP)
    return np.asarray(Rotation.from_matrix(flip @ r.transpose(2, 0, 1) @ flip).as_quat())


def _polynomial(coefficients: Array, argument: float) -> float:
    return float(np.polynomial.polynomial.polyval(argument, coefficients))


def _rpm(rpm2thrust: Array, thrust: float) -> float:
    """Speed at which a rotor gives a thrust."""
    roots = np.roots([rpm2thrust[2], rpm2thrust[1], rpm2thrust[0] - thrust])
    return float(roots.max())
