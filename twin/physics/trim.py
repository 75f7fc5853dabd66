"""Hover: commands and rotor states at which an airframe neither climbs nor turns."""

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import Component
from ..errors import ModelError
from ..vehicle import Vehicle
from ..vehicle.thrust_map import first_reaching, hover_level

Array = NDArray[np.float64]


def hover_trim(component: Component, vehicle: Vehicle) -> dict[str, float]:
    """Start values (inputs and initial rotor states) of an unaccelerated level hover.

    Newton's method with the least-norm step on vertical and angular acceleration against the
    rotor inputs, at steady rotors, with the derivatives of the component's own equations.

    Raises:
        ModelError: No command inside 0..1 (no positive speed) hovers.
    """
    names = [n for n in component.input_names if n.startswith(("cmd_", "rotor_"))]
    index = [component.input_names.index(n) for n in names]
    steady = [i for i, s in enumerate(component.states) if s.name.startswith(("rotor_", "effort_"))]
    v = ca.SX.sym("v", len(names))
    r = ca.SX.sym("r", len(steady))
    u = ca.SX(component.input_values())
    u[index] = v
    p = component.parameter_values()
    x = component.initial(u, p)
    if steady:
        x[steady] = r
    rates = component.derivatives(x, u, p)
    wanted = [
        i
        for i, s in enumerate(component.states)
        if s.name in ("vel_z", "omega_x", "omega_y", "omega_z")
    ]
    residual = ca.vertcat(rates[wanted], rates[steady])
    unknown = ca.vertcat(v, r)
    newton = ca.Function("newton", [unknown], [residual, ca.jacobian(residual, unknown)])
    guess = _trim_guess(vehicle, component.input_names, len(steady))
    for _ in range(50):
        value, slope = (np.asarray(a, dtype=np.float64) for a in newton(guess))
        step = np.linalg.pinv(slope) @ value.ravel()
        guess = guess - step
        if np.max(np.abs(step)) < 1e-15 * max(1.0, float(np.max(np.abs(guess)))):
            break
    value = np.asarray(newton(guess)[0], dtype=np.float64)
    commands = guess[: len(names)]
    too_high = component.input_names[index[0]].startswith("cmd_") and commands.max() > 1
    if (
        not np.all(np.isfinite(guess))
        or np.max(np.abs(value)) > 1e-6
        or commands.min() < 0
        or too_high
    ):
        raise ModelError(
            f"{vehicle.name}: no hover trim: rotor inputs {np.round(commands, 4).tolist()} leave "
            f"an acceleration of {np.max(np.abs(value)):.3g}. Check mass, thrust map, rotor "
            f"positions and directions."
        )
    trim = dict(zip(names, commands.tolist(), strict=True))
    starts = [f"initial.{component.states[i].name}" for i in steady]
    return trim | dict(zip(starts, guess[len(names) :].tolist(), strict=True))


def _trim_guess(vehicle: Vehicle, inputs: Sequence[str], n_steady: int) -> Array:
    """Equal rotors that carry the weight: argument of the thrust map, then its state if any."""
    rotors = vehicle.rotors
    level = hover_level(vehicle)
    command = level
    if rotors.from_speed and rotors.speed_rad_s:
        command = first_reaching(rotors.speed_rad_s, level, 1.0)
    first = level if "rotor_1" in inputs else command
    return np.array([first] * rotors.count + [level] * n_steady)
