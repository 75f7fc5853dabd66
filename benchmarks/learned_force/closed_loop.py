"""Laws in closed loop: missions in random air, on exported FMUs, each with its law and without."""

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.slave.slave import Slave
from learning.force.model import VEHICLE_FILE
from twin.flight.mission import mission_duration_s
from twin.frames import AXES
from uavtwin.exports.parts import LearnedForce, learned_force, twin
from uavtwin.exports.write import export
from uavtwin.force.evaluate import DISTANCE
from uavtwin.vehicles import load_vehicle

Array = NDArray[np.float64]
MISSIONS = ("hover", "forward", "tour")
STEP_S = 0.01
WIND_M_S = 2.0
"""Spread of the steady wind, north and east."""
LOST_M = 10.0
"""So far from where it should be, a vehicle is not flying its mission any more."""
TRACKED = tuple(f"airframe.pos_{a}" for a in AXES) + tuple(
    f"mission.setpoint_pos_{a}" for a in AXES
)
SEEDED = ("environment", "imu", "magnetometer", "barometer", "position")


@dataclass(frozen=True, slots=True)
class Flown:
    """One flight.

    Attributes:
        off_m: Rms of the distance to where the mission wants it.
        farthest_m: The largest; infinite where a number is none.
        inside: Share of the time inside the envelope of the training.
    """

    off_m: float
    farthest_m: float
    inside: float

    @property
    def stable(self) -> bool:
        """Whether it was never lost."""
        return self.farthest_m < LOST_M


def closed_loop(folder: Path, count: int, seed: int) -> list[dict[str, Any]]:
    """Fly each law that was tried, shipped or not, and the twin without it, through the same air.

    Args:
        folder: That `train --protocol force` wrote.
        count: Flights of each law.
        seed: Of missions, air, noise and where they begin.

    Returns:
        Per flight and law `mission`, `law`, `stable`, `off_m` with it and `alone_m` without, and
        the share of the time `inside` the envelope.
    """
    force, vehicle = learned_force(folder), load_vehicle(folder / VEHICLE_FILE)
    outputs = tuple(replace(o, network=False) for o in force.model.outputs)
    laws = {
        name: LearnedForce(replace(force.model, law=rival.law, outputs=outputs))
        for name, rival in force.model.rivals.items()
        if rival.law.linear.any() or rival.law.waves.any()
    }
    rows = []
    flights = list(_draws(count, seed))
    with tempfile.TemporaryDirectory() as place:
        for name, law in laws.items():
            for mission in MISSIONS:
                starts = [s for m, s in flights if m == mission]
                if not starts:
                    continue
                fmu = Path(place, f"{name}_{mission}.fmu")
                export(twin(vehicle, mission, force=law), fmu)
                for start in starts:
                    with_law = _flown(fmu, mission, start)
                    alone = _flown(fmu, mission, {**start, "residual_force.enabled": 0.0})
                    rows.append(
                        {
                            "mission": mission,
                            "law": name,
                            "stable": with_law.stable or not alone.stable,
                            "off_m": with_law.off_m,
                            "alone_m": alone.off_m,
                            "inside": with_law.inside,
                        }
                    )
    return rows


def _draws(count: int, seed: int) -> Iterator[tuple[str, dict[str, float]]]:
    """Missions and start values."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        mission = str(rng.choice(MISSIONS))
        wind, place = rng.normal(0, WIND_M_S, 2), rng.normal(0, 0.5, 2)
        half = rng.uniform(-np.pi, np.pi) / 2
        starts = {f"{part}.seed": float(rng.integers(2**31)) for part in SEEDED}
        yield (
            mission,
            starts
            | {
                "environment.wind.x": float(wind[0]),
                "environment.wind.y": float(wind[1]),
                "environment.gust.enabled": 1.0,
                "airframe.initial.pos_x": float(place[0]),
                "airframe.initial.pos_y": float(place[1]),
                "airframe.initial.q_w": float(np.cos(half)),
                "airframe.initial.q_z": float(np.sin(half)),
            },
        )


def _flown(fmu: Path, mission: str, starts: Mapping[str, float]) -> Flown:
    steps = round(mission_duration_s(mission) / STEP_S)
    reads = (*TRACKED, DISTANCE)
    slave, found = Slave("twin", fmu), np.full((steps, len(reads)), np.nan)
    try:
        slave.bind([], reads, np.zeros(0), np.zeros(len(reads)))
        slave.initialize(0.0, starts)
        slave.finish_initialization()
        for k in range(steps):
            slave.step(k * STEP_S, STEP_S)
            slave.read_outputs()
            found[k] = slave.outputs
    finally:
        slave.close()
    away = np.linalg.norm(found[:, :3] - found[:, 3:6], axis=1)
    inside = float(np.mean(found[:, 6] <= 1))
    if not np.isfinite(away).all():
        return Flown(float("inf"), float("inf"), inside)
    return Flown(float(np.sqrt(np.mean(away**2))), float(away.max()), inside)
