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
from .own.parameters import GRAVITY_M_S2, Array, Batch, Parameters
from .own.physics import Dynamics, Instant, air_forces, pad_forces, to_body, to_ned

CRAZYFLIES = ("cf21B_500", "cf2x_T350")
RPM = 30 / np.pi
_FLIP = np.array([1.0, -1.0, -1.0])
"""Forward-left-up to forward-right-down and back, in the body as in the world."""


@cache
def _parameters(model: str) -> dict[str, Array]:
    from drone_models.core import load_params

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
        full_v=4.2,
        empty_v=3.0,
        reference_v=3.7,
        resistance=0.05,
        capacity=900.0,
        hover_current=3.0,
    )
    return Aircraft(
        model,
        nominal,
        by_command=False,
        pace=0.6,
        spin_inertia=float(its["prop_inertia"]),
        thrust_of_rpm=tuple(its["rpm2thrust"].tolist()),
        torque_of_rpm=tuple(its["rpm2torque"].tolist()),
    )


class Crazyflies:
    """Dynamics of drone-models for batches that fly one of its aircraft."""

    def __init__(self, model: str) -> None:
        self._nominal, self._its = crazyflie(model).nominal, _parameters(model)
        self._function = _function(float(self._its["L"]))
        self._ready: tuple[Batch, _Call] | None = None

    def __call__(self, batch: Batch, now: Instant) -> tuple[Array, Array]:
        """Force without weight and angular acceleration, body axes."""
        p, n = batch.p, now.rotor.shape[1]
        if self._ready is None or self._ready[0] is not batch or self._ready[1].n != n:
            settings = _settings(p, self._nominal, self._its)
            self._ready = batch, _Call(self._function, settings, n)
        call = self._ready[1]
        force, twist = air_forces(batch, now.air, now.command, now.t)
        force = force + p.drag_linear * now.air  # the drag matrix has it
        if batch.on("pitch_per_yaw"):
            twist[1] += p.pitch_per_yaw * now.omega[2]
        push, lean = pad_forces(batch, now.pos[2], now.vel, now.omega, now.r)
        rate = call(
            _quaternion(now.q),
            _outside(to_ned(now.r, now.air)),
            _outside(now.omega),
            now.rotor.T * RPM,
            _outside(to_ned(now.r, force + push)),
            _outside(to_ned(now.r, twist + lean)),
            now.target.T * RPM,
        )
        free = rate[:, 7:10] * _FLIP - np.array([0.0, 0.0, GRAVITY_M_S2])
        return to_body(now.r, p.mass * free.T), (rate[:, 10:13] * _FLIP).T


@cache
def crazyflie_dynamics(model: str) -> Dynamics:
    """Dynamics for one of the aircraft of drone-models."""
    return Crazyflies(model)


class _Call:
    """A CasADi function over many flights, with its arguments in place."""

    def __init__(self, function: Any, settings: dict[str, Array], n: int) -> None:
        self.n = n
        mapped = function.map(n)
        self._state, self._command = np.zeros((n, 23)), np.zeros((n, 4))
        self._rate = np.zeros((n, 17))
        constant = [  # CasADi counts down the columns first
            np.ascontiguousarray(np.broadcast_to(np.swapaxes(settings[k], 1, 2), (n, *shape[::-1])))
            for k, shape in _SETTINGS.items()
        ]
        self._buffer, self._run = mapped.buffer()
        self._retained = (self._state, self._command, *constant)
        for i, array in enumerate(self._retained):
            self._buffer.set_arg(i, array.data)
        self._buffer.set_res(0, self._rate.data)

    def __call__(self, *columns: Array) -> Array:
        """Rates of the state from its parts after the position, flights first; commands last."""
        self._state[:, 3:] = np.concatenate(columns[:-1], axis=1)
        self._command[:] = columns[-1]
        self._run()
        return self._rate


