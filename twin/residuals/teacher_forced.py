"""Teacher-forced evaluation: measured state and inputs in, predicted sensor readings out.

The airframe's own equations are evaluated at the measured state on a time grid, in one batch;
only the rotor states, which nobody measures, are integrated from the commands, with the same RK4
step as in the FMU.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..component import Component
from ..component.sampled import noiseless_outputs
from ..effects.timing import COMMAND_PERIOD_S
from ..errors import LogError
from ..logs import Flight
from ..logs.columns import ACC, is_known, motor_columns
from ..physics.airframe import AXES
from ..physics.rotors import Drive
from ..vehicle import Vehicle
from .gap import Channel
from .measured import RATE_CUTOFF_HZ, MeasuredMotion, Signal, differentiate, zero_phase

Array = NDArray[np.float64]
GRID_S = 1e-3
SPIN_RATE = "spin_rate_"
"""What inputs of the airframe for rotor accelerations start with."""
"""Step of the grid: the communication step of the co-simulation."""
_WARM_UP_S = 2.0
RIGID = tuple(f"{s}_{a}" for s in ("pos", "vel", "omega") for a in AXES) + tuple(
    f"q_{a}" for a in "wxyz"
)
"""States of the rigid body, which flights measure."""


@dataclass(frozen=True, slots=True)
class Inputs:
    """Inputs of the airframe on a grid.

    Attributes:
        columns: Flight-table columns that are airframe inputs of the same name.
        t_s: Grid, shape (n,).
        u: All inputs of the airframe in its order, commands as they arrive, shape (n, n_u).
        rotor_states: Rotor states of the airframe, shape (n, n_r); n_r may be 0.
        notes: What was assumed.
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


def choose_drive(flight: Flight, vehicle: Vehicle) -> Drive:
    """Measured rotor speeds where vehicle and flight allow it, else commands.

    Raises:
        LogError: The flight has neither, or not for each rotor of the vehicle.
    """
    n = vehicle.rotors.count
    rotors, commands = motor_columns("rotor", n), motor_columns("cmd", n)
    for stem, what in (("rotor", "rotor speeds"), ("cmd", "motor commands")):
        if flight.has(f"{stem}_{n + 1}"):
            raise LogError(
                f"{flight.name}: has more {what} than the {n} rotors of {vehicle.name}; "
                f"choose the vehicle file of this aircraft."
            )
    if vehicle.rotors.from_speed and flight.has(*rotors):
        return "rotor_speed"
    if vehicle.drive == "command" and flight.has(*commands):
        return "command"
    needed = rotors if vehicle.drive == "rotor_speed" else commands
    missing = [c for c in needed if not flight.has(c)]
    raise LogError(
        f"{flight.name}: no samples of {', '.join(missing)}, which drive the {n} rotors of "
        f"{vehicle.name}. The flight has: {', '.join(c for c in flight.table if flight.has(c))}."
    )


def airframe_inputs(flight: Flight, vehicle: Vehicle, airframe: Component, t_s: Array) -> Inputs:
    """Inputs of the airframe on a uniform grid: the last sample held.

    What no flight table holds, such as the wind, stays at its start value; rotor accelerations are
    those of the measured rotor speeds. The `command_delay` of
    the vehicle acts here, so that it is to be off in the airframe: a delay line knows no past where
    an airframe is started in mid-flight.
    """
    notes: list[str] = []
    late_s = vehicle.effects.get("command_delay", {}).get("delay_s")
    u = np.tile(airframe.input_values(), (len(t_s), 1))
    columns = []
    for i, name in enumerate(airframe.input_names):
        if not is_known(name):
            speed = name.replace(SPIN_RATE, "rotor_")
            if speed != name and flight.has(speed):
                u[:, i] = _rate_along(*flight.signal([speed]), t_s)
            continue
        if flight.has(name):
            signal = Signal(*flight.signal([name]))
            if late_s is None or not name.startswith("cmd_"):
                u[:, i] = signal.held(t_s)[:, 0]
            else:
                u[:, i] = _arriving(signal, t_s, late_s)
            columns.append(name)
        else:
            notes.append(
                f"no {name} in the flight: {name} = {u[0, i]:g} {airframe.inputs[i].unit} assumed"
            )
    return Inputs(
        tuple(columns), t_s, u, _rotor_states(airframe, u, float(t_s[1] - t_s[0])), tuple(notes)
    )


