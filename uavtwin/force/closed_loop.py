"""Missions in random air, flown by exported twins: with a learned force, and without it.

A law that follows recorded flights may still make a controller lose a vehicle: in air and at speeds
that no flight of the training had. So what is to be shipped flies missions first.
"""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.slave import Slave
from learning.force.laws import LAWS
from learning.force.model import Checked, ForceModel, Output
from twin.errors import FmuError
from twin.flight.assembly import SENSED, gust_switches
from twin.flight.mission import mission_duration_s
from twin.frames import AXES
from twin.physics.residual_force import OUTPUTS
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
WIND_M_S = 2.0
"""Spread of the steady wind, north and east."""
START_M = 0.5
"""Spread of where a flight begins, north and east."""
LOST_M = 10.0
"""So far from where it should be, a vehicle is not flying its mission any more."""
ENABLED = "residual_force.enabled"
_SEEDED = ("environment", *SENSED)
"""Components that draw noise."""
_TRACKED = tuple(f"airframe.pos_{a}" for a in AXES) + tuple(
    f"mission.setpoint_pos_{a}" for a in AXES
)


@dataclass(frozen=True, slots=True)
class Tracked:
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
class Both:
    """The same mission in the same air.

    Attributes:
        learned: Flown with the learned force.
        alone: Flown without it.
    """

    learned: Tracked
    alone: Tracked

    @property
    def lost(self) -> bool:
        """Whether the learned force lost it: without, it is flown."""
        return self.learned.lost and not self.alone.lost


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
) -> list[Both]:
    """Fly a mission in every air, with a learned force and without it, by one exported FMU.

    Args:
        vehicle: Whose twin.
        force: Learned for it.
        mission: Name of the mission.
        airs: Start values of each flight.
    """
    with tempfile.TemporaryDirectory() as place:
        fmu = Path(place, "twin.fmu")
        export(twin(vehicle, mission, force=force), fmu)
        duration_s = mission_duration_s(mission)
        return [
            Both(_tracked(fmu, duration_s, air), _tracked(fmu, duration_s, {**air, ENABLED: 0.0}))
            for air in airs
        ]


def flown(fmu: Path, duration_s: float, starts: Mapping[str, float], reads: Sequence[str]) -> Array:
    """Fly a mission in steps of `STEP_S`.

    Args:
        fmu: Of a twin that flies by itself.
        duration_s: How long.
        starts: Start values.
        reads: Outputs that are kept.

    Returns:
        Outputs at the end of each step, infinite after the twin has stopped, shape
        (n, len(reads)).
    """
    found = np.full((round(duration_s / STEP_S), len(reads)), np.inf)
    slave = Slave("twin", fmu)
    try:
        slave.bind([], reads, np.zeros(0), np.zeros(len(reads)))
        slave.initialize(0.0, starts)
        slave.finish_initialization()
        for k in range(len(found)):
            slave.step(k * STEP_S, STEP_S)
            slave.read_outputs()
            found[k] = slave.outputs
    except FmuError:  # it stopped: what is left of the flight stays infinitely far
        pass
    finally:
        slave.close()
    return found


def _tracked(fmu: Path, duration_s: float, starts: Mapping[str, float]) -> Tracked:
    found = flown(fmu, duration_s, starts, (*_TRACKED, DISTANCE))
    inside = float(np.mean(found[:, 6] <= 1))
    if not np.isfinite(found).all():
        return Tracked(float("inf"), float("inf"), inside)
    away = np.linalg.norm(found[:, :3] - found[:, 3:6], axis=1)
    return Tracked(float(np.sqrt(np.mean(away**2))), float(away.max()), inside)


def kept(
    chosen: ForceModel,
    model: Callable[[Sequence[str]], ForceModel],
    vehicle: Vehicle,
    memory: Memory,
    progress: Callable[[float], None],
) -> ForceModel:
    """The learned force with which no mission is lost that is flown without it.

    One after the other is withdrawn until that is so, first the law by which flights left out gain
    least.

    Args:
        chosen: As flights have chosen it.
        model: The same of these laws.
        vehicle: Whose twin.
        memory: Of the steps that were taken before.
        progress: Called with the share done.
    """
    airs = random_air(FLIGHTS, chosen.seed)
    missions = [(m, airs[i :: len(MISSIONS)]) for i, m in enumerate(MISSIONS)]
    withdrawn: list[str] = []
    lost: list[int] = []
    left, most = chosen, len(_used(chosen))
    while _used(left):
        force = LearnedForce(left)

        def flown(mission: str, own: Sequence[Mapping[str, float]], force: LearnedForce) -> Array:
            """Whether the law loses each flight of a mission, shape (flights,)."""
            return np.array([b.lost for b in fly_both(vehicle, force, mission, own)], dtype=float)

        where = f"without {withdrawn}"
        losses = [
            memory.array(f"mission {m} {where}", partial(flown, m, own, force))
            for m, own in missions
        ]
        lost.append(int(sum(np.sum(one) for one in losses)))
        progress(len(lost) / (most + 1))
        if not lost[-1]:
            break
        laws, name = _without_weakest(left.outputs)
        withdrawn.append(name)
        left = model(laws)
    flights = len(airs) if lost else 0
    return replace(left, closed_loop=Checked(flights, sum(lost[:1]), tuple(withdrawn)))


def _used(model: ForceModel) -> list[str]:
    """Laws that a model uses."""
    return [o.law for o in model.outputs if o.law != LAWS[0]]


def _without_weakest(outputs: Sequence[Output]) -> tuple[list[str], str]:
    """Laws with one less, and the name of what went."""
    laws = [o.law for o in outputs]
    used = [i for i, law in enumerate(laws) if law != LAWS[0]]
    i = max(used, key=lambda i: _weakness(outputs[i]))
    kind, axis = OUTPUTS[i]
    name = f"{kind} {axis} {laws[i]}"
    laws[i] = LAWS[0]
    return laws, name


def _weakness(output: Output) -> tuple[float, float]:
    """Larger of a law that does less on flights left out."""
    flown = next(f for f in output.tried if f.law == output.law)
    return (1.0 if flown.ratio is None else flown.ratio, -flown.gain)
