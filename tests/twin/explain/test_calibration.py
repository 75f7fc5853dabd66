"""Normal flights calibrate an aircraft; what has changed since has a name, and nothing else has."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from search_rigs.library import library

from twin.effects import EFFECTS
from twin.errors import LogError, ModelError
from twin.explain.calibration import Calibrated, calibrate
from twin.explain.explanation import Explanation, explain
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
def test_a_calibration_knows_no_damage_and_gives_each_rotor_its_factor() -> None:
    broken = TRUE.with_effects({**TRUE.effects, "rotor_efficiency_loss": {"loss_3": 0.2}})
    with library(("thrust_scale", "rotor_efficiency_loss", "payload_cg", "cog_offset")):
        found = calibrate([flown(broken, 0)], COPTER)
    assert not {"rotor_efficiency_loss:3", "payload_cg"} & {*found.state.effects}
    assert 0 < found.estimates["rotor_efficiency_loss.loss_3"].value < 0.2


UNSURE = replace(
    COPTER, sources={**COPTER.sources, "rotors.thrust": "estimate", "body.mass": "estimate"}
)
"""A draft that has guessed thrust and mass."""


@pytest.mark.slow
def test_the_value_of_the_file_stays_where_it_is_not_clearly_worse() -> None:
    with library(("thrust_scale", "mass_offset")):
        exact, wrong = (calibrate([flown(plant, 0)], UNSURE) for plant in (COPTER, TRUE))
    both = {"thrust_scale.scale": 0.01, "mass_offset.mass_kg": 1e-4}
    assert "mass_offset.mass_kg" in exact.undetermined
    for name, least in both.items():
        stands = 1.0 if name.endswith("scale") else 0.0
        assert exact.fit.values.get(name, stands) == pytest.approx(stands, abs=least)
    assert not {*both} & {*wrong.undetermined}
    assert wrong.fit.values["thrust_scale.scale"] == pytest.approx(0.88, abs=0.01)
    assert wrong.fit.values["mass_offset.mass_kg"] == pytest.approx(0.08, abs=0.02)


@pytest.mark.slow
def test_a_profile_of_what_is_nearly_linear_is_as_wide_as_its_curvature_says() -> None:
    with library(("thrust_scale", "cog_offset")):
        found = calibrate([flown(TRUE, 0)], COPTER)
    i = found.problem.priors.names.index("thrust_scale.scale")
    curved = found.state.best.deviations()[i]
    known = found.vehicle.calibration
    assert known is not None
    at = known.numbers.index("thrust_scale.scale")
    wide = np.sqrt(known.covariance[at, at])
    assert curved <= wide * (1 + 1e-9)
    assert wide < 1.5 * curved


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