def as_driven(flight: Flight, airframe: Component, inputs: Inputs) -> Flight:
    """What drives the airframe, as a flight: its own table unless commands are late.

    A row for each change, since samples are held.
    """
    if "command_delay.enabled" not in (v.name for v in airframe.parameters):
        return flight
    columns = list(inputs.columns)
    u = inputs.u[:, [airframe.input_names.index(c) for c in columns]]
    kept = np.append(True, np.any(u[1:] != u[:-1], axis=1))
    kept[-1] = True
    table = pd.DataFrame(u[kept], columns=columns)
    table.insert(0, "time", inputs.t_s[kept])
    return Flight(flight.name, table)


def _rate_along(sampled_s: Array, values: Array, t_s: Array) -> Array:
    """Time derivative of a sampled signal, straight lines between its samples; shape (n,)."""
    return np.gradient(np.interp(t_s, sampled_s, values[:, 0]), t_s)


def _arriving(command: Signal, t_s: Array, delay_s: float) -> Array:
    """A held command a while later, as the airframe's delay line has it; shape (n,).

    The line is sampled at the end of each period, where what was held over it counts.
    """
    periods = max(delay_s / COMMAND_PERIOD_S, 1.0)
    whole = int(periods + 1e-9)
    after, before = (
        command.held(t_s - back * COMMAND_PERIOD_S)[:, 0] for back in (whole, whole + 1)
    )
    return np.asarray(after + max(periods - whole, 0.0) * (before - after))


def _rotor_states(airframe: Component, u: Array, step_s: float) -> Array:
    """Integrate the rotor states alone over the inputs, settled on the first input."""
    index = [i for i, s in enumerate(airframe.states) if s.name.startswith(("rotor_", "effort_"))]
    if not index:
        return np.zeros((len(u), 0))
    p = airframe.parameter_values()
    r, v = ca.SX.sym("r", len(index)), ca.SX.sym("v", u.shape[1])
    x = ca.SX(airframe.initial(airframe.input_values(), p))
    x[index] = r
    step = ca.Function("rotor_step", [r, v], [airframe.step(x, v, p, step_s)[index]])
    warm = round(_WARM_UP_S / step_s)
    held = np.vstack([np.tile(u[:1], (warm, 1)), u[:-1]])
    start = np.asarray(airframe.initial(u[0], p), dtype=np.float64).ravel()[index]
    states = step.mapaccum("rotor_states", len(held))(start, held.T)
    return np.asarray(states, dtype=np.float64).T[warm - 1 :]


