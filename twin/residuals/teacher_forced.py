"""Teacher-forced evaluation: measured state and inputs in, predicted sensor readings out.

The airframe's own equations are evaluated at the measured state on a time grid, in one batch.
States that no flight measures, such as rotor speed, motor temperature or a slung load, are
integrated along the measured ones, with the steps and sample instants of the component's own
equations and all random draws zero.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..component import Component
from ..component.along import BUILDING, Along, mapped
from ..component.rows import noiseless_outputs
from ..draft.consistency import check_airframe, consistency
from ..effects import acting_late, late_actions
from ..effects.timing import COMMAND_PERIOD_S
from ..errors import LogError
from ..frames import AXES
from ..logs import AnyFlight
from ..logs.columns import is_known, motor_columns
from ..physics.rotors import Drive
from ..representation import ShortRepr
from ..vehicle import Vehicle
from .measured import AnySignal, MeasuredMotion, Signal, differentiate, signal_of

Array = NDArray[np.float64]


def integrate_states(
    component: Component, index: Sequence[int], x: Array, u: Array, p: Array, step_s: float
) -> Array:
    """Integrated states of a component along the other states and the inputs, from its own initial
    values.

    Arguments and result as in `Integration`.
    """
    return Integration(component, index, p, step_s).along(x, u)


class Integration:
    """Integration of some states of a component along the others and the inputs, one block of rows
    after another.

    Inputs of a delay line may depend on inputs and measured states, not on integrated states.
    """

    def __init__(self, component: Component, index: Sequence[int], p: Array, step_s: float) -> None:
        """Begin at the component's own initial values.

        Args:
            component: Component with the equations of the states.
            index: Indices of the states.
            p: Parameters.
            step_s: Step of the grid.
        """
        self._component, self._index, self._p, self._step_s = component, list(index), p, step_s
        n_x, n_u = len(component.states), len(component.inputs)
        z, at, v = (ca.SX.sym(n, k) for n, k in (("z", len(index)), ("x", n_x), ("u", n_u)))
        full = ca.SX(at)
        full[self._index] = z
        self._sampled = _Sampled(component, self._index, p, step_s) if self._changes() else None
        after = component.step(full, v, p, step_s)[self._index]
        self._along = Along(ca.Function("hidden_step", [z, at, v], [after]))
        self._state: Array | None = None  # before the next row
        self._last = np.zeros((0, n_x)), np.zeros((0, n_u))  # last known values

    def along(self, x: Array, u: Array) -> Array:
        """The integrated states in the next rows.

        Where a value is unknown the last known one is used.

        Args:
            x: All states on a uniform grid, those to be integrated not used, NaN where unknown,
                shape (n, n_x).
            u: Inputs on that grid, NaN where unknown, shape (n, n_u).

        Returns:
            Integrated states, shape (n, len(index)); NaN until all values have been known once.
        """
        x, u = np.vstack([self._last[0], x]), np.vstack([self._last[1], u])
        others = np.setdiff1d(np.arange(x.shape[1]), self._index)
        known = np.all(np.isfinite(x[:, others]), axis=1) & np.all(np.isfinite(u), axis=1)
        before = len(self._last[0])
        if not known.any():
            return np.full((len(x), len(self._index)), np.nan)
        last = np.maximum.accumulate(np.where(known, np.arange(len(x)), -1))
        rows = np.where(last < 0, np.argmax(known), last)
        path, inputs = x[rows][before:], u[rows][before:]
        self._last = path[-1:], inputs[-1:]
        if self._state is None:
            with BUILDING:
                start = self._component.initial(inputs[0], self._p)
                self._state = np.asarray(start, dtype=np.float64).ravel()[self._index]
        if self._sampled is not None:
            after, here = self._sampled.along(self._state, path, inputs)
        else:
            (after,) = self._along(self._state, path, inputs)
            here = np.vstack([self._state, after[:-1]])
        self._state = after[-1]
        return here

    def _changes(self) -> bool:
        """Whether any of the states changes at sample instants."""
        if self._component.sampling is None:
            return False
        update = self._component.sampling.update
        x, u, p, w, d = update.sx_in()
        after = update(x, u, p, w, d)
        return not all(ca.is_equal(after[i], x[i], 2) for i in self._index)


class _Sampled:
    """Integration with memory, sampled at the component's own period."""

    def __init__(self, component: Component, index: list[int], p: Array, step_s: float) -> None:
        sampling = component.sampling
        assert sampling is not None
        self._sampling, self._p, self._step_s = sampling, p, step_s
        names = [v.name for v in component.parameters]
        period = float(p[names.index(sampling.period)])
        often, self._seldom = max(1, round(step_s / period)), max(1, round(period / step_s))
        self._delays_s = np.asarray(sampling.delays(p), dtype=np.float64).ravel()
        z, at, v, d, now = (
            ca.SX.sym(n, k)
            for n, k in (
                ("z", len(index)),
                ("x", len(component.states)),
                ("u", len(component.inputs)),
                ("d", len(self._delays_s)),
                ("now", 1),
            )
        )
        quiet = np.zeros(sampling.channels)

        def sample(values: ca.SX) -> ca.SX:
            """Values after a sample instant."""
            full = ca.SX(at)
            full[index] = values
            return sampling.update(full, v, p, quiet, d)[index]

        def advance(values: ca.SX, h: float) -> ca.SX:
            """Values after a step."""
            full = ca.SX(at)
            full[index] = values
            return component.step(full, v, p, h)[index]

        here = ca.if_else(now, sample(z), z)
        then = advance(here, step_s / often)
        for _ in range(often - 1):
            then = advance(sample(then), step_s / often)
        self._both = Along(ca.Function("both", [z, at, v, d, now], [then, here]))
        self._count = 0  # number of rows so far
        self._past = np.zeros((len(self._delays_s), 0))  # signals of the last rows

    def along(self, state: Array, path: Array, inputs: Array) -> tuple[Array, Array]:
        """States after each row's step, and in the row, shape (n, k) each."""
        every_p = np.broadcast_to(self._p, (len(path), len(self._p)))
        signals = mapped(self._sampling.signals, path, inputs, every_p).T
        signals = np.hstack([self._past, signals])
        past = self._past.shape[1]
        rows = np.arange(self._count, self._count + len(path))
        t = self._step_s * np.arange(self._count - past, self._count + len(path))
        late = [np.interp(t[past:] - d, t, s) for d, s in zip(self._delays_s, signals, strict=True)]
        instants = (rows % self._seldom == 0).astype(np.float64)
        delayed = np.reshape(late, (len(late), len(path))).T
        after, here = self._both(state, path, inputs, delayed, instants[:, None])
        reach = int(np.max(self._delays_s, initial=0.0) / self._step_s) + 2
        self._past, self._count = signals[:, -reach:], self._count + len(path)
        return after, here


