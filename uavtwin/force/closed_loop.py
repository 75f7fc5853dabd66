"""Twins that fly by themselves, exported: missions in random air.

A law that follows recorded flights may still make a controller lose a vehicle: in air and at speeds
that no flight of the training had. So what is to be shipped flies missions first.
"""

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.slave import Slave
from learning.force.model import ForceModel, MissionCheck
from twin.errors import FmuError
from twin.flight.assembly import SENSED, gust_switches
from twin.flight.mission import mission_duration_s
from twin.frames import AXES
from twin.physics.residual_force import parameter_values
from twin.vehicle import Vehicle

from ..exports.parts import LearnedForce, twin
from ..exports.write import export
from .memory import Memory
from .open_loop import DISTANCE

Array = NDArray[np.float64]
MISSIONS = ("hover", "forward", "tour")
"""That a law has to fly."""
FLIGHTS = 36
"""Of all missions together, in turn."""
STEP_S = 0.01
"""Communication step, s."""
WIND_M_S = 2.0
"""Spread of the steady wind, north and east."""
START_M = 0.5
"""Spread of where a flight begins, north and east."""
LOST_M = 10.0
"""So far from where it should be, a vehicle is not flying its mission any more."""
REST, REST_S = 0.25, 10.0
"""Distance from the training up to which a twin may come at the end of a hover in still air, and
how long that is, s. What swings freely does so up to where its law fades, 1.01 to 2.8; with 0.5 one
was let through that turned by more than the aircraft; others stay below 0.2 (RflySimDT)."""
TRIED = 4
"""Laws that may fly missions at most: each takes a minute. Not chosen on flights."""
HOVER = "hover"
"""Phase and mission."""
ENABLED = "residual_force.enabled"
"""Parameter that switches the law of a fused FMU."""
_SEEDED = ("environment", *SENSED)
"""Components that draw noise."""
_TRACKED = tuple(f"airframe.pos_{a}" for a in AXES) + tuple(
    f"mission.setpoint_pos_{a}" for a in AXES
)  # flown and wanted place, NED, m


@dataclass(frozen=True, slots=True)
class MissionTrack:
    """How a mission was flown.

    Attributes:
        off_m: Rms of the distance to where the mission wants the vehicle; infinite where the twin
            stopped.
        farthest_m: The largest.
        inside: Share of the time inside the envelope of the training.
    """

    off_m: float
    farthest_m: float
    inside: float

    @property
    def lost(self) -> bool:
        """Whether the vehicle was ever far from its mission."""
        return not self.farthest_m < LOST_M


@dataclass(frozen=True, slots=True)
class MissionPair:
    """The same mission in the same air.

    Attributes:
        learned: With the learned force.
        alone: Without it.
    """

    learned: MissionTrack
    alone: MissionTrack

    @property
    def lost(self) -> bool:
        """Whether the learned force lost it: without, it is flown, and nearer by `LOST_M`.

        What is all but lost without a law tells nothing of one.
        """
        farther = self.learned.farthest_m - self.alone.farthest_m
        return not self.alone.lost and farther >= LOST_M


def random_air(count: int, seed: int, wind_m_s: float = WIND_M_S) -> list[dict[str, float]]:
    """Start values of a fused FMU: steady wind, gusts, noise, place and heading.

    Args:
        count: How many.
        seed: Of all of them.
        wind_m_s: Spread of the steady wind, north and east; 0: still air, and no gusts.
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
    """Fly a mission in every air, with a learned force and without it, by one exported FMU.

    Args:
        vehicle: Whose twin.
        force: Learned for it.
        mission: Name of the mission.
        airs: Start values of each flight.
    """
    with _exported(vehicle, force, mission) as tracked:
        return [MissionPair(tracked(air), tracked({**air, ENABLED: 0.0})) for air in airs]


def flown(
    fmu: Path,
    duration_s: float,
    starts: Mapping[str, float],
    reads: Sequence[str],
    step_s: float = STEP_S,
) -> Array:
    """Fly a mission.

    Args:
        fmu: Of a twin that flies by itself.
        duration_s: How long.
        starts: Start values.
        reads: Outputs that are kept.
        step_s: Communication step.

    Returns:
        Outputs at the end of each step, infinite after the twin has stopped, shape
        (n, len(reads)).
    """
    found = np.full((round(duration_s / step_s), len(reads)), np.inf)
    slave = Slave("twin", fmu)
    try:
        slave.bind([], reads, np.zeros(0), np.zeros(len(reads)))
        slave.initialize(0.0, starts)
        slave.finish_initialization()
        for k in range(len(found)):
            slave.step(k * step_s, step_s)
            slave.read_outputs()
            found[k] = slave.outputs
    except FmuError:  # it stopped: what is left of the flight stays infinitely far
        pass
    finally:
        slave.close()
    return found


@contextmanager
def _exported(
    vehicle: Vehicle, force: LearnedForce, mission: str
) -> Iterator[Callable[[Mapping[str, float]], MissionTrack]]:
    """How an exported mission with a law goes under some start values."""
    with tempfile.TemporaryDirectory() as place:
        fmu = Path(place, "twin.fmu")
        export(twin(vehicle, mission, force=force), fmu)
        yield partial(_tracked, fmu, mission_duration_s(mission))


def _tracked(fmu: Path, duration_s: float, starts: Mapping[str, float]) -> MissionTrack:
    found = flown(fmu, duration_s, starts, (*_TRACKED, DISTANCE))
    inside = float(np.mean(found[:, 6] <= 1))
    if not np.isfinite(found).all():
        return MissionTrack(float("inf"), float("inf"), inside)
    away = np.linalg.norm(found[:, :3] - found[:, 3:6], axis=1)
    return MissionTrack(float(np.sqrt(np.mean(away**2))), float(away.max()), inside)


def lost_by(
    vehicle: Vehicle, force: LearnedForce, mission: str, airs: Sequence[Mapping[str, float]]
) -> Array:
    """Whether a law loses a mission that is flown without it, in every air, shape (airs,).

    Args:
        vehicle: Whose twin.
        force: Learned for it.
        mission: Name of the mission.
        airs: Start values of each flight.
    """
    lost = [pair.lost for pair in fly_both(vehicle, force, mission, airs)]
    return np.array(lost, dtype=np.float64)


def at_rest(vehicle: Vehicle, laws: Sequence[ForceModel]) -> Array:
    """Whether a twin comes to rest in a hover in still air, with each law, shape (laws,).

    Of one that does not without a law nothing can be said.

    Args:
        vehicle: Whose twin.
        laws: Of one envelope.
    """
    empty = {name: 0.0 for name in parameter_values(laws[0].law)}
    with tempfile.TemporaryDirectory() as place:
        fmu = Path(place, "twin.fmu")
        export(twin(vehicle, HOVER, force=LearnedForce(laws[0])), fmu)

        def rests(values: Mapping[str, float]) -> bool:
            """With these numbers of the law."""
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
    """The first law that rests in a hover and loses no mission that is flown without it.

    Args:
        laws: The one that flights have chosen first, then the next best; of one envelope.
        nothing: What is left where each of them loses some.
        vehicle: Whose twin.
        memory: Of the steps that were taken before.
        progress: Called with the share done.
    """
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
