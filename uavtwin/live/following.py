"""The twin that follows the aircraft message by message, from the newest measured state on.

At each reading of the IMU the airframe is stepped to its time on the newest commands, in the steps
of the FMUs; every horizon it is set to what was measured, or an observer draws it there all the
time. Rotors, which nobody measures, go on.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from twin.component import substeps
from twin.component.along import Along, EachRow
from twin.component.building import BUILDING
from twin.frames import AXES
from twin.logs.columns import POS, QUAT, VEL, motor_columns
from twin.logs.mavlink.decoder import GROUPS, Sample
from twin.residuals.running.equations import Equations
from twin.residuals.teacher_forced import GRID_S

Array = NDArray[np.float64]
_POSE = {
    "pos": POS,
    "vel": VEL,
    "q": QUAT,
    "gyro": tuple(f"omega_{a}" for a in AXES),
}
"""States of the airframe that a signal measures."""
_LONGEST_US = 500_000
"""After a longer pause the twin is set to what was measured, not stepped to it."""


@dataclass(frozen=True, slots=True)
class Following:
    """How the twin is kept with the aircraft.

    Attributes:
        horizon_s: It is set to what was measured that often, and free in between.
        observer_s: Instead it is drawn to what was measured, so that what it is off decays with
            this time constant: x += (1 - exp(-dt / observer)) (measured - x), a Luenberger observer
            of one gain; None: it is set.
    """

    horizon_s: float
    observer_s: float | None = None

    def __str__(self) -> str:
        if self.observer_s is None:
            return f"set to the measured state every {self.horizon_s:g} s"
        return f"drawn to the measured state with a time constant of {self.observer_s:g} s"


@dataclass(frozen=True, slots=True)
class Reading:
    """What the twin reads; SI, NED, FRD."""

    acc_b: Sequence[float]
    gyro_b: Sequence[float]
    position_n: Sequence[float]
    velocity_n: Sequence[float]
    q_nb: Sequence[float]
    omega_b: Sequence[float]


class FollowingTwin:
    """Airframe and IMU that follow an aircraft.

    Attributes:
        started: Whether it has a state: attitude, velocity and body rates have come, and commands.
    """

    def __init__(self, equations: Equations, following: Following) -> None:
        """Nothing has come.

        Args:
            equations: Of the vehicle.
            following: How it is kept with the aircraft.
        """
        body, sensor = equations.airframe, equations.imu
        self._p = body.parameter_values({"ground.enabled": 0.0})
        self._u = body.input_values()
        self._inputs = {name: i for i, name in enumerate(body.input_names)}
        names = [s.name for s in body.states]
        self._index = {g: [names.index(n) for n in states] for g, states in _POSE.items()}
        x, u = ca.SX.sym("x", len(names)), ca.SX.sym("u", len(self._u))
        n, h = substeps(GRID_S, body.max_step_s)
        after = x
        for _ in range(n):
            after = body.step(after, u, self._p, h)
        self._step = Along(ca.Function("step", [x, u], [after]))
        outputs = body.outputs(x, u, self._p)
        place = {name: i for i, name in enumerate(body.output_names)}
        sensed = ca.vertcat(*[outputs[place[name]] for name in sensor.input_names])
        p = sensor.parameter_values()
        shown = sensor.outputs(sensor.initial(sensed, p), sensed, p)
        pose = ca.vertcat(*[x[self._index[g]] for g in ("pos", "vel", "q", "gyro")])
        self._read = EachRow(ca.Function("read", [x, u], [ca.vertcat(shown[:6], pose)]), 2)
        self._start = body
        self._x: Array | None = None
        self._measured: dict[str, tuple[float, ...]] = {}
        self._has_commands = False
        self._horizon_us = round(1e6 * following.horizon_s)
        self._observer_s = following.observer_s
        self._t_us = self._set_us = 0

    @property
    def started(self) -> bool:
        """See the class."""
        return self._x is not None

    def take(self, sample: Sample) -> bool:
        """Take a sample; returns whether the twin was stepped to its time."""
        if sample.group in self._index:
            self._measured[sample.group] = sample.values
        elif sample.group in ("cmd", "rotor", "vbat_v"):
            names = GROUPS.get(sample.group) or motor_columns(sample.group, len(sample.values))
            for name, value in zip(names, sample.values, strict=True):
                if name in self._inputs:
                    self._u[self._inputs[name]] = value
                    self._has_commands |= sample.group != "vbat_v"
        if sample.group != "gyro" or not self._has_commands:
            return False
        if not {"q", "vel", "gyro"} <= set(self._measured):
            return False
        self._go_on(sample.t_us)
        return True

    def restart(self) -> None:
        """Forget the state and all that was measured: another flight begins."""
        self._x, self._has_commands = None, False
        self._measured.clear()

    def read(self) -> Reading:
        """What it reads now."""
        assert self._x is not None
        values = self._read(self._x[None], self._u[None])[0].tolist()
        edges = (0, 3, 6, 9, 12, 16, 19)
        return Reading(*(values[a:b] for a, b in pairwise(edges)))

    def _go_on(self, t_us: int) -> None:
        """Step to a time."""
        pause_us = t_us - self._t_us
        if (
            self._x is None
            or not 0 <= pause_us <= _LONGEST_US
            or not np.isfinite(self._x).all()  # its state diverged
        ):
            with BUILDING:
                start = self._start.initial(self._u, self._p)
                self._x = np.asarray(start, dtype=np.float64).ravel()
            self._set(t_us)
            return
        steps = round(1e-6 * pause_us / GRID_S)
        if steps:
            (along,) = self._step(self._x, np.tile(self._u, (steps, 1)))
            self._x = along[-1]
        self._t_us += round(1e6 * GRID_S) * steps
        if self._observer_s is not None:
            self._draw(GRID_S * steps, self._observer_s)
        elif t_us - self._set_us >= self._horizon_us:
            self._set(t_us)

    def _set(self, t_us: int) -> None:
        """Be where the aircraft was measured."""
        x = np.array(self._x, dtype=np.float64).ravel()
        for group, values in self._measured.items():
            x[self._index[group]] = values
        self._x, self._t_us, self._set_us = x, t_us, t_us

    def _draw(self, over_s: float, observer_s: float) -> None:
        """Be nearer to where the aircraft was measured."""
        x = np.array(self._x, dtype=np.float64).ravel()
        pull = -np.expm1(-over_s / observer_s)
        for group, values in self._measured.items():
            index, measured = self._index[group], np.asarray(values)
            if group == "q" and x[index] @ measured < 0:
                measured = -measured
            x[index] += pull * (measured - x[index])
        q = self._index["q"]
        x[q] /= np.linalg.norm(x[q])
        self._x = x