GRID_S = 1e-3
"""Step of the grid, s: the communication step of the co-simulation."""
SAMPLED_HZ = 30.0
"""Lower limit of a flight controller's command rate; a log below it has decimated commands."""
SPIN_RATE = "spin_rate_"
"""Prefix of the airframe's inputs for rotor accelerations."""
_WARM_UP_S = 2.0
"""Time for which rotors settle on the first inputs, s: twenty time constants of 0.1 s."""
RIGID = tuple(f"{s}_{a}" for s in ("pos", "vel", "omega") for a in AXES) + tuple(
    f"q_{a}" for a in "wxyz"
)
"""States of the rigid body, which flights measure."""


@dataclass(frozen=True, slots=True)
class Inputs(ShortRepr):
    """Inputs of the airframe on a grid.

    Attributes:
        columns: Flight-table columns that are airframe inputs of the same name.
        t_s: Grid, shape (n,).
        u: All inputs of the airframe in its order, commands at their time of arrival, shape (n,
            n_u).
        rotor_states: Rotor states of the airframe, shape (n, n_r); n_r may be 0.
        notes: Notes on assumptions.
    """

    columns: tuple[str, ...]
    t_s: Array
    u: Array
    rotor_states: Array
    notes: tuple[str, ...]

    @property
    def step_s(self) -> float:
        """Step of the grid."""
        return float(self.t_s[1] - self.t_s[0])


