"""Simulation of short windows of flight from measured states, all in one batch.

Equations, steps and sample instants are those of the FMUs of airframe and IMU under a co-simulation
master. Delays of commands are applied to the inputs, as in every `AlignedFlight`.
"""

from collections.abc import Callable

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import Component, Sampling, substeps
from ..component.along import Along
from ..component.rows import OverRows
from ..logs.columns import GYRO, POS, QUAT, VEL
from ..logs.samples import stretches_where
from .aligned import AlignedFlight
from .teacher_forced import GRID_S

Array = NDArray[np.float64]
READ = GYRO + POS + VEL + QUAT
"""Outputs at the end of a window, in order."""
WINDOWS_AT_ONCE = 1024
"""Windows per batch; more are no faster: their states no longer fit the cache."""

FEW = 8
"""Number of windows up to which they are faster one by one than side by side; the numbers differ in
the last digits."""


def whole_windows(aligned: AlignedFlight, steps: int) -> NDArray[np.intp]:
    """Start points of consecutive windows without overlap, shape (w,).

    Each window is airborne and measured from start to end.

    Args:
        aligned: Flight on the grid of its twin.
        steps: Grid steps per window.
    """
    return window_starts(aligned.airborne & np.all(np.isfinite(aligned.states), axis=1), steps)


def window_starts(known: NDArray[np.bool_], steps: int) -> NDArray[np.intp]:
    """Start points of such windows, from a mask of the usable grid points, shape (n,)."""
    stretches = stretches_where(known)
    starts = [np.arange(first, end - steps, steps, dtype=np.intp) for first, end in stretches]
    return np.concatenate([np.zeros(0, dtype=np.intp), *starts])


def window_ends(
    aligned: AlignedFlight,
    starts: NDArray[np.intp],
    steps: int,
    tail: int,
    progress: Callable[[float], None] = lambda _: None,
    windows: "Windows | None" = None,
) -> Array:
    """Outputs of the twin at the end of windows that start at measured states.

    Args:
        aligned: Flight on the grid of its twin.
        starts: Grid points at which the windows start, shape (w,); all states must be known there.
        steps: Grid steps per window.
        tail: Number of grid points before the last one that are returned as well, at most `steps`.
        progress: Called with the completed share, 0..1.
        windows: Airframe and IMU of the flight, where they are available.

    Returns:
        Values of `READ`: gyroscope, rad/s, position, m, and velocity, m/s, NED, attitude, at the
        last `tail` + 1 grid points, shape (w, tail + 1, 13).
    """
    found = np.empty((len(starts), tail + 1, len(READ)))
    windows = windows or Windows(aligned.airframe, aligned.imu)
    for first in range(0, len(starts), WINDOWS_AT_ONCE):
        part = slice(first, first + WINDOWS_AT_ONCE)
        found[part] = windows.ends(aligned, starts[part], steps, tail)
        progress(min(part.stop, len(starts)) / len(starts))
    return found


class Windows:
    """Airframe and IMU of a flight, prepared for simulation from any state."""

    def __init__(self, body: Component, sensor: Component) -> None:
        self._body = _Batch(body, body.parameter_values({"ground.enabled": 0.0}))
        self._imu = _Batch(sensor, sensor.parameter_values())
        self._sensed_index = [body.output_names.index(n) for n in sensor.input_names]
        self._gyro = [sensor.output_names.index(n) for n in GYRO]
        self._pose = [body.output_names.index(n) for n in READ[len(GYRO) :]]
        self._remembers = any(_moves_gyro(s.name) for s in sensor.states)

    def ends(
        self, aligned: AlignedFlight, starts: NDArray[np.intp], steps: int, tail: int
    ) -> Array:
        """Outputs at the ends of windows, as in `window_ends`."""
        body, sensor, u = self._body, self._imu, aligned.inputs.u
        states = np.empty((len(starts), tail + 1, len(READ)))
        if len(starts) <= FEW and not tail and not self._remembers and body.is_plain:
            after = [body.after(aligned.states[s], u[s : s + steps]) for s in starts]
            body.x = np.vstack(after)
            states[:, 0] = self._read(u[starts + steps])
            return states
        body.start(aligned.states[starts], u[starts])
        sensed = self._sensed(u[starts])
        sensor.start(sensor.initial(sensed), sensed)
        for k in range(steps + 1):
            if k:
                # Both step with their inputs from the start of the step, as under the master.
                body.advance(u[starts + k - 1])
                if self._remembers:
                    sensor.advance(sensed)
                    sensed = self._sensed(u[starts + k])
            if k >= steps - tail:
                states[:, k - (steps - tail)] = self._read(u[starts + k])
        return states

    def after(self, x: Array, u: Array) -> Array:
        """State of the airframe after a grid step with each row of inputs, shape (n_x,).

        Args:
            x: State before the step, shape (n_x,).
            u: Inputs of each row, shape (n, n_u).
        """
        return self._body.after(x, u)

    def _read(self, u: Array) -> Array:
        """Values of `READ` at the present states, shape (w, 13); without memory in the gyroscope
        the sensor's state is not needed."""
        outputs = self._body.outputs(u)
        sensed = outputs[:, self._sensed_index]
        if len(self._imu.x) != len(u):
            self._imu.x = self._imu.initial(sensed)
        readings = self._imu.outputs(sensed)
        return np.hstack([readings[:, self._gyro], outputs[:, self._pose]])

    def _sensed(self, u: Array) -> Array:
        return self._body.outputs(u)[:, self._sensed_index]


