"""Laws of other simulators, hidden by the numbers of a vehicle file, are named by the library."""

from dataclasses import replace

import numpy as np
import pytest

from twin.explain.inference.selection import name_effects
from twin.vehicle import RotorAir, Vehicle
from twin.vehicle.vehicle import hover_level
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly

COPTER = load_vehicle("copter_default")
LEGS: Waypoints = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -1.5)),
    ("tour", 2.0, (4.0, 1.0, -1.5)),
    ("tour", 2.0, (0.0, -3.0, -2.0)),
    ("tour", 2.5, (-4.0, 3.0, -3.0)),
    ("tour", 2.0, (0.0, 0.0, -1.5)),
)
K_FLAP = 8e-6
FLAPPING = replace(COPTER, rotors=replace(COPTER.rotors, air=RotorAir(flapping_kg_m_rad=K_FLAP)))
DRAG_1_M = np.array([0.03, 0.03, 0.07])
DRAGGED = replace(COPTER, drag_parasitic_n_s2_m2=COPTER.mass_kg * DRAG_1_M)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plant", "effect", "wanted"),
    [
        (
            FLAPPING,
            "flapping_moment",
            {"flapping_moment.k_n_s": 4 * hover_level(COPTER) * K_FLAP},
        ),
        (
            DRAGGED,
            "parasitic_drag",
            {"parasitic_drag.c_1_m": 0.03, "parasitic_drag.more_z_1_m": 0.04},
        ),
    ],
    ids=["flapping_moment", "parasitic_drag"],
)
def test_a_law_of_the_vehicle_file_has_a_name(
    plant: Vehicle, effect: str, wanted: dict[str, float]
) -> None:
    flight = fly(COPTER, plant, seed=1, name="hidden", waypoints=LEGS)
    naming = name_effects([flight], COPTER)
    assert naming.verdict == "named"
    best = naming.best
    assert best.effects == (effect,)
    for name, value in wanted.items():
        assert best.values[name] == pytest.approx(value, rel=0.1)
