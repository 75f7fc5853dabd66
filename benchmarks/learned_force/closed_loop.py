"""Laws in closed loop: missions in random air, on exported FMUs, each with its law and without."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from learning.force.model import VEHICLE_FILE
from uavtwin.exports.parts import LearnedForce, learned_force
from uavtwin.force.closed_loop import MISSIONS, WIND_M_S, fly_both, random_air
from uavtwin.force.evaluate import SHIPPED
from uavtwin.vehicles import load_vehicle

STILL = f"{SHIPPED}, still air"


def closed_loop(folder: Path, count: int, seed: int) -> list[dict[str, Any]]:
    """Fly what is shipped, and the twin without, through the same air.

    Args:
        folder: That `train --protocol force` wrote.
        count: Flights in wind, and as many in still air.
        seed: Of missions, air, noise and where they begin.

    Returns:
        Per flight and law `mission`, `law`, `lost`, `off_m` with it and `alone_m` without, and
        the share of the time `inside` the envelope.
    """
    vehicle = load_vehicle(folder / VEHICLE_FILE)
    missions = np.random.default_rng(seed).choice(MISSIONS, count)
    rows = []
    for law, force, wind_m_s in _laws(folder):
        airs = random_air(count, seed, wind_m_s)
        for mission in MISSIONS:
            own = [air for air, m in zip(airs, missions, strict=True) if m == mission]
            rows += [
                {
                    "mission": mission,
                    "law": law,
                    "lost": both.lost,
                    "off_m": both.learned.off_m,
                    "alone_m": both.alone.off_m,
                    "inside": both.learned.inside,
                }
                for both in (fly_both(vehicle, force, mission, own) if own else [])
            ]
    return rows


def _laws(folder: Path) -> Iterator[tuple[str, LearnedForce, float]]:
    """Name, force and spread of the wind."""
    shipped = learned_force(folder)
    yield SHIPPED, shipped, WIND_M_S
    yield STILL, shipped, 0.0
