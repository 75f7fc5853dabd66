"""The gap between a flight and its twin: teacher-forced and short-horizon residuals.

Teacher-forced: the twin's equations at the measured state, see `imu`. Short horizon: the twin
restarted from the measured state every horizon, compared at the end of each window.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..errors import LogError
from ..frames import AXES, rotation_vector
from ..logs import Flight
from ..logs.columns import GYRO, POS, QUAT, VEL
from ..vehicle import Vehicle
from .aligned import AlignedFlight, align_flight
from .channels import GRID_HZ
from .gap import Channel, FlightGap
from .imu import imu_channels
from .means import HoverMeans, hover_means
from .short_horizon import READ, whole_windows, window_ends
from .teacher_forced import GRID_S

Array = NDArray[np.float64]
DEFAULT_HORIZON_S = 0.5
LIKELY_WEIGHT = (0.5, 2.0)
"""Measured over predicted specific force along the thrust, beyond which the vehicle is doubted."""


def flight_gap(
    flight: Flight,
    vehicle: Vehicle,
    horizon_s: float = DEFAULT_HORIZON_S,
    progress: Callable[[float], None] = lambda _: None,
) -> FlightGap:
    """Residuals of one flight against one vehicle.

    Args:
        flight: As read by `twin.logs.read_flight`.
        vehicle: As read by `twin.vehicle.file.load_vehicle`.
        horizon_s: Short horizon; a multiple of 1 ms, at least 10 ms.
        progress: Called with the share done, 0..1.

    Raises:
        LogError: The flight cannot be compared with this vehicle.
    """
    if not 0.01 <= horizon_s < np.inf or abs(horizon_s / GRID_S - round(horizon_s / GRID_S)) > 1e-6:
        raise LogError(f"horizon {horizon_s:g} s: needs a multiple of 1 ms of at least 10 ms.")
    # the coarse grid first, and gone before the fine one is there: both together need more memory
    channels = imu_channels(flight, vehicle, align_flight(flight, vehicle, 1 / GRID_HZ))
    progress(0.2)
    aligned = align_flight(flight, vehicle)
    progress(0.5)
    short, notes = _short_horizon(aligned, horizon_s, lambda done: progress(0.5 + 0.5 * done))
    notes += _wrong_vehicle(channels, vehicle)
    warnings = [f"{f.where}: {f.message}" for f in flight.findings if f.severity != "info"]
    progress(1.0)
    return FlightGap(
        flight=flight.name,
        vehicle=vehicle.name,
        channels=tuple(channels + short),
        phases=_spans(aligned.inputs.t_s, aligned.phases),
        warnings=tuple([*aligned.notes, *notes, *warnings]),
        facts=dict(flight.facts),
        means=hover_means(channels, vehicle),
    )


def means_of(flight: Flight, vehicle: Vehicle) -> HoverMeans | None:
    """What a hover says of a twin, without all else of the gap.

    Raises:
        LogError: The flight cannot be compared with this vehicle.
    """
    aligned = align_flight(flight, vehicle, 1 / GRID_HZ)
    return hover_means(imu_channels(flight, vehicle, aligned), vehicle)


def _wrong_vehicle(channels: Sequence[Channel], vehicle: Vehicle) -> list[str]:
    """A doubt where the rotors carry a weight of quite another size than the flight shows."""
    for channel in (c for c in channels if c.name == "acc_z"):
        ratio = float(channel.measured.mean() / channel.simulated.mean())
        if not LIKELY_WEIGHT[0] <= ratio <= LIKELY_WEIGHT[1]:
            return [
                f"in flight the measured acc_z is on average {ratio:.2g} times that of the twin: "
                f"is {vehicle.name} the right vehicle file?"
            ]
    return []


def _short_horizon(
    aligned: AlignedFlight, horizon_s: float, progress: Callable[[float], None]
) -> tuple[list[Channel], list[str]]:
    """Channels at the ends of all windows, or why there are none."""
    motion = aligned.motion
    if motion.attitude is None or motion.velocity is None or motion.rates is None:
        return [], ["no short-horizon residuals: they need attitude, velocity and body rates"]
    steps = round(horizon_s / GRID_S)
    starts = whole_windows(aligned, steps)
    if not len(starts):
        return [], [f"no stretch of {horizon_s:g} s of measured flight for short-horizon residuals"]
    predicted = window_ends(aligned, starts, steps, tail=0, progress=progress)[:, 0]
    return end_channels(aligned, starts + steps, predicted, horizon_s), []


def end_channels(
    aligned: AlignedFlight, ends: NDArray[np.intp], predicted: Array, horizon_s: float
) -> list[Channel]:
    """Channels of the short horizon: position, velocity, attitude and gyroscope.

    Attitude is compared relative to the level attitude that points north, in body axes.

    Args:
        aligned: The flight on the grid of its twin.
        ends: Grid points at which the windows end, shape (w,).
        predicted: `short_horizon.READ` of the twin there, shape (w, 13).
        horizon_s: Length of the windows.
    """
    t, phase = aligned.inputs.t_s[ends], aligned.phases[ends]
    states = [s.name for s in aligned.airframe.states]

    def measured(names: Sequence[str]) -> Array:
        columns = np.array([states.index(n) for n in names], dtype=np.intp)
        return aligned.states[np.ix_(ends, columns)]

    def simulated(names: Sequence[str]) -> Array:
        return predicted[:, [READ.index(n) for n in names]]

    level = np.zeros((len(ends), 4))
    level[:, 0] = 1.0
    attitude = rotation_vector(measured(QUAT), level)
    turned = rotation_vector(measured(QUAT), simulated(QUAT))
    groups = [
        (VEL, "m/s", measured(VEL), simulated(VEL)),
        (tuple(f"att_{a}" for a in AXES), "rad", attitude, attitude - turned),
        (GYRO, "rad/s", measured([f"omega_{a}" for a in AXES]), simulated(GYRO)),
    ]
    if aligned.motion.position is not None:
        groups.insert(0, (POS, "m", measured(POS), simulated(POS)))
    return [
        Channel(name, unit, horizon_s, t, flown[:, i], twin[:, i], phase)
        for names, unit, flown, twin in groups
        for i, name in enumerate(names)
    ]


def _spans(t_s: Array, phases: NDArray[np.str_]) -> tuple[tuple[str, float, float], ...]:
    """Name, first and last time of each phase."""
    changes = np.flatnonzero(phases[1:] != phases[:-1]) + 1
    edges = [0, *changes.tolist(), len(t_s) - 1]
    return tuple(
        (str(phases[a]), float(t_s[a]), float(t_s[b])) for a, b in pairwise(edges) if phases[a]
    )
