"""The gap between a flight and its twin: teacher-forced and short-horizon residuals.

Short-horizon: replay FMU, airframe FMU and IMU FMU stepped by the master, the airframe restarted
from the measured state every horizon through its start values.
"""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.master import Master
from cosim.system import System, connect
from fmus import build, component_model, replay_model
from twin.errors import LogError
from twin.frames import rotation_vector
from twin.logs import Flight
from twin.physics.airframe import AXES
from twin.residuals.aligned import AlignedFlight, align_flight
from twin.residuals.gap import Channel, FlightGap
from twin.residuals.teacher_forced import (
    GRID_S,
    as_driven,
    predicted_readings,
    teacher_forced_channels,
)
from twin.vehicle import Vehicle

Array = NDArray[np.float64]
DEFAULT_HORIZON_S = 0.5
_POSE = tuple(f"{s}_{a}" for s in ("pos", "vel") for a in AXES) + tuple(f"q_{a}" for a in "wxyz")
_RATES = tuple(f"omega_{a}" for a in AXES)


def flight_gap(
    flight: Flight,
    vehicle: Vehicle,
    horizon_s: float = DEFAULT_HORIZON_S,
    progress: Callable[[float], None] | None = None,
) -> FlightGap:
    """Residuals of one flight against one vehicle.

    Args:
        flight: As read by `twin.logs.read_flight`.
        vehicle: As read by `twin.vehicle.load_vehicle`.
        horizon_s: Short horizon; a multiple of 1 ms, at least 10 ms.
        progress: Called with the share done, 0..1.

    Raises:
        LogError: The flight cannot be compared with this vehicle.
    """
    if not 0.01 <= horizon_s < np.inf or abs(horizon_s / GRID_S - round(horizon_s / GRID_S)) > 1e-6:
        raise LogError(f"horizon {horizon_s:g} s: needs a multiple of 1 ms of at least 10 ms.")
    aligned = align_flight(flight, vehicle)
    readings, names = predicted_readings(
        aligned.airframe, aligned.imu, aligned.states, aligned.inputs.u
    )
    channels = teacher_forced_channels(
        flight,
        aligned.motion,
        aligned.inputs.t_s,
        readings,
        names,
        aligned.airborne,
        aligned.phases,
    )
    short, notes = _short_horizon(flight, aligned, horizon_s, progress or (lambda _: None))
    notes += _wrong_vehicle(channels, vehicle)
    warnings = [f"{f.where}: {f.message}" for f in flight.findings if f.severity != "info"]
    return FlightGap(
        flight=flight.name,
        vehicle=vehicle.name,
        channels=tuple(channels + short),
        phases=_spans(aligned.inputs.t_s, aligned.phases),
        warnings=tuple([*aligned.notes, *notes, *warnings]),
        facts=dict(flight.facts),
    )


def _wrong_vehicle(channels: Sequence[Channel], vehicle: Vehicle) -> list[str]:
    """A doubt where the rotors carry a weight of quite another size than the flight shows."""
    for channel in (c for c in channels if c.name == "acc_z"):
        ratio = float(channel.measured.mean() / channel.simulated.mean())
        if not 0.5 <= ratio <= 2.0:
            return [
                f"in flight the measured acc_z is on average {ratio:.2g} times that of the twin: "
                f"is {vehicle.name} the right vehicle file?"
            ]
    return []


# -- short horizon --------------------------------------------------------------------------


def _short_horizon(
    flight: Flight, aligned: AlignedFlight, horizon_s: float, progress: Callable[[float], None]
) -> tuple[list[Channel], list[str]]:
    """Restart, step through the FMUs, compare at the end of each window."""
    motion = aligned.motion
    if motion.attitude is None or motion.velocity is None or motion.rates is None:
        return [], ["no short-horizon residuals: they need attitude, velocity and body rates"]
    steps = round(horizon_s / GRID_S)
    starts = [k for k in _windows(aligned, steps)]
    if not starts:
        return [], [f"no stretch of {horizon_s:g} s of measured flight for short-horizon residuals"]
    ends = np.array([k + steps for k in starts])
    predicted = np.empty((len(starts), len(_POSE) + 3))
    with (
        tempfile.TemporaryDirectory(prefix="uavtwin-") as folder,
        _open(flight, aligned, Path(folder)) as master,
    ):
        for row, k in enumerate(starts):
            begin = aligned.inputs.t_s[k]
            master.initialize(begin, start_values(aligned, k))
            recording = master.run(begin + horizon_s, GRID_S, "settled", every=steps)
            predicted[row] = recording.values[-1]
            progress((row + 1) / len(starts))
    return _end_channels(aligned, ends, predicted, horizon_s), []


