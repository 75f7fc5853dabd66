"""Twins that fly by themselves, exported: missions in random air, and hovers.

A law that follows recorded flights may still make a controller lose a vehicle: in air and at speeds
that no flight of the training had. So what is to be shipped flies missions first.

In closed loop the controller makes up for what is wrong, and what shows is what it takes: another
command, another unrest. The air of a room moves, that of the mission of the hovers does not: there
a twin is the quieter one.
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
from learning.force.windows import true_motion
from twin.errors import FmuError
from twin.flight.assembly import SENSED, gust_switches
from twin.flight.mission import PHASES, mission_duration_s
from twin.frames import AXES, to_ned
from twin.logs import Flight
from twin.logs.columns import motor_columns
from twin.physics.residual_force import parameter_values
from twin.residuals.aligned import AlignedFlight, align_flight
from twin.residuals.measured import Signal
from twin.residuals.teacher_forced import GRID_S, RIGID
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


HOVER = "hover"
"""Phase and mission."""
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
    hovers = [m for m in hover_rows(aligned) if np.isfinite(motion[m]).all()]
    if not hovers:
        return None
    rows = np.concatenate(hovers)
    command = np.full((len(rows), 1), np.nan)
    columns = motor_columns("cmd", vehicle.rotors.count)
    if set(columns) <= set(aligned.inputs.columns):
        command = Signal(*flight.signal(list(columns))).held(aligned.inputs.t_s)[rows]
    return _steadiness(motion[rows], command, GRID_S * len(rows))


def hover_rows(aligned: AlignedFlight) -> list[NDArray[np.intp]]:
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
