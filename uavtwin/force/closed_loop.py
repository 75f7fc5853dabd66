"""Closed-loop tests of a learned force: exported twins fly missions in random wind.

A law that fits recorded flights may still make a controller lose the vehicle, in wind and at speeds
that no training flight had. A law is therefore tested on missions before it is released.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.slave import Slave
from learning.force.model import ForceModel, MissionCheck
from twin.errors import FmuError, ModelError
from twin.flight.assembly import CONTROLLERS, SENSED, gust_switches
from twin.flight.mission import mission_duration_s
from twin.frames import AXES
from twin.physics.residual_force import parameter_values
from twin.vehicle import Vehicle

from ..exports.parts import LearnedForce, twin
from ..exports.write import temporary_fmu
from .memory import Memory
from .open_loop import DISTANCE

Array = NDArray[np.float64]
MISSIONS = ("hover", "forward", "tour")
"""Missions that a law must fly."""
FLIGHTS = 36
"""Number of flights of all missions together, which take turns."""
STEP_S = 0.01
"""Communication step, s."""
WIND_M_S = 2.0
"""Standard deviation of the steady wind, north and east, m/s."""
START_M = 0.5
"""Standard deviation of the start position, north and east, m."""
LOST_M = 10.0
"""Distance from the setpoint, m, beyond which the mission counts as lost."""
REST, REST_S = 0.25, 10.0
"""Largest allowed distance from the training envelope at the end of a hover in still air, and
duration of that end, s. A twin that oscillates reaches the distance at which its law fades, 1.01 to
2.8; a limit of 0.5 accepted a twin that rotated more than the aircraft; stable twins stay below 0.2
(RflySimDT)."""
TRIED = 4
"""Maximum number of laws that fly missions; each takes a minute. Not chosen on flights."""
HOVER = "hover"
"""Name of the phase and of the mission."""
ENABLED = "residual_force.enabled"
"""Parameter of the fused FMU that enables the law."""
_SEEDED = ("environment", *SENSED)
"""Components with random noise."""
_TRACKED = tuple(f"airframe.pos_{a}" for a in AXES) + tuple(
    f"mission.setpoint_pos_{a}" for a in AXES
)  # actual position and setpoint, NED, m


@dataclass(frozen=True, slots=True)
class MissionTrack:
    """Tracking of one mission.

    Attributes:
        off_m: Rms distance from the setpoint, m; infinite where the twin stopped.
        farthest_m: Largest distance from the setpoint, m.
        inside: Share of the time inside the training envelope.
    """

    off_m: float
    farthest_m: float
    inside: float

    @property
    def lost(self) -> bool:
        """Whether the vehicle was ever farther than `LOST_M` from its setpoint."""
        return not self.farthest_m < LOST_M


@dataclass(frozen=True, slots=True)
class MissionPair:
    """The same mission in the same wind with and without the learned force.

    Attributes:
        learned: Tracking with the learned force.
        alone: Tracking without it.
    """

    learned: MissionTrack
    alone: MissionTrack

    @property
    def lost(self) -> bool:
        """Whether the learned force lost the vehicle: without it the mission is flown, and closer
        by `LOST_M`.

        A mission that is almost lost without the law is no evidence against the law.
        """
        farther = self.learned.farthest_m - self.alone.farthest_m
        return not self.alone.lost and farther >= LOST_M


def random_air(count: int, seed: int, wind_m_s: float = WIND_M_S) -> list[dict[str, float]]:
    """Random start values of a fused FMU: steady wind, gusts, noise, position and heading.

    Args:
        count: Number of flights.
        seed: Random seed of all of them.
        wind_m_s: Standard deviation of the steady wind, north and east, m/s; 0: still air without
            gusts.
    """
    rng = np.random.default_rng(seed)
    return [_air(rng, wind_m_s) for _ in range(count)]


def _air(rng: np.random.Generator, wind_m_s: float) -> dict[str, float]:
    wind, place = rng.normal(0, 1, 2) * wind_m_s, rng.normal(0, START_M, 2)
    half = rng.uniform(-np.pi, np.pi) / 2
    return {
        **{f"{part}.seed": float(rng.integers(2**31)) for part in _SEEDED},
        "environment.wind.x": float(wind[0]),
        "environment.wind.y": float(wind[1]),
        **gust_switches(wind_m_s > 0),
        "airframe.initial.pos_x": float(place[0]),
        "airframe.initial.pos_y": float(place[1]),
        "airframe.initial.q_w": float(np.cos(half)),
        "airframe.initial.q_z": float(np.sin(half)),
    }


def fly_both(
    vehicle: Vehicle, force: LearnedForce, mission: str, airs: Sequence[Mapping[str, float]]
) -> list[MissionPair]:
    """Fly a mission in every wind, with a learned force and without it, by one exported FMU.

    Args:
        vehicle: Vehicle of the twin.
        force: Force law learned for it.
        mission: Name of the mission.
        airs: Start values of each flight, as of `random_air`.
    """
    with temporary_fmu(twin(vehicle, mission, force=force)) as fmu:
        tracked = partial(_tracked, fmu, mission_duration_s(mission))
        return [MissionPair(tracked(air), tracked({**air, ENABLED: 0.0})) for air in airs]


def flown(
    fmu: Path,
    duration_s: float,
    starts: Mapping[str, float],
    reads: Sequence[str],
    step_s: float = STEP_S,
) -> Array:
    """Simulate a mission.

    Args:
        fmu: FMU of a twin with its controller and mission.
        duration_s: Simulated time, s.
        starts: Start values, by name of the parameter.
        reads: Names of the outputs that are returned.
        step_s: Communication step, s.

    Returns:
        Outputs at the end of each step, shape (n, len(reads)); infinite after the twin has stopped.
    """
    found = np.full((round(duration_s / step_s), len(reads)), np.inf)
    slave = Slave("twin", fmu)
    with closing(slave), suppress(FmuError):  # where the twin stops, rows stay infinite
        slave.begin([], reads, starts)
        for k in range(len(found)):
            found[k] = slave.advance(np.zeros(0), k * step_s, step_s)
    return found


def _tracked(fmu: Path, duration_s: float, starts: Mapping[str, float]) -> MissionTrack:
    found = flown(fmu, duration_s, starts, (*_TRACKED, DISTANCE))
    inside = float(np.mean(found[:, 6] <= 1))
    if not np.isfinite(found).all():
        return MissionTrack(float("inf"), float("inf"), inside)
    away = np.linalg.norm(found[:, :3] - found[:, 3:6], axis=1)
    return MissionTrack(float(np.sqrt(np.mean(away**2))), float(away.max()), inside)


def uncontrollable(vehicle: Vehicle) -> str:
    """Why no controller can be designed for a vehicle, so that its twin flies no mission; empty:
    one can."""
    try:
        CONTROLLERS["lqr"](vehicle)
    except ModelError as error:
        return str(error)
    return ""


def lost_by(
    vehicle: Vehicle, force: LearnedForce, mission: str, airs: Sequence[Mapping[str, float]]
) -> Array:
    """Whether a law loses a mission that is flown without it, in each wind, shape (airs,).

    Args:
        vehicle: Vehicle of the twin.
        force: Force law learned for it.
        mission: Name of the mission.
        airs: Start values of each flight, as of `random_air`.
    """
    lost = [pair.lost for pair in fly_both(vehicle, force, mission, airs)]
    return np.array(lost, dtype=np.float64)


def at_rest(vehicle: Vehicle, laws: Sequence[ForceModel]) -> Array:
    """Whether the twin settles in a hover in still air, with each law, shape (laws,).

    True for all laws where the twin does not settle without a law.

    Args:
        vehicle: Vehicle of the twin.
        laws: Laws with the same envelope.
    """
    empty = {name: 0.0 for name in parameter_values(laws[0].law)}
    with temporary_fmu(twin(vehicle, HOVER, force=LearnedForce(laws[0]))) as fmu:

        def rests(values: Mapping[str, float]) -> bool:
            """Whether the twin settles with these parameters of the law."""
            starts = {f"residual_force.{name}": value for name, value in values.items()}
            found = flown(fmu, mission_duration_s(HOVER), starts, (DISTANCE,))
            return bool((found[-round(REST_S / STEP_S) :] < REST).all())

        if not rests(empty):
            return np.ones(len(laws))
        return np.array([rests(parameter_values(m.law)) for m in laws], dtype=np.float64)


def flyable(
    laws: Sequence[ForceModel],
    nothing: ForceModel,
    vehicle: Vehicle,
    memory: Memory,
    progress: Callable[[float], None],
) -> ForceModel:
    """The first law that settles in a hover and loses no mission that is flown without it.

    The best on the flights where no controller can be designed for the vehicle.

    Args:
        laws: Laws with the same envelope, the best on the flights first.
        nothing: Law without effect, returned where each of them loses a mission.
        vehicle: Vehicle of the twin.
        memory: Results of steps that were done before.
        progress: Called with the share done, 0..1.
    """
    if problem := uncontrollable(vehicle):
        return replace(laws[0], closed_loop=MissionCheck(problem=problem))
    airs = random_air(FLIGHTS, nothing.seed)
    missions = [(m, airs[i :: len(MISSIONS)]) for i, m in enumerate(MISSIONS)]
    rests = memory.array("at rest", partial(at_rest, vehicle, laws))
    steady = [law for law, is_so in zip(laws, rests, strict=True) if is_so][:TRIED]
    left, lost = nothing, []
    for k, law in enumerate(steady):
        each = [
            memory.array(f"mission {m} {k}", partial(lost_by, vehicle, LearnedForce(law), m, own))
            for m, own in missions
        ]
        lost.append(int(sum(np.sum(one) for one in each)))
        progress((k + 1) / len(steady))
        if not lost[-1]:
            left = law
            break
    flights, first = (len(airs), lost[0]) if lost else (0, 0)
    unsteady = int(len(laws) - np.sum(rests))
    check = MissionCheck(flights, first, len([n for n in lost if n]), unsteady)
    return replace(left, closed_loop=check)