class _Batch:
    """Many runs of one component side by side, without noise; see `twin.component.Run`.

    Attributes:
        x: States, shape (w, n_x).
    """

    def __init__(self, component: Component, p: Array) -> None:
        x, u = ca.SX.sym("x", len(component.states)), ca.SX.sym("u", len(component.inputs))
        n, h = substeps(GRID_S, component.max_step_s)
        after = x
        for _ in range(n):
            after = component.step(after, u, p, h)
        function = ca.Function("step", [x, u], [ca.densify(after)])
        self._step, self._along = OverRows(function, 2), Along(function)
        y = component.outputs(x, u, p)
        self._outputs = OverRows(ca.Function("outputs", [x, u], [ca.densify(y)]), 2)
        start = component.initial(u, p)
        self._initial = OverRows(ca.Function("initial", [u], [ca.densify(start)]), 1)
        self._lines: _Lines | None = None
        if component.sampling is not None:
            self._lines = _Lines(component.sampling, p)
            d = ca.SX.sym("d", len(component.sampling.lines))
            quiet = np.zeros(component.sampling.channels)
            later = component.sampling.update(x, u, p, quiet, d)
            self._update = OverRows(ca.Function("update", [x, u, d], [ca.densify(later)]), 3)
        self.x: Array = np.zeros((0, len(component.states)))

    def initial(self, u: Array) -> Array:
        """Initial states of the component itself, shape (w, n_x)."""
        return self._initial(u)

    def start(self, x: Array, u: Array) -> None:
        """Restart at given states and inputs, the first sample instant included."""
        self.x = x
        if self._lines is not None:
            self._lines.clear(len(x))
        self._sample(u)

    def advance(self, u: Array) -> None:
        """One grid step with the inputs held, and the sample instant at its end."""
        self.x = self._step(self.x, u)
        self._sample(u)

    @property
    def is_plain(self) -> bool:
        """Whether the component has no sample instants."""
        return self._lines is None

    def after(self, x: Array, u: Array) -> Array:
        """State after one grid step from one state, with each row of inputs, shape (n_x,)."""
        (states,) = self._along(x, u)
        return np.asarray(states[-1], dtype=np.float64)

    def outputs(self, u: Array) -> Array:
        """Present outputs, shape (w, n_y)."""
        return self._outputs(self.x, u)

    def _sample(self, u: Array) -> None:
        if self._lines is not None:
            self.x = self._update(self.x, u, self._lines.look_back(self.x, u))


class _Lines:
    """Delay lines of many runs, with one sample per grid step."""

    def __init__(self, sampling: Sampling, p: Array) -> None:
        x, u = (ca.SX.sym(n, sampling.signals.numel_in(i)) for i, n in enumerate("xu"))
        signals = ca.densify(sampling.signals(x, u, p))
        self._signals = OverRows(ca.Function("signals", [x, u], [signals]), 2)
        self._delays = np.asarray(sampling.delays(p), dtype=np.float64).ravel() / GRID_S
        self._record: list[Array] = []

    def clear(self, runs: int) -> None:
        """Reset all lines."""
        self._record = []
        self._nothing = np.zeros((runs, 0))

    def look_back(self, x: Array, u: Array) -> Array:
        """Store the signals of this instant and return each with its delay, shape (w, lines).

        Signals are linear between samples, and constant before the first one.
        """
        if not len(self._delays):
            return self._nothing
        self._record.append(self._signals(x, u))
        delayed = np.empty_like(self._record[0])
        for i, steps in enumerate(self._delays):
            back = int(steps)
            after, before = (
                self._record[max(len(self._record) - 1 - j, 0)][:, i] for j in (back, back + 1)
            )
            delayed[:, i] = after + (steps - back) * (before - after)
        return delayed


def _moves_gyro(state: str) -> bool:
    """Whether a state of the IMU is observable in the gyroscope without noise."""
    return not state.startswith("acc_") and not state.endswith((".drift", ".noise"))