def choose_drive(flight: AnyFlight, vehicle: Vehicle) -> Drive:
    """Input of the twin: measured rotor speeds where vehicle and flight allow it, else commands.

    Speeds that a telemetry link has delayed are smoothed, and their small amplitude makes an
    aircraft appear light: for an 18 kg aircraft the moment of its speeds is half of that of its
    commands from 0.8 to 3 Hz, and the estimated inertia was 0.6 of the true one. With such speeds
    the commands are used, where there are any.

    Raises:
        LogError: The flight has neither, or not for each rotor of the vehicle.
        ModelError: The rotors in the log differ from those of the vehicle.
    """
    check_airframe(flight, vehicle)
    n = vehicle.rotors.count
    rotors, commands = motor_columns("rotor", n), motor_columns("cmd", n)
    for stem, what in (("rotor", "rotor speeds"), ("cmd", "motor commands")):
        if flight.has(f"{stem}_{n + 1}"):
            raise LogError(
                f"{flight.name}: has more {what} than the {n} rotors of {vehicle.name}; "
                f"choose the vehicle file of this aircraft."
            )
    commanded = vehicle.drive == "command" and flight.has(*commands)
    late = commanded and flight.speeds_late_s > 0
    if vehicle.rotors.from_speed and flight.has(*rotors) and not late:
        return "rotor_speed"
    if commanded:
        return "command"
    needed = rotors if vehicle.drive == "rotor_speed" else commands
    missing = [c for c in needed if not flight.has(c)]
    raise LogError(
        f"{flight.name}: no samples of {', '.join(missing)}, which drive the {n} rotors of "
        f"{vehicle.name}. The flight has: {', '.join(c for c in flight.columns if flight.has(c))}."
    )


SPEEDS, COMMANDS = "measured rotor speeds", "motor commands"
"""Inputs of a twin, in words."""


def driven_by(flight: AnyFlight, vehicle: Vehicle) -> str:
    """Input of the twin of a flight, in words, with the reason where its log has rotor speeds that
    are not used; raises as `choose_drive`."""
    if choose_drive(flight, vehicle) == "rotor_speed":
        return SPEEDS
    if not flight.has("rotor_1"):
        return COMMANDS
    if vehicle.rotors.from_speed and flight.speeds_late_s > 0:
        return f"{COMMANDS}: a link has delayed the rotor speeds"
    return f"{COMMANDS}: the vehicle file has no thrust by rotor speed"


def drive_warnings(flight: AnyFlight, vehicle: Vehicle) -> list[str]:
    """Doubts of the reader, and its changes, on the rotor speeds and angles that the twin uses, and
    contradictions between log and vehicle file."""
    signals = ("rotor", "attitude") if flight.derived_angles else ("rotor",)
    read = [
        f"{f.where}: {f.message}"
        for f in flight.findings
        if f.where in signals and f.severity == "warning"
    ]
    return [f"{flight.name}: {t}" for t in (*read, *consistency(flight, vehicle).warnings)]


