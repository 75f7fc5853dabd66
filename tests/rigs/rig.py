"""What the tests of the physics share: plain vehicles, a component run by name, least squares."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.component import Component
from twin.component.along import accumulated
from twin.explain.model.model import Model
from twin.physics.airframe import airframe
from twin.physics.rotors import Drive
from twin.residuals.channels import ChannelData
from twin.vehicle import Rotors, Vehicle
from twin.vehicle_file import load_vehicle

Array = NDArray[np.float64]
BUILTIN = ("copter_default", "crazyflie", "feisi_x150")
X = np.array([[1.0, 1, 0], [-1, -1, 0], [1, -1, 0], [-1, 1, 0]])
"""Quad-x in PX4's order: front right, rear left, front left, rear right."""
FULL_INERTIA = np.array([[0.020, 0.002, -0.001], [0.002, 0.027, 0.003], [-0.001, 0.003, 0.036]])


def plain(**changes: object) -> Vehicle:
    """1.2 kg, lag 40 ms, thrust 8 N * command, torque 0.02 m * thrust, no drag; legs 0.1 m."""
    rotors = Rotors(
        position_m=0.16 * X,
        direction=np.array([-1.0, -1.0, 1.0, 1.0]),
        from_speed=False,
        thrust_n=(0.0, 8.0),
        torque_n_m=(0.0, 0.16),
        speed_rad_s=None,
        lag_up_s=0.04,
        lag_down_s=0.04,
        spin_inertia_kg_m2=0.0,
        reference_voltage_v=None,
        voltage_exponent=1.0,
    )
    base = replace(
        load_vehicle("feisi_x150"),
        name="plain",
        mass_kg=1.2,
        inertia_kg_m2=np.diag([0.020, 0.027, 0.036]),
        drag_linear_n_s_m=np.zeros(3),
        leg_height_m=0.1,
        rotors=rotors,
    )
    return replace(base, **changes)  # type: ignore[arg-type]


def with_rotors(vehicle: Vehicle, **changes: object) -> Vehicle:
    return replace(vehicle, rotors=replace(vehicle.rotors, **changes))  # type: ignore[arg-type]


class Rig:
    """A component with its parameters fixed, states and inputs by name."""

    def __init__(self, component: Component, parameters: Mapping[str, float] | None = None) -> None:
        self.component = component
        self.p = component.parameter_values(parameters)
        self.names = [s.name for s in component.states]

    def state(self, values: Mapping[str, float] | None = None, **more: float) -> Array:
        """Initial state (the trim), some of it changed."""
        u = self.component.input_values()
        x = np.asarray(self.component.initial(u, self.p), dtype=np.float64).ravel()
        for name, value in {**(values or {}), **more}.items():
            x[self.names.index(name)] = value
        return x

    def inputs(self, values: Mapping[str, float] | None = None, **more: float) -> Array:
        return self.component.input_values({**(values or {}), **more})

    def commands(self, values: ArrayLike, **more: float) -> Array:
        """Inputs with the first ones, the rotors', set."""
        u = self.component.input_values(more)
        drives = [n for n in self.component.input_names if n.startswith(("cmd_", "rotor_"))]
        u[: len(drives)] = values
        return u

    def fly(self, x: Array, u: Array, seconds: float, step_s: float = 1e-3) -> Array:
        """States at every step, the first included, shape (n + 1, n_x), constant inputs."""
        n = round(seconds / step_s)
        state, nothing = ca.SX.sym("x", len(x)), ca.SX.sym("nothing", 0)
        step = ca.Function("s", [state, nothing], [self.component.step(state, u, self.p, step_s)])
        (rows,) = accumulated(step, x, np.empty((n, 0)))
        return np.vstack([x, rows])

    def get(self, states: Array, *names: str) -> Array:
        """Columns of states (or one state) by name."""
        return np.asarray(states[..., [self.names.index(n) for n in names]])

    def vector(self, states: Array, stem: str) -> Array:
        letters = "wxyz" if stem == "q" else "xyz"
        return self.get(states, *[f"{stem}_{a}" for a in letters])

    def rates(self, x: Array, u: Array) -> dict[str, float]:
        dx = np.asarray(self.component.derivatives(x, u, self.p), dtype=np.float64).ravel()
        return dict(zip(self.names, dx.tolist(), strict=True))

    def outputs(self, x: Array, u: Array) -> dict[str, float]:
        y = np.asarray(self.component.outputs(x, u, self.p), dtype=np.float64).ravel()
        return dict(zip(self.component.output_names, y.tolist(), strict=True))


def in_air(vehicle: Vehicle, drive: Drive | None = None, **parameters: float) -> Rig:
    """The airframe without ground."""
    return Rig(airframe(vehicle, drive), {"ground.enabled": 0.0, **parameters})


def q(values: ArrayLike) -> dict[str, float]:
    return dict(zip(("q_w", "q_x", "q_y", "q_z"), np.asarray(values).tolist(), strict=True))


def vec(stem: str, values: ArrayLike) -> dict[str, float]:
    return dict(zip((f"{stem}_{a}" for a in "xyz"), np.asarray(values).tolist(), strict=True))


ROUNDS = 5
"""Of Gauss-Newton in `fitted`."""


def fitted(
    model: Model,
    names: Sequence[str],
    channels: Sequence[str] | None = None,
    start: Mapping[str, float] | None = None,
) -> dict[str, float]:
    """Values of some numbers, "effect.number" -> value, by Gauss-Newton on channels, each over its
    spread: no prior, no choice between effects, whatever the search does.

    Args:
        model: Flights.
        names: "effect.number".
        channels: Beginnings of the names of channels that count; default: all.
        start: Values to start from, default: as the model stands; of other numbers: held.
    """
    known = {n.full: n for n in model.numbers}
    columns = [model.numbers.index(known[name]) for name in names]
    values = {name: known[name].now for name in names} | dict(start or {})
    for _ in range(ROUNDS):
        rows, slopes = rows_of(model.channels(columns, values), channels)
        step = np.linalg.lstsq(slopes, rows, rcond=None)[0]
        for name, change in zip(names, step.tolist(), strict=True):
            low, high = known[name].about.bounds
            values[name] = min(max(values[name] + change, low), high)
    return {name: values[name] for name in names}


def rows_of(
    flights: Sequence[Sequence[ChannelData]], channels: Sequence[str] | None = None
) -> tuple[Array, Array]:
    """Residuals and slopes one below the other, each channel over its spread."""
    begins = ("",) if channels is None else tuple(channels)
    found = [c for flight in flights for c in flight if c.name.startswith(begins)]
    sizes = [float(np.std(c.measured)) or 1.0 for c in found]
    residuals = [c.residual / s for c, s in zip(found, sizes, strict=True)]
    slopes = [c.slopes / s for c, s in zip(found, sizes, strict=True)]
    return np.concatenate(residuals), np.concatenate(slopes)