def measured_states(airframe: Component, motion: MeasuredMotion, inputs: Inputs) -> Array:
    """Full airframe states at the grid, shape (n, n_x), NaN where nothing was measured.

    Position, velocity and attitude that the flight lacks altogether stay at rest, level, at the
    origin: specific force and angular acceleration need them for drag alone.
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
    rotors = [i for s, i in column.items() if s.startswith(("rotor_", "effort_"))]
    x[:, rotors] = inputs.rotor_states
    arrived = {i: s for s, i in column.items() if s.startswith("command_delay.")}
    for i, name in arrived.items():
        x[:, i] = inputs.u[:, airframe.input_names.index(name.removeprefix("command_delay."))]
    hidden = sorted(set(range(x.shape[1])) - {*rotors, *arrived} - {column[n] for n in RIGID})
    if hidden:
        x[:, hidden] = _hidden_states(airframe, hidden, x, inputs)
    return x


def _hidden_states(airframe: Component, index: list[int], x: Array, inputs: Inputs) -> Array:
    """Integrate states that nobody measures, such as a load on its rope, along the measured ones.

    Where the motion is unknown its last known values count.
    """
    known = np.all(np.isfinite(x), axis=1)
    if not known.any():
        return np.full((len(x), len(index)), np.nan)
    last = np.maximum.accumulate(np.where(known, np.arange(len(x)), -1))
    path = x[np.where(last < 0, np.argmax(known), last)]
    names = [s.name for s in airframe.states]
    begin = {f"initial.{n}": float(path[0, names.index(n)]) for n in RIGID}
    p, u = airframe.parameter_values({"ground.enabled": 0.0, **begin}), inputs.u
    z, at, v = (
        ca.SX.sym(n, k) for n, k in (("z", len(index)), ("x", x.shape[1]), ("u", u.shape[1]))
    )
    full = ca.SX(at)
    full[index] = z
    step = ca.Function("hidden_step", [z, at, v], [airframe.step(full, v, p, inputs.step_s)[index]])
    start = np.asarray(airframe.initial(u[0], p), dtype=np.float64).ravel()[index]
    after = step.mapaccum("hidden_states", len(x))(start, path.T, u.T)
    return np.vstack([start, np.asarray(after, dtype=np.float64).T[:-1]])


def predicted_readings(
    airframe: Component, imu: Component, x: Array, u: Array
) -> tuple[Array, tuple[str, ...]]:
    """Readings of the IMU and true motion at every grid point.

    Args:
        airframe: Component; its ground is switched off, the flight's contact is not measured.
        imu: Component fed by the airframe's outputs.
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
        imu: Component; its low-passes start settled on the first known input.
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


def teacher_forced_channels(
    flight: Flight,
    motion: MeasuredMotion,
    t_s: Array,
    readings: Array,
    names: tuple[str, ...],
    airborne: NDArray[np.bool_],
    phases: NDArray[np.str_],
) -> list[Channel]:
    """Channels of horizon 0: accelerometer, and angular acceleration from the gyroscope.

    Measured and predicted angular acceleration pass the same zero-phase low-pass at
    `RATE_CUTOFF_HZ`, the measured one as body rates before they are differentiated.

    Args:
        flight: Its own samples are the times of the comparison.
        motion: Measured motion.
        t_s: Grid of the prediction, shape (n,).
        readings: Prediction on the grid, shape (n, k).
        names: Names of the columns of `readings`.
        airborne: Whether the grid point counts, shape (n,).
        phases: Phase at the grid points, shape (n,).
    """
    channels: list[Channel] = []

    def add(name: str, unit: str, t: Array, measured: Array, predicted: Array) -> None:
        """Keep the samples in the air at which both sides are known."""
        near = np.clip(np.searchsorted(t_s, t), 0, len(t_s) - 1)
        good = airborne[near] & np.isfinite(measured) & np.isfinite(predicted)
        if good.any():
            channels.append(
                Channel(
                    name, unit, 0.0, t[good], measured[good], predicted[good], phases[near][good]
                )
            )

    if flight.has(*ACC):
        t, acc = flight.signal(ACC)
        inside = (t >= t_s[0]) & (t <= t_s[-1])
        for i, name in enumerate(ACC):
            predicted = _sampled(t_s, readings[:, names.index(name)], t[inside])
            add(name, "m/s²", t[inside], acc[inside, i], predicted)
    if motion.rates is not None and motion.rates_measured:
        inside = (motion.rates.t_s >= t_s[0]) & (motion.rates.t_s <= t_s[-1])
        t = motion.rates.t_s[inside]
        measured = differentiate(motion.rates)[inside]
        for i, axis in enumerate(AXES):
            grid = readings[:, names.index(f"angular_acceleration_{axis}")]
            raw = _sampled(t_s, grid, t)
            bad = ~np.isfinite(raw)
            smooth = zero_phase(Signal(t, np.where(bad, 0.0, raw)[:, None]), RATE_CUTOFF_HZ)[:, 0]
            add(f"angacc_{axis}", "rad/s²", t, measured[:, i], np.where(bad, np.nan, smooth))
    return channels


def _sampled(t_grid: Array, values: Array, t_s: Array) -> Array:
    """Linear interpolation between grid points, NaN next to NaN."""
    return np.interp(t_s, t_grid, values)