def _open(flight: Flight, aligned: AlignedFlight, folder: Path) -> Master:
    """Replay, airframe and IMU as FMUs behind the master."""
    driven = as_driven(flight, aligned.airframe, aligned.inputs)
    fmus = {
        "replay": build(replay_model(driven, aligned.inputs.columns), folder / "replay.fmu"),
        "airframe": build(component_model(aligned.airframe), folder / "airframe.fmu"),
        "imu": build(component_model(aligned.imu), folder / "imu.fmu"),
    }
    system = System(
        fmus,
        connect("replay", "airframe", aligned.inputs.columns)
        + connect("airframe", "imu", aligned.imu.input_names),
        starts={"airframe.ground.enabled": 0.0},
    )
    return Master(system, record=[f"airframe.{n}" for n in _POSE] + [f"imu.gyro_{a}" for a in AXES])


def start_values(aligned: AlignedFlight, k: int) -> dict[str, float]:
    """Start values of the airframe FMU for the state at grid point k.

    Some count from where the airframe would start by itself, such as a load from its place at rest:
    by what it starts too far off when given the state itself, the start value is too large.
    """
    body, wanted = aligned.airframe, aligned.states[k]
    names = [f"initial.{s.name}" for s in body.states]
    settable = {v.name for v in body.parameters}
    given = {n: float(x) for n, x in zip(names, wanted, strict=True) if n in settable}
    reached = body.initial(aligned.inputs.u[k], body.parameter_values(given))
    beyond = dict(zip(names, np.asarray(reached, dtype=np.float64).ravel() - wanted, strict=True))
    return {f"airframe.{n}": x - float(beyond[n]) for n, x in given.items()}


def _windows(aligned: AlignedFlight, steps: int) -> Iterator[int]:
    """Grid points at which a window starts: airborne and measured from start to end."""
    known = aligned.airborne & np.all(np.isfinite(aligned.states), axis=1)
    unknown_before = np.concatenate([[0], np.cumsum(~known)])
    k = int(np.argmax(known))
    while k + steps < len(known):
        if unknown_before[k + steps + 1] == unknown_before[k]:
            yield k
            k += steps
        else:
            k += 1


def _end_channels(
    aligned: AlignedFlight, ends: NDArray[np.intp], predicted: Array, horizon_s: float
) -> list[Channel]:
    names = [s.name for s in aligned.airframe.states]
    t, phase = aligned.inputs.t_s[ends], aligned.phases[ends]

    def state(group: tuple[str, ...]) -> Array:
        columns = np.array([names.index(n) for n in group], dtype=np.intp)
        return aligned.states[np.ix_(ends, columns)]

    measured, channels = state(_POSE), []
    for i, name in enumerate(_POSE[:6]):
        if name.startswith("pos") and aligned.motion.position is None:
            continue
        unit = "m" if name.startswith("pos") else "m/s"
        channels.append(Channel(name, unit, horizon_s, t, measured[:, i], predicted[:, i], phase))
    # Attitude relative to the level attitude of the same heading, in body axes.
    level = np.zeros((len(ends), 4))
    level[:, 0] = 1.0
    q_measured, q_twin = measured[:, 6:], predicted[:, 6:10]
    residual = rotation_vector(q_measured, q_twin)
    reading = rotation_vector(q_measured, level)
    for i, axis in enumerate(AXES):
        channels.append(
            Channel(
                f"att_{axis}",
                "rad",
                horizon_s,
                t,
                reading[:, i],
                reading[:, i] - residual[:, i],
                phase,
            )
        )
    rates = state(_RATES)
    for i, axis in enumerate(AXES):
        channels.append(
            Channel(f"gyro_{axis}", "rad/s", horizon_s, t, rates[:, i], predicted[:, 10 + i], phase)
        )
    return channels


def _spans(t_s: Array, phases: NDArray[np.str_]) -> tuple[tuple[str, float, float], ...]:
    changes = np.flatnonzero(phases[1:] != phases[:-1]) + 1
    edges = [0, *changes.tolist(), len(t_s) - 1]
    return tuple(
        (str(phases[a]), float(t_s[a]), float(t_s[b])) for a, b in pairwise(edges) if phases[a]
    )