class InputSignals:
    """Input signals of an airframe from a flight.

    Commands and voltage hold their last sample; measured rotor speeds are linear between two.
    Inputs that no flight table contains, such as the wind, are at their start values; rotor
    accelerations are those of the measured rotor speeds. Delays of commands in the vehicle's
    effects are applied here, so they must be off in the airframe: a delay line has no past where an
    airframe is started in mid-flight.

    Attributes:
        columns: Flight-table columns that are airframe inputs of the same name.
        notes: Notes on assumptions.
    """

    def __init__(self, flight: AnyFlight, vehicle: Vehicle, airframe: Component) -> None:
        late_s = late_actions(vehicle)
        self._start = airframe.input_values()
        self._at: dict[int, Callable[[Array], Array]] = {}
        columns, notes = [], []
        for i, name in enumerate(airframe.input_names):
            if not is_known(name):
                speed = name.replace(SPIN_RATE, "rotor_")
                if speed != name and flight.has(speed):
                    self._at[i] = partial(_rate, _rate_of_change(signal_of(flight, [speed])))
            elif flight.has(name):
                signal = signal_of(flight, [name])
                delay_s = late_s.get(name.rpartition("_")[0])
                if delay_s is not None:
                    self._at[i] = partial(_arriving, signal, delay_s)
                elif name.startswith("rotor_"):
                    self._at[i] = partial(_speed, signal)
                else:
                    self._at[i] = partial(_held, signal)
                columns.append(name)
            else:
                notes.append(
                    f"no {name} in the flight: {name} = {self._start[i]:g} "
                    f"{airframe.inputs[i].unit} assumed"
                )
        self.columns, self.notes = tuple(columns), tuple(notes)

    def at(self, t_s: Array) -> Array:
        """All inputs of the airframe in its order, shape (n, n_u)."""
        u = np.tile(self._start, (len(t_s), 1))
        for i, value in self._at.items():
            u[:, i] = value(t_s)
        return u


def _held(signal: AnySignal, t_s: Array) -> Array:
    return signal.held(t_s + _ahead_s(signal))[:, 0]


def _ahead_s(command: AnySignal) -> float:
    """Lead of a held command: half a period of a log whose rate of commands is below that of any
    flight controller, since holding makes the mean late by that time."""
    return 0.5 / command.rate_hz if 0 < command.rate_hz < SAMPLED_HZ else 0.0


def _speed(signal: AnySignal, t_s: Array) -> Array:
    """A measured speed, held where two samples are too far apart; shape (n,).

    Holding it everywhere would delay it by half an interval.
    """
    speed = signal.at(t_s)[:, 0]
    unknown = np.isnan(speed)
    if unknown.any():
        speed[unknown] = signal.held(t_s[unknown])[:, 0]
    return speed


def _arriving(command: AnySignal, delay_s: float, t_s: Array) -> Array:
    """A held command after a delay, as in the airframe's delay line; shape (n,).

    The line is sampled at the end of each period, with the value held during it.
    """
    t_s = t_s + _ahead_s(command)
    periods = max(delay_s / COMMAND_PERIOD_S, 1.0)
    whole = int(periods + 1e-9)
    after, before = (
        command.held(t_s - back * COMMAND_PERIOD_S)[:, 0] for back in (whole, whole + 1)
    )
    return np.asarray(after + max(periods - whole, 0.0) * (before - after))


def _rate_of_change(signal: AnySignal) -> Signal:
    return Signal(signal.t_s, differentiate(signal), signal.settled_hz)


def _rate(rate: Signal, t_s: Array) -> Array:
    """Rate of change of a measured speed, 0 where it is unknown; shape (n,)."""
    return np.nan_to_num(rate.at(t_s)[:, 0])


def rotor_states_of(airframe: Component) -> list[int]:
    """Indices of the states of the rotors: speeds or effective commands."""
    return [i for i, s in enumerate(airframe.states) if s.name.startswith(("rotor_", "effort_"))]


