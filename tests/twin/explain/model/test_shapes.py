"""Slopes by shapes (a height, a length, a share): those of the prediction itself, where the effect
is there at all."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from twin.effects import EFFECTS
from twin.explain.model.model import Model, candidates, model_of
from twin.flight.manoeuvres import Manoeuvre, plan, rehearse
from twin.logs import Flight
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import WAYPOINTS, fly

VEHICLE = load_vehicle("copter_default")
SIZES = {
    "ground_effect": {"gain": 0.3},
    "rotor_drag": {"k_xy_1_s": 0.3},
    "rotor_efficiency_loss": {"loss_1": 0.1},
    "slung_load": {"mass_kg": 0.1 * VEHICLE.mass_kg},
    "battery_sag": {"slope": 1.3},
    "translational_lift": {"gain": 0.3},
    "blade_flapping": {"k_rad_s_m": 0.015},
}
SHAPES = {
    "ground_effect.height_m": 0.01,
    "rotor_drag.height_m": 0.01,
    "rotor_drag.spin_share": 0.1,
    "rotor_efficiency_loss.torque_share": 0.1,
    "slung_load.length_m": 0.002,
    "slung_load.mass_kg": 1e-4,
    "battery_sag.reference_v": 0.01,
    "translational_lift.induced_m_s": 0.05,
    "blade_flapping.height_m": 0.005,
}
"""By number, a small change of it."""


def shaken(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """To and fro, and a while close to the ground."""
    ramp, w = np.sin(np.pi * np.clip(t / 8.0, 0, 1)) ** 2, 2 * np.pi * t
    x, y = (ramp * a * np.sin(f * w) for a, f in ((0.7, 0.5), (0.5, 0.7)))
    return np.column_stack([x, y, 0.3 * ramp, ramp * 0.3 * np.sin(0.6 * w)])


@cache
def flown(loaded: bool = False) -> Flight:
    """An observer needs a load that it can follow."""
    load = {"slung_load": {**SIZES["slung_load"], "length_m": 0.7}} if loaded else {}
    like = fly(VEHICLE, VEHICLE, 0, waypoints=WAYPOINTS[:2])
    like.table["vbat_v"] = VEHICLE.voltage_v
    moves = plan(VEHICLE, [Manoeuvre("shaken", "", 8.0, shaken)])
    return rehearse(moves, VEHICLE, VEHICLE.with_effects(load), [like], 0.95)


@cache
def model(loaded: bool = False) -> Model:
    return model_of([flown(loaded)], VEHICLE, [EFFECTS[e] for e in SIZES])


@pytest.mark.slow
def test_every_shape_is_asked_for() -> None:
    seen = {e.name: e for e in candidates([flown()])}
    assert {*SIZES} <= {*seen}
    every = ((e.name, p) for e in seen.values() for p in e.parameters)
    assert {f"{e}.{p.name}" for e, p in every if p.neutral is None} <= {*SHAPES}


@pytest.mark.slow
@pytest.mark.parametrize("name", SHAPES)
def test_the_slope_by_a_shape_is_that_of_the_prediction(name: str) -> None:
    effect = name.partition(".")[0]
    of_flight = model(effect == "slung_load")
    column = [n.full for n in of_flight.numbers].index(name)
    sizes = {f"{effect}.{k}": v for k, v in SIZES[effect].items()}
    at, step = sizes.get(name, of_flight.numbers[column].now), SHAPES[name]
    (here,) = of_flight.channels([column], sizes)
    ahead, back = (of_flight.channels([], {**sizes, name: at + s})[0] for s in (step, -step))
    largest = 0.0
    for c, a, b in zip(here, ahead, back, strict=True):
        expected = (b.residual - a.residual) / (2 * step)
        size = max(float(np.std(c.measured)), 0.1)
        error = np.sqrt(np.mean((c.slopes[:, 0] - expected) ** 2)) / size
        whole = np.sqrt(np.mean(expected**2)) / size
        assert error <= 0.03 * whole + 1e-6, c.name
        largest = max(largest, whole * step)
    assert largest > 1e-5, f"{name} moves nothing"