class _ByRow:
    """A matrix whose rows come as columns, as those of a numpy matrix do in CasADi."""

    def __init__(self, matrix: Any) -> None:
        self._matrix = matrix

    def __matmul__(self, vector: Any) -> Any:
        return self._matrix @ vector

    def __getitem__(self, index: Any) -> Any:
        return self._matrix[index].T


def _function(arm: float) -> Any:
    """Its symbolic dynamics as a function of state, command and parameters."""
    import casadi as ca
    from drone_models.first_principles import (
        symbolic_dynamics,
    )

    symbols = {k: ca.MX.sym(k, *shape) for k, shape in _SETTINGS.items()}
    polynomials = {
        k: [symbols[k][i, :].T for i in range(symbols[k].shape[0])]
        for k in ("rpm2thrust", "rpm2torque", "rotor_dyn_coef")
    }
    rate, state, command, _ = symbolic_dynamics(
        model_rotor_vel=True,
        model_dist_f=True,
        model_dist_t=True,
        **{
            **symbols,
            **polynomials,
            "L": arm,
            "gravity_vec": np.array([0.0, 0.0, -GRAVITY_M_S2]),
            "mixing_matrix": _ByRow(symbols["mixing_matrix"]),
        },
    )
    return ca.Function("dynamics", [state, command, *symbols.values()], [rate]).expand()


_SETTINGS = {
    "mass": (1, 1),
    "prop_inertia": (1, 1),
    "J": (3, 3),
    "J_inv": (3, 3),
    "rpm2thrust": (3, 4),
    "rpm2torque": (3, 4),
    "mixing_matrix": (3, 4),
    "drag_matrix": (3, 3),
    "rotor_dyn_coef": (4, 1),
}
"""Parameters of the dynamics that differ between flights, and their shapes."""


def _settings(p: Parameters, nominal: Parameters, its: dict[str, Array]) -> dict[str, Array]:
    """Parameters of the dynamics, flights first."""
    drag = p.drag_linear.copy()
    drag[:2] += 4 * p.rotor_h * p.hover_speed
    mixing = np.stack([-p.hubs[:, 1], -p.hubs[:, 0], p.direction]).transpose(2, 0, 1)
    mixing[:, :2] /= float(its["L"])
    stiff = np.asarray(1 / np.asarray(p.lag))
    thrust, torque = p.thrust_k.T / nominal.thrust_k, p.torque_k.T / nominal.torque_k
    return {
        "mass": np.asarray(p.mass)[:, None, None],
        "prop_inertia": np.asarray(p.spin_inertia_yaw)[:, None, None],
        "J": _diagonal(p.inertia),
        "J_inv": _diagonal(1 / p.inertia),
        "rpm2thrust": its["rpm2thrust"][None, :, None] * thrust[:, None],
        "rpm2torque": its["rpm2torque"][None, :, None] * torque[:, None],
        "mixing_matrix": mixing,
        "drag_matrix": -_diagonal(drag),
        "rotor_dyn_coef": np.stack([stiff, 0 * stiff, stiff, 0 * stiff], axis=1)[:, :, None],
    }


def _diagonal(v: Array) -> Array:
    """Diagonal matrices, shape (n, 3, 3)."""
    return np.asarray(v.T[:, :, None] * np.eye(3))


def _outside(v: Array) -> Array:
    """North-east-down or forward-right-down to theirs, flights first."""
    return np.asarray(v.T * _FLIP)


def _quaternion(q: Array) -> Array:
    """Theirs: x, y, z, w, from forward-left-up to a world with z up."""
    return np.stack([q[1], -q[2], -q[3], q[0]], axis=1)


def _polynomial(coefficients: Array, argument: float) -> float:
    return float(np.polynomial.polynomial.polyval(argument, coefficients))


def _rpm(rpm2thrust: Array, thrust: float) -> float:
    """Speed at which a rotor gives a thrust."""
    roots = np.roots([rpm2thrust[2], rpm2thrust[1], rpm2thrust[0] - thrust])
    return float(roots.max())
