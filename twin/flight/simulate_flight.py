"""Closed-loop flight of a plant along setpoints, recorded as a flight table."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import scipy
from numpy.typing import NDArray

from ..component import Component
from ..component.rows import noiseless_outputs
from ..effects import EFFECTS, Average, Displacement, Repeats, Shift
from ..frames import AXES, cross, to_ned
from ..logs import Flight, Site
from ..logs.autopilot import setpoints_of_mission
from ..logs.columns import POS, QUAT, VEL
from ..physics.airframe import airframe, frame_origin
from ..physics.sensors.table import components_of_sensors
from ..vehicle import Vehicle
from .closed_loop import FARTHEST_ARMS, FARTHEST_M, STEEPEST_RAD, STEP_S, fly, standing
from .lqr import controller

Array = NDArray[np.float64]

TURN = tuple(f"omega_{a}" for a in AXES)
"""Body rates among the states of an airframe."""


@dataclass(frozen=True, slots=True)
class Stream:
    """Columns of a record that are sampled together.

    Attributes:
        columns: Columns of the flight table.
        period_s: Time between two samples, rounded to an integer number of rows of the record.
        noise: Standard deviation of white noise on each sample, in the unit of the columns; a
            quaternion remains of unit length.
    """

    columns: tuple[str, ...]
    period_s: float
    noise: float = 0.0


@dataclass(frozen=True, slots=True)
class Recorder:
    """Settings for the recording of a simulated flight.

    Attributes:
        streams: Signals to record, as far as the twin has them.
        rate_hz: Rows of the table per second.
        sampled_hz: Sample rate of the sensors; a multiple of `rate_hz`.
        seed: Seed of the noise.
        early_commands: Whether delayed commands are recorded early in a flight that is otherwise
            unchanged; else they are recorded when given, and the plant delays them.
        until_lost: Whether the record ends where the vehicle tumbles or strays from its setpoints.
    """

    streams: tuple[Stream, ...]
    rate_hz: float
    sampled_hz: float
    seed: int = 0
    early_commands: bool = False
    until_lost: bool = False


@dataclass(frozen=True, slots=True)
class Later:
    """Effects that begin during a flight.

    Attributes:
        effects: Numbers of each effect, by identifier.
        from_s: Start time.
    """

    effects: Mapping[str, Mapping[str, float]]
    from_s: float


def simulate_flight(
    setpoints: Array,
    phases: Sequence[str],
    vehicle: Vehicle,
    plant: Vehicle,
    recorder: Recorder,
    name: str = "simulated",
    voltage_v: float | None = None,
    later: Later | None = None,
    courses: Mapping[str, Array] | None = None,
) -> Flight:
    """Fly setpoints in closed loop, starting on the ground, and record the sensors.

    The controller reads the true motion: a delay or smoothing of the pose in the plant applies to
    the record only. The recorded pose is that of the centre of mass by the vehicle file: markers,
    antennas and IMU are fixed to the frame and do not move with the centre of mass.

    Args:
        setpoints: Setpoints in the order of `closed_loop.SETPOINTS`, one row per `STEP_S`, shape
            (n, 11).
        phases: Phase of each row.
        vehicle: Vehicle for which the controller is designed.
        plant: Vehicle that flies, with its effects.
        recorder: Settings of the recording.
        name: Name of the flight.
        voltage_v: Voltage of the battery, constant; default: that of the plant.
        later: Effects that begin during the flight, from the plant's motion at that time.
        courses: Inputs of the airframe that change in flight, such as the wind, by name, one value
            per step, shape (n,).

    Raises:
        ModelError: No controller can be designed, or the plant has no hover trim.
    """
    courses = dict(courses or {})
    volts = plant.voltage_v if voltage_v is None else voltage_v
    flown = _punctual(plant, recorder)
    body = airframe(flown, effects=() if later is None else _added(later.effects, flown))
    body = body.with_starts(standing(body, flown))
    held = {"vbat_v": volts} if "vbat_v" in body.input_names else {}
    changes: dict[str, tuple[float, float]] = {}
    ended = plant
    if later is not None:
        ended = plant.with_effects({**plant.effects, **later.effects})
        changes = _changes(body, airframe(_punctual(ended, recorder), trimmed=False))
        begun = STEP_S * np.arange(len(setpoints)) >= later.from_s
        steps = {k: np.where(begun, after, before) for k, (before, after) in changes.items()}
    given = {k: v for k, v in courses.items() if k in body.input_names}
    states, inputs = fly(
        body,
        controller(_punctual(vehicle, recorder)),
        setpoints,
        held,
        given if later is None else given | steps,
    )
    end = _lost(setpoints, phases, body, states, plant) if recorder.until_lost else len(states)
    rows = slice(None, end, round(1 / (recorder.sampled_hz * STEP_S)))
    t_s = np.arange(len(states[rows])) / recorder.sampled_hz
    voltage = courses.get("vbat_v", np.full(len(states), volts))[rows]
    changed = t_s >= (np.inf if later is None else later.from_s)
    origin = np.where(changed[:, None], frame_origin(ended), frame_origin(plant))
    frame = _of_frame(body, states[rows], origin)
    seen = states[rows], inputs[rows], frame, voltage
    known, since = _recorded(body, {}, plant, *seen, recorder), {}
    if later is not None:
        on = {k: after for k, (_, after) in changes.items()}
        after = _recorded(body, on, ended, *seen, recorder)
        known = {k: np.where(changed, after[k], known[k]) for k in known}
        since = {c: max(s, later.from_s) for c, s in _stuck_columns(later.effects)}
    since = dict(_stuck_columns(plant.effects)) | since
    outdoors = Site(False, "simulated without walls")
    table = _table(known, phases[rows], recorder, since)
    asked = setpoints_of_mission(setpoints[:end], STEP_S, plant.gravity_m_s2)
    return Flight(name, table, site=outdoors, autopilot=asked)


def _added(effects: Iterable[str], flown: Vehicle) -> list[str]:
    """Effects for which the airframe needs parameters, switched off."""
    own = [e for e in effects if EFFECTS[e].in_the_air and e not in flown.effects]
    return [e for e in own if not isinstance(EFFECTS[e].observable_as, Shift)]


def _changes(before: Component, after: Component) -> dict[str, tuple[float, float]]:
    """Parameters of an airframe that differ from those of another one, with both values."""
    old, new = (
        dict(zip((v.name for v in b.parameters), b.parameter_values(), strict=True))
        for b in (before, after)
    )
    both = {k: (float(old[k]), float(v)) for k, v in new.items() if k in old}
    return {k: v for k, v in both.items() if v[0] != v[1] and not k.startswith("initial.")}


def _recorded(
    body: Component,
    parameters: Mapping[str, float],
    plant: Vehicle,
    states: Array,
    inputs: Array,
    frame: dict[str, Array],
    voltage_v: Array,
    recorder: Recorder,
) -> dict[str, Array]:
    """Signals of a flight for a recorder, without noise, by column, shape (n,) each."""
    y = body.outputs_along(states, inputs, parameters)
    known = dict(zip(body.output_names, y.T, strict=True)) | frame
    known |= dict(zip(body.input_names, inputs.T, strict=True))
    known["vbat_v"] = voltage_v
    _sense(known, _punctual(plant, recorder), recorder)
    for place in _displacements(plant):
        known |= _displaced(known, place)
    t_s = np.arange(len(states)) / recorder.sampled_hz
    for column, later_s in _late_columns(plant, recorder, list(known)):
        known[column] = np.interp(t_s - later_s, t_s, known[column])
    for column, width_s in _averaged_columns(plant, list(known)):
        known[column] = scipy.ndimage.gaussian_filter1d(
            known[column], width_s * recorder.sampled_hz, mode="nearest"
        )
    return known


def _of_frame(body: Component, states: Array, origin: Array) -> dict[str, Array]:
    """Position and velocity of a point on the frame, by column, shape (n,) each.

    Args:
        body: The airframe.
        states: States of its centre of mass, shape (n, n_x).
        origin: Position of the point from the centre of mass, body FRD, m, shape (n, 3). Where it
            changes, the centre of mass moves.
    """
    at = [s.name for s in body.states].index
    pos, vel, q, omega = (
        list(states[:, [at(c) for c in columns]].T) for columns in (POS, VEL, QUAT, TURN)
    )
    moved = np.diff(origin, axis=0, prepend=origin[:1])
    place = np.array(to_ned(q, list(origin.T)))
    place -= np.cumsum(to_ned(q, list(moved.T)), axis=1)
    speed = np.array(to_ned(q, cross(omega, list(origin.T))))
    return dict(zip((*POS, *VEL), np.vstack([pos + place, vel + speed]), strict=True))


def _stuck_columns(effects: Mapping[str, Mapping[str, float]]) -> Iterator[tuple[str, float]]:
    """Columns that are frozen, noise included, and the start time, s."""
    for effect, numbers in effects.items():
        observable_as = EFFECTS[effect].observable_as
        if isinstance(observable_as, Repeats) and numbers[observable_as.channel] >= 1:
            column = observable_as.channels[round(numbers[observable_as.channel]) - 1]
            yield column, numbers.get(observable_as.since, 0.0)


def _sense(known: dict[str, Array], flown: Vehicle, recorder: Recorder) -> None:
    """Add the readings of the recorded sensors, without noise."""
    wanted = {c for stream in recorder.streams for c in stream.columns}
    n = len(known["vbat_v"])
    for make in components_of_sensors().values():
        sensor = make(flown, ())
        if not wanted & set(sensor.output_names):
            continue
        sensed = np.tile(sensor.input_values(), (n, 1))
        for i, name in enumerate(sensor.input_names):
            sensed[:, i] = known.get(name, sensed[:, i])
        readings = noiseless_outputs(sensor, sensed, 1 / recorder.sampled_hz)
        known |= dict(zip(sensor.output_names, readings.T, strict=True))


def _table(
    known: dict[str, Array],
    phases: Sequence[str],
    recorder: Recorder,
    stuck_since_s: Mapping[str, float],
) -> pd.DataFrame:
    """The flight table: samples of each stream, noise added, NaN between them."""
    rng, n = np.random.default_rng(recorder.seed), len(phases)
    every = round(recorder.sampled_hz / recorder.rate_hz)
    columns = {"time": np.arange(n) / recorder.sampled_hz}
    for stream in recorder.streams:
        if not set(stream.columns) <= known.keys():
            continue
        values = np.column_stack([known[c] for c in stream.columns])
        if stream.noise:
            values += stream.noise * rng.standard_normal(values.shape)
            if stream.columns == QUAT:
                values /= np.linalg.norm(values, axis=1, keepdims=True)
        period = every * max(1, round(stream.period_s * recorder.rate_hz))
        sampled = np.arange(n) % period == 0
        for i, column in enumerate(stream.columns):
            if column in stuck_since_s:
                held = sampled & (columns["time"] >= stuck_since_s[column])
                values[held, i] = values[np.argmax(held), i]
        values[~sampled] = np.nan
        columns |= dict(zip(stream.columns, values.T, strict=True))
    table = pd.DataFrame({c: v[::every] for c, v in columns.items()})
    table["phase"] = list(phases[::every])
    return table


def _punctual(vehicle: Vehicle, recorder: Recorder) -> Vehicle:
    """The vehicle without delays that affect a record but not a flight."""
    retained = {k: v for k, v in vehicle.effects.items() if _of_record(k, recorder) is None}
    return vehicle.with_effects(retained)


def _of_record(effect: str, recorder: Recorder) -> Shift | None:
    """Time shift of an effect in a record; a late sensor is modelled in its component."""
    observable_as = EFFECTS[effect].observable_as
    if not isinstance(observable_as, Shift) or EFFECTS[effect].component in components_of_sensors():
        return None
    return None if observable_as.acts and not recorder.early_commands else observable_as


def _late_columns(
    plant: Vehicle, recorder: Recorder, known: Iterable[str]
) -> Iterator[tuple[str, float]]:
    """Columns of a record that a delay shifts, and the delay, s; negative for early ones.

    A number that an effect of the aircraft has in logs only is applied to its first one.
    """
    for effect, numbers in plant.effects.items():
        shift = _of_record(effect, recorder)
        if shift is None:
            continue
        of_aircraft = EFFECTS[effect].of_vehicle
        usual = numbers[next(iter(shift.moves))] if of_aircraft else 0.0
        for number, signals in shift.moves.items():
            delay_s = numbers.get(number, usual)
            for column in known:
                if column.rpartition("_")[0] in signals:
                    yield column, -delay_s if shift.acts else delay_s


def _displacements(plant: Vehicle) -> Iterator[list[float]]:
    """Places at which the position is logged, from the origin of the model, body FRD, m."""
    for effect, numbers in plant.effects.items():
        observable_as = EFFECTS[effect].observable_as
        if isinstance(observable_as, Displacement):
            yield [numbers.get(number, 0.0) for number in observable_as.less]


def _displaced(known: Mapping[str, Array], place: Sequence[float]) -> dict[str, Array]:
    """Position and velocity of a point at a place in the body, FRD, m, by column."""
    q, omega = ([known[c] for c in columns] for columns in (QUAT, TURN))
    moved = [*to_ned(q, list(place)), *to_ned(q, cross(omega, list(place)))]
    return {c: known[c] + more for c, more in zip((*POS, *VEL), moved, strict=True)}


def _averaged_columns(plant: Vehicle, known: Sequence[str]) -> Iterator[tuple[str, float]]:
    """Columns of a record that are averages over time, and the standard width of each, s."""
    for effect, numbers in plant.effects.items():
        observable_as = EFFECTS[effect].observable_as
        if isinstance(observable_as, Average):
            for number in observable_as.spreads.keys() & {k for k, v in numbers.items() if v > 0}:
                for column in known:
                    if column.rpartition("_")[0] in observable_as.spreads[number]:
                        yield column, float(np.sqrt(numbers[number]))


def _lost(
    setpoints: Array, phases: Sequence[str], body: Component, states: Array, plant: Vehicle
) -> int:
    """Number of rows until the vehicle tumbles or strays from its setpoints."""
    column = [s.name for s in body.states].index
    off = states[:, [column(f"pos_{a}") for a in "xyz"]] - setpoints[:, :3]
    tilt = 2 * np.arcsin(np.hypot(states[:, column("q_x")], states[:, column("q_y")]).clip(0, 1))
    far = max(FARTHEST_M, FARTHEST_ARMS * plant.arm_m)
    near = (np.linalg.norm(off, axis=1) < far) & (tilt < STEEPEST_RAD)
    near |= np.array([phase == "ground" for phase in phases])
    return len(near) if near.all() else int(np.argmin(near))