class RotorStates:
    """The rotor states by the inputs, in steady state on the first of them, one block of rows after
    another."""

    def __init__(self, airframe: Component, step_s: float, changed: Sequence[str] = ()) -> None:
        """Build the step function.

        Args:
            airframe: Component with the equations of the states.
            step_s: Step of the grid.
            changed: Parameters whose values are given with the inputs.
        """
        self._airframe, self._index = airframe, rotor_states_of(airframe)
        self._changed = tuple(changed)
        r, v = ca.SX.sym("r", len(self._index)), ca.SX.sym("v", len(airframe.inputs))
        values = ca.SX.sym("values", len(changed))
        p, names = ca.SX(airframe.parameter_values()), [n.name for n in airframe.parameters]
        for i, name in enumerate(changed):
            p[names.index(name)] = values[i]
        x = ca.SX(airframe.initial(airframe.input_values(), p))
        x[self._index] = r
        after = airframe.step(x, v, p, step_s)[self._index]
        self._along = Along(ca.Function("rotor_step", [r, v, values], [after]))
        self._warm = round(_WARM_UP_S / step_s)
        self._last: tuple[Array, Array] | None = None  # state and inputs of the last row

    def along(self, u: Array) -> Array:
        """States at the next rows of inputs, shape (n, n_r)."""
        found = self._from(self._last, u, ())
        self._last = found[-1], u[-1:]
        return found

    def settled(self, u: Array, values: Mapping[str, float]) -> Array:
        """States over all inputs with some parameters changed, shape (n, n_r)."""
        return self._from(None, u, [values[name] for name in self._changed])

    def _from(self, last: tuple[Array, Array] | None, u: Array, values: Sequence[float]) -> Array:
        """States at rows that follow a state and its inputs; None: from steady state."""
        if not self._index:
            return np.zeros((len(u), 0))
        found = np.empty((len(u), len(self._index)))
        if last is None:
            p = self._airframe.parameter_values(dict(zip(self._changed, values, strict=True)))
            with BUILDING:
                start = np.asarray(self._airframe.initial(u[0], p), dtype=np.float64).ravel()
            last = start[self._index], np.tile(u[:1], (self._warm, 1))
        found[0] = self._advanced(*last, values)[-1]
        if len(u) > 1:
            found[1:] = self._advanced(found[0], u[:-1], values)
        return found

    def _advanced(self, start: Array, u: Array, values: Sequence[float]) -> Array:
        rows = np.broadcast_to(np.array(values, dtype=np.float64), (len(u), len(values)))
        return self._along(start, u, rows)[0]


def measured_states(
    airframe: Component,
    motion: MeasuredMotion,
    inputs: Inputs,
    hidden: "HiddenStates | None" = None,
) -> Array:
    """Full airframe states on the grid, shape (n, n_x), NaN where not measured.

    Position, velocity and attitude that the flight does not have at all are zero, level, at the
    origin: specific force and angular acceleration depend on them only through drag.

    Args:
        airframe: Component with the equations of the unmeasured states.
        motion: Measured motion.
        inputs: Inputs on a uniform grid.
        hidden: Unmeasured states, up to this block of rows; None: it is the first.
    """
    t = inputs.t_s
    x = np.zeros((len(t), len(airframe.states)))
    column = {s.name: i for i, s in enumerate(airframe.states)}
    x[:, column["q_w"]] = 1.0
    groups = (
        ([f"pos_{a}" for a in AXES], motion.position),
        ([f"vel_{a}" for a in AXES], motion.velocity),
        ([f"q_{a}" for a in "wxyz"], motion.attitude),
        ([f"omega_{a}" for a in AXES], motion.rates),
    )
    for names, signal in groups:
        if signal is not None:
            values = signal.at(t)
            if signal is motion.attitude:
                values = values / np.linalg.norm(values, axis=1, keepdims=True)
            x[:, [column[n] for n in names]] = values
    rotors = rotor_states_of(airframe)
    x[:, rotors] = inputs.rotor_states
    for i, name in _arrived(airframe).items():
        x[:, i] = inputs.u[:, airframe.input_names.index(name)]
    hidden = hidden or hidden_of(airframe, inputs.step_s)
    if hidden.index:
        x[:, hidden.index] = hidden.along(x, inputs.u)
    return x


