"""Normal flights calibrate an aircraft; what has changed since has a name, and nothing else has."""

from functools import cache

import numpy as np
import pytest
from search_rigs.library import library

from twin.effects import EFFECTS
from twin.errors import LogError, ModelError
from twin.explain.calibration import Calibrated, calibrate
from twin.explain.explanation import Explanation, explain
from twin.explain.settings import DEFAULT
from twin.logs import Flight
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.demo.flights import Waypoints, fly

CHANGES = {name: e.change for name, e in EFFECTS.items() if e.change is not None}
COPTER = load_vehicle("copter_default")
TRUE = COPTER.with_effects({"thrust_scale": {"scale": 0.88}, "mass_offset": {"mass_kg": 0.08}})
"""What flies: the file is wrong about thrust and mass."""


FEW = (
    "thrust_scale",
    "mass_offset",
    "rotor_efficiency_loss",
    "payload_cg",
    "cog_offset",
    "motor_lag",
    "rotor_drag",
    "steady_wind",
    "accel_bias",
    "gyro_bias",
    "command_delay",
)
"""Candidates here."""


def legs(n: int) -> Waypoints:
    """Other ways every time."""
    x, y = 3.0 * np.cos(2.0 * n), 3.0 * np.sin(2.0 * n)
    return (
        ("ground", 0.5, (0.0, 0.0, 0.0)),
        ("takeoff", 2.0, (0.0, 0.0, -1.5)),
        ("tour", 2.0, (x, y, -1.5)),
        ("tour", 2.0, (-y, x, -2.5)),
        ("tour", 2.0, (0.0, 0.0, -1.5)),
    )


def flown(plant: Vehicle, n: int) -> Flight:
    return fly(COPTER, plant, seed=10 + n, name=f"flight_{n}", waypoints=legs(n))


@cache
def calibrated() -> Calibrated:
    with library(FEW):
        return calibrate([flown(TRUE, n) for n in range(3)], COPTER)


def since(plant: Vehicle, n: int) -> Explanation:
    """What a later flight says."""
    flights = [flown(plant, n), flown(plant, n + 1)]
    with library(FEW):
        return explain(flights[:1], flights[1:], calibrated().vehicle, missions=[], since=True)


@pytest.mark.slow
def test_normal_flights_tell_thrust_over_mass_and_how_well() -> None:
    """Of the two alone they tell the ratio."""
    vehicle = calibrated().vehicle
    scale = vehicle.effects.get("thrust_scale", {}).get("scale", 1.0)
    mass = vehicle.effects.get("mass_offset", {}).get("mass_kg", 0.0) + vehicle.mass_kg
    assert scale / mass == pytest.approx(0.88 / (COPTER.mass_kg + 0.08), rel=0.01)
    told = vehicle.calibration
    assert told is not None
    assert told.flights == ("flight_0", "flight_1", "flight_2")
    assert told.covariance.shape == (len(told.numbers), len(told.numbers))
    assert np.all(np.linalg.eigvalsh(told.covariance) > 0)
    assert np.allclose(told.covariance, told.covariance.T)
    assert all(sd > 0 for sd in (*told.days.values(), *told.constants.values()))
    assert {f for f in calibrated().days} == {"flight_0", "flight_1", "flight_2"}


@pytest.mark.slow
def test_a_rotor_that_lost_thrust_since_is_named_with_its_number() -> None:
    worn = TRUE.with_effects({**TRUE.effects, "rotor_efficiency_loss": {"loss_3": 0.15}})
    found = since(worn, 5)
    balance = found.balance
    assert balance is not None
    assert balance.changed > 0.99
    assert found.verdict == ("named" if balance.named else "cannot_tell")
    best = balance.best("rotor_efficiency_loss")
    assert best.rotors == (3,)
    assert best.values["rotor_efficiency_loss.loss_3"] == pytest.approx(0.15, abs=0.03)


@pytest.mark.slow
def test_a_normal_flight_says_nothing() -> None:
    found = since(TRUE, 7)
    assert found.verdict == "nothing", found.values


def test_every_number_of_what_may_change_has_an_expectation() -> None:
    for effect, prior in CHANGES.items():
        for p in (*EFFECTS[effect].parameters, *EFFECTS[effect].of_logs):
            assert all(prior.of(p.name, indoors).sd > 0 for indoors in (False, True)), p.name


@pytest.mark.slow
def test_what_changed_is_asked_of_a_calibrated_vehicle_alone() -> None:
    flight = flown(COPTER, 0)
    with pytest.raises(ModelError, match=r"holds no \[calibration\]"):
        explain([flight], [], COPTER, missions=[], since=True)
    with pytest.raises(LogError, match="no flight"):
        calibrate([], COPTER)


@pytest.mark.slow
def test_a_calibration_believes_no_rotor_that_explain_would_not() -> None:
    """Beyond the deviations that count as too many, here one: left out, the rest fitted without."""
    broken = TRUE.with_effects({**TRUE.effects, "rotor_efficiency_loss": {"loss_3": 0.2}})
    settings = DEFAULT.with_values({"inference.selection.tension": 1.0}).inference
    with library(("thrust_scale", "rotor_efficiency_loss", "cog_offset")):
        found = calibrate([flown(broken, 0)], COPTER, settings=settings)
    assert {*found.refused} == {"rotor_efficiency_loss"}
    assert "loss_3 = 0." in found.refused["rotor_efficiency_loss"]
    assert "rotor_efficiency_loss" not in found.state.effects
    lost = found.estimates["rotor_efficiency_loss.loss_3"].value
    assert 0 < lost < 0.2, "the factor that every rotor has takes a part of it"
    assert not calibrated().refused


@pytest.mark.slow
def test_numbers_of_a_calibration_have_an_interval_and_its_sound_value() -> None:
    found = calibrated()
    for name, t in found.estimates.items():
        assert t.ci95 is not None
        assert t.ci95[0] <= t.value <= t.ci95[1]
        assert t.no_effect == (1.0 if name.endswith("scale") else 0.0)
        assert t.prior_share == found.prior_share.get(name, 1.0)
    assert found.shares["thrust_scale"][1] == "acc_z"
    assert found.shares["thrust_scale"][0] > 0.5
