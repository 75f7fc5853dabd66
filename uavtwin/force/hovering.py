"""How twins hover by themselves, beside how the aircraft did: exported FMUs in closed loop.

A replay says how far a twin is off on the aircraft's own commands. In closed loop its controller
makes up for what is wrong, and what shows is what it takes: another command, another unrest. The
air of a room moves, that of this mission does not: a twin is the quieter one.
"""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.flight.mission import PHASES, mission_duration_s
from twin.frames import AXES, to_ned
from twin.logs import Flight
from twin.logs.columns import motor_columns
from twin.residuals.aligned import AlignedFlight, align_flight
from twin.residuals.measured import Signal
from twin.residuals.teacher_forced import GRID_S, RIGID
from twin.vehicle import Vehicle

from ..driving import true_motion
from ..exports.parts import LearnedForce, twin
from ..exports.write import export
from .closed_loop import STEP_S, flown

Array = NDArray[np.float64]
HOVER = "hover"
SETTLED_S = 1.0
"""At either end of a hover that is not looked at. Not chosen on flights."""
SHORTEST_S = 3.0
"""A hover that is left by it, to be told of."""


@dataclass(frozen=True, slots=True)
class Steadiness:
    """Of one hover.

    Attributes:
        seconds: How long it was.
        command: Mean motor command, 0..1; NaN where the rotors are not commanded so.
        velocity: Rms about its mean, m/s, three axes together.
        tilt: Of the direction of thrust about its mean, rad, two axes together.
        rates: Rms about their mean, rad/s, three axes together.
    """

    seconds: float
    command: float
    velocity: float
    tilt: float
    rates: float


def flown_hover(flight: Flight, vehicle: Vehicle) -> Steadiness | None:
    """How an aircraft hovered, all its hovers of which the whole motion is known; None without one.

    Args:
        flight: With phases.
        vehicle: Of its twin, on whose grid it is put.
    """
    aligned = align_flight(flight, vehicle)
    motion = true_motion(vehicle, aligned)
    hovers = [m for m in _hovers(aligned) if np.isfinite(motion[m]).all()]
    if not hovers:
        return None
    rows = np.concatenate(hovers)
    command = np.full((len(rows), 1), np.nan)
    columns = motor_columns("cmd", vehicle.rotors.count)
    if set(columns) <= set(aligned.inputs.columns):
        command = Signal(*flight.signal(list(columns))).held(aligned.inputs.t_s)[rows]
    return _steadiness(motion[rows], command, GRID_S * len(rows))


def _hovers(aligned: AlignedFlight) -> list[NDArray[np.intp]]:
    """Rows of each hover in the air, its ends left out."""
    there = (aligned.phases == HOVER) & aligned.airborne
    pieces = np.split(np.arange(len(there)), np.flatnonzero(np.diff(there)) + 1)
    settled = round(SETTLED_S / GRID_S)
    inner = [p[settled : len(p) - settled] for p in pieces if there[p[0]]]
    return [p for p in inner if len(p) >= SHORTEST_S / GRID_S]


def twin_hover(vehicle: Vehicle, force: LearnedForce | None) -> Steadiness | None:
    """How the fused FMU hovers in still air; None where it does not stay in the air.

    Args:
        vehicle: Whose twin.
        force: Learned for it; None: without.
    """
    columns = motor_columns("cmd", vehicle.rotors.count) if vehicle.drive == "command" else ()
    reads = (
        *(f"airframe.{s}" for s in RIGID),
        "mission.phase",
        *(f"controller.{c}" for c in columns),
    )
    with tempfile.TemporaryDirectory() as place:
        fmu = Path(place, "twin.fmu")
        export(twin(vehicle, HOVER, force=force), fmu)
        found = flown(fmu, mission_duration_s(HOVER), {}, reads)
    if not np.isfinite(found).all():
        return None
    rows = np.flatnonzero(np.round(found[:, len(RIGID)]) == PHASES[HOVER])
    settled = round(SETTLED_S / STEP_S)
    inner = found[rows[settled : len(rows) - settled]]
    command = inner[:, len(RIGID) + 1 :] if columns else np.full((len(inner), 1), np.nan)
    return _steadiness(inner[:, : len(RIGID)], command, STEP_S * len(inner))


def _steadiness(motion: Array, command: Array, seconds: float) -> Steadiness:
    """Of rows of `RIGID` and of commands."""

    def unrest(values: Array) -> float:
        """Rms about the mean, all columns together."""
        return float(np.sqrt(np.sum(np.var(values, axis=0))))

    q = [motion[:, RIGID.index(f"q_{a}")] for a in "wxyz"]
    up = np.zeros(len(motion))
    thrust = np.stack(to_ned(q, [up, up, up + 1]), axis=-1)
    vel, omega = (
        motion[:, [RIGID.index(f"{stem}_{a}") for a in AXES]] for stem in ("vel", "omega")
    )
    return Steadiness(
        seconds, float(command.mean()), unrest(vel), unrest(thrust[:, :2]), unrest(omega)
    )


def hovers(
    flights: Sequence[Flight], twins: Mapping[str, tuple[Vehicle, LearnedForce | None]]
) -> dict[str, Steadiness]:
    """How each flight and each twin hovered, by name; those that did not are left out.

    Args:
        flights: With phases.
        twins: Vehicle and learned force by name; the first vehicle is that of the flights' grid.
    """
    vehicle = next(iter(twins.values()))[0]
    every = {f.name: flown_hover(f, vehicle) for f in flights}
    if not any(every.values()):  # nothing to compare with
        return {}
    every |= {name: twin_hover(*both) for name, both in twins.items()}
    return {name: found for name, found in every.items() if found is not None}
