"""Does a vehicle with added effects still fly? Every mission, closed loop, with its controller."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import TwinError
from ..vehicle import Vehicle
from .closed_loop import ClosedLoop
from .mission import mission_names

STEEPEST_RAD = np.radians(75.0)
FARTHEST_ARMS, FARTHEST_M = 10.0, 0.5
"""Off the setpoint by more than so many rotor arms, and so many metres, is lost."""


@dataclass(frozen=True, slots=True)
class Mission:
    """A mission flown in closed loop.

    Attributes:
        name: Of the mission.
        stable: Whether it was flown to its end, upright and near its setpoints.
        worst_m: Largest distance from the setpoint; NaN where it could not be flown.
        problem: Why it is not stable; "" where it is.
    """

    name: str
    stable: bool
    worst_m: float
    problem: str


def fly_missions(
    vehicle: Vehicle,
    names: Sequence[str] | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[Mission, ...]:
    """Fly missions with the controller that the vehicle's own numbers give.

    Args:
        vehicle: With its effects.
        names: Of the missions; default: all.
        progress: Called with the share done.
    """
    names = list(mission_names() if names is None else names)
    try:
        loop = ClosedLoop(vehicle)
    except TwinError as error:
        return tuple(Mission(name, False, float("nan"), str(error)) for name in names)
    flown = []
    for i, name in enumerate(names):
        flown.append(_fly(vehicle, loop, name))
        progress((i + 1) / len(names))
    return tuple(flown)


def _fly(vehicle: Vehicle, loop: ClosedLoop, name: str) -> Mission:
    try:
        flight = loop.fly(name)
    except TwinError as error:
        return Mission(name, False, float("nan"), str(error))
    if not np.all(np.isfinite(flight.states)):
        return Mission(name, False, float("nan"), "the simulation diverges")
    worst, tilt = float(flight.miss_m.max()), float(flight.tilt_rad.max())
    problem = lost(worst, tilt, vehicle.arm_m)
    return Mission(name, not problem, worst, problem)


def lost(miss_m: float, tilt_rad: float, arm_m: float) -> str:
    """Why a flight counts as lost; "" where it does not.

    Args:
        miss_m: Largest distance from the setpoint.
        tilt_rad: Largest tilt.
        arm_m: From the centre to a rotor.
    """
    farthest_m, problems = max(FARTHEST_M, FARTHEST_ARMS * arm_m), []
    if not tilt_rad <= STEEPEST_RAD:
        problems.append(f"tilts to {np.degrees(tilt_rad):.0f} degrees")
    if not miss_m <= farthest_m:
        problems.append(f"{miss_m:.2f} m from the setpoint, more than {farthest_m:.2f} m")
    return "; ".join(problems)