def _arrived(airframe: Component) -> dict[int, str]:
    """Indices of states that equal an input at its time of arrival, and these inputs."""
    late = {e.name for e in acting_late()}
    stems = ((i, s.name.partition(".")) for i, s in enumerate(airframe.states))
    return {i: name for i, (stem, _, name) in stems if stem in late}


def hidden_of(airframe: Component, step_s: float) -> "HiddenStates":
    """Unmeasured states of an airframe, at their initial values."""
    measured = {i for i, s in enumerate(airframe.states) if s.name in RIGID}
    measured |= {*rotor_states_of(airframe), *_arrived(airframe)}
    return HiddenStates(airframe, sorted(set(range(len(airframe.states))) - measured), step_s)


def hidden_states(airframe: Component, index: list[int], x: Array, inputs: Inputs) -> Array:
    """Unmeasured states of a whole flight, as in `HiddenStates`.

    Args:
        airframe: Component with their equations and initial values.
        index: Indices of the states.
        x: All states on the grid, shape (n, n_x); those of `index` are not used.
        inputs: Inputs on the same grid.

    Returns:
        States, shape (n, len(index)).
    """
    return HiddenStates(airframe, index, inputs.step_s).along(x, inputs.u)


class HiddenStates:
    """Unmeasured states, such as a slung load, integrated along the measured ones, one block of
    rows after another.

    Where the motion is unknown its last known values are used.
    """

    def __init__(self, airframe: Component, index: list[int], step_s: float) -> None:
        self._airframe, self.index, self._step_s = airframe, index, step_s
        self._integration: Integration | None = None

    def along(self, x: Array, u: Array) -> Array:
        """The states at the next rows, shape (n, len(index)).

        Args:
            x: All states, shape (n, n_x); those to be integrated are not used.
            u: Inputs, shape (n, n_u).
        """
        if self._integration is None:
            known = np.all(np.isfinite(x), axis=1)
            if not known.any():
                return np.full((len(x), len(self.index)), np.nan)
            first = x[int(np.argmax(known))]
            names = [s.name for s in self._airframe.states]
            begin = {f"initial.{n}": float(first[names.index(n)]) for n in RIGID}
            p = self._airframe.parameter_values({"ground.enabled": 0.0, **begin})
            with BUILDING:
                self._integration = Integration(self._airframe, self.index, p, self._step_s)
        return self._integration.along(x, u)


def predicted_readings(
    airframe: Component, imu: Component, x: Array, u: Array
) -> tuple[Array, tuple[str, ...]]:
    """Readings of the IMU and true motion at every grid point.

    Args:
        airframe: Airframe component; its ground is switched off, since contact is not measured.
        imu: Component with the airframe's outputs as inputs.
        x: States, shape (n, n_x).
        u: Inputs, shape (n, n_u).

    Returns:
        Values, shape (n, k), and their names: IMU outputs, then airframe outputs.
    """
    y = airframe.outputs_along(x, u, {"ground.enabled": 0.0})
    sensed = y[:, [airframe.output_names.index(n) for n in imu.input_names]]
    readings = sensor_readings(imu, sensed)
    return np.hstack([readings, y]), imu.output_names + airframe.output_names


def sensor_readings(imu: Component, sensed: Array) -> Array:
    """Readings of the IMU on a grid of `GRID_S`.

    Args:
        imu: IMU component; its low-passes start in steady state on the first known input.
        sensed: Inputs of the IMU, shape (n, n_u), NaN where unknown; a low-pass holds the last
            known input there.

    Returns:
        Outputs of the IMU, shape (n, n_y), NaN where an input is unknown.
    """
    known = np.all(np.isfinite(sensed), axis=1)
    if not known.any():
        return np.full((len(sensed), len(imu.output_names)), np.nan)
    last = np.maximum.accumulate(np.where(known, np.arange(len(sensed)), -1))
    clean = sensed[np.where(last < 0, np.argmax(known), last)]
    readings = noiseless_outputs(imu, clean, GRID_S)
    readings[~known] = np.nan
    return readings
