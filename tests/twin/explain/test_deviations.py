"""What a file says of its own uncertainty, and what is too far from what a number can be."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from search_rigs.courses import LEGS
from search_rigs.hypotheses import against
from search_rigs.library import library

from twin.effects import EFFECTS
from twin.explain.estimates import calibrated_effects, estimates_of
from twin.explain.explanation import Explanation, explain
from twin.explain.inference.fit import Fit
from twin.explain.inference.priors import _covariance, _unsure
from twin.explain.inference.selection import _resemblances, name_effects
from twin.explain.model.numbers import numbers_of, numbers_of_logs
from twin.explain.settings import DEFAULT
from twin.vehicle import Vehicle
from twin.vehicle.vehicle import Deviation
from twin.vehicle_file import load_vehicle, parse_vehicle, vehicle_text
from uavtwin.demo.flights import fly
from uavtwin.explain_record import explain_record

COPTER = load_vehicle("copter_default")
FEW = (
    "mass_offset",
    "thrust_scale",
    "inertia_error",
    "rotor_drag",
    "motor_lag",
    "accel_bias",
    "accel_scale",
    "gyro_bias",
    "gyro_scale",
    "imu_delay",
)
"""Candidates here."""
MASS = 'mass = { value = 1.4, unit = "kg", '


def unsure_of_mass(sd: str) -> Vehicle:
    """The file with a deviation beside its mass."""
    text, name = vehicle_text("copter_default")
    assert MASS in text
    return parse_vehicle(text.replace(MASS, f'{MASS}sd = "{sd}", '), name)


def explained(vehicle: Vehicle, plant: Vehicle) -> Explanation:
    """What a flight says, another being held out."""
    flights = [fly(COPTER, plant, seed=n, name=f"flown_{n}", waypoints=LEGS) for n in (3, 4)]
    with library(FEW):
        return explain(flights[:1], flights[1:], vehicle, missions=[])


@pytest.mark.parametrize(("per_thrust", "torque_sd"), [(True, 0.2), (False, 0.2), (True, 0.0)])
def test_a_torque_that_is_given_per_thrust_is_off_with_the_thrust(
    per_thrust: bool, torque_sd: float
) -> None:
    """Torque over that of the file is the ratio's factor times the thrust's: draws of both."""
    key = "rotors.torque_per_thrust" if per_thrust else "rotors.torque_from_speed"
    vehicle = cast(Vehicle, SimpleNamespace(sources={key: "made up"}))
    numbers = numbers_of([EFFECTS["thrust_scale"], EFFECTS["yaw_torque_scale"]], COPTER)
    sd = np.array([0.05, torque_sd])
    draws = 1 + sd * np.random.default_rng(0).standard_normal((200_000, 2))
    if per_thrust and torque_sd:
        draws[:, 1] *= draws[:, 0]
    found = _covariance(numbers, sd, vehicle)
    assert found == pytest.approx(np.cov(draws.T), abs=3e-4)


def test_the_point_of_the_position_is_known_no_better_than_the_hubs() -> None:
    """Both are beside the centre of mass, from which the file has its places."""
    unsure = replace(COPTER, deviations={"rotors.position": Deviation(0.04)})
    numbers = numbers_of([EFFECTS["cog_offset"]], unsure)
    numbers += numbers_of_logs([EFFECTS["pose_lever_arm"]], unsure)
    found = [_unsure(n, unsure, True) for n in numbers]
    assert found == pytest.approx([0.04 * COPTER.arm_m] * 6)
    assert not any(_unsure(n, COPTER, True) for n in numbers)


@pytest.mark.slow
def test_an_error_that_the_file_allows_for_is_no_name_but_a_better_number() -> None:
    heavier = replace(COPTER, mass_kg=1.05 * COPTER.mass_kg)
    found = explained(unsure_of_mass("5 %"), heavier)
    assert found.verdict == "nothing"
    assert calibrated_effects(found) == ["mass_offset"]
    ((calibrated),) = explain_record(found).json()["calibrated"]
    number = calibrated["parameters"]["mass_kg"]
    assert number["value"] == pytest.approx(0.05 * COPTER.mass_kg, rel=0.2)
    assert number["ci95"][0] < 0.05 * COPTER.mass_kg < number["ci95"][1]
    assert found.added is not None
    added = found.added.effects["mass_offset"]["mass_kg"]
    assert added == pytest.approx(number["value"])


@pytest.mark.slow
def test_an_error_of_six_deviations_has_a_name() -> None:
    heavier = replace(COPTER, mass_kg=1.12 * COPTER.mass_kg)
    found = explained(unsure_of_mass("2 %"), heavier)
    assert found.verdict == "named"
    assert found.naming is not None
    assert "mass_offset" in found.naming.named
    assert found.values["mass_offset.mass_kg"] == pytest.approx(0.12 * COPTER.mass_kg, rel=0.2)
    assert calibrated_effects(found) == []
    conditional = found.naming.conditional
    width = dict(
        zip((n.full for n in conditional.numbers), conditional.half_widths.tolist(), strict=True)
    )
    n = len(found.naming.named) + len(found.naming.resemblances)
    (mass,) = estimates_of(found, "mass_offset")
    assert mass.ci95 is not None
    low, high = mass.ci95  # a variance for itself and one for each effect that is told
    assert (high - low) / 2 == pytest.approx((1 + n) ** 0.5 * width["mass_offset.mass_kg"])


@pytest.mark.slow
def test_what_is_large_and_alone_is_named_with_its_size() -> None:
    """A gyroscope whose scale is 8 % off, eight prior deviations."""
    flight = fly(COPTER, COPTER, seed=3, name="flown", waypoints=LEGS)
    table = flight.table.copy()
    for a in "xyz":
        table[f"gyro_{a}"] *= 1.08
    with library(FEW):
        naming = name_effects([replace(flight, table=table)], COPTER)
    assert "gyro_scale" in naming.named
    assert naming.conditional.values["gyro_scale.x"] == pytest.approx(1.08, abs=0.02)


@pytest.mark.slow
def test_no_vehicle_carries_what_something_only_acts_like() -> None:
    """A gyroscope 35 % off is more than its scale can be; the drag beside it is named."""
    dragged = COPTER.with_effects({"rotor_drag": {"k_xy_1_s": 0.4}})
    flight = fly(COPTER, dragged, seed=3, name="flown", waypoints=LEGS)
    table = flight.table.copy()
    for a in "xyz":
        table[f"gyro_{a}"] *= 1.35
    with library(FEW):
        found = explain([replace(flight, table=table)], [], COPTER, missions=[])
    naming = found.naming
    assert found.verdict == "named" and naming is not None and found.added is not None
    assert "gyro_scale" in [r.effect for r in naming.resemblances]
    assert "gyro_scale" in naming.conditional.effects
    assert "gyro_scale" not in {*found.effects, *found.added.effects}
    assert found.added.effects["rotor_drag"]["k_xy_1_s"] == pytest.approx(0.4, rel=0.1)


@pytest.mark.slow
def test_a_number_at_its_edge_is_of_something_that_acts_like_its_effect() -> None:
    flight = fly(COPTER, COPTER, seed=3, name="flown", waypoints=LEGS)
    problem = against(flight, COPTER, "gyro_scale")
    rules = DEFAULT.inference.selection
    for value, why in ((1.2, "at the edge"), (1.06, ""), (1.02, "")):
        numbers = tuple(n for n in problem.model.numbers if n.effect == "gyro_scale")
        values = {n.full: 1.0 for n in numbers} | {"gyro_scale.x": value}
        conditional = Fit(("gyro_scale",), values, numbers, np.zeros(3), 0.0)
        found = _resemblances(problem, conditional, conditional, {}, rules)
        assert [r.effect for r in found] == ["gyro_scale"] * bool(why)
        assert all(why in r.why for r in found)


@pytest.mark.slow
def test_what_more_than_half_of_the_rotors_have_in_common_is_no_damage_of_single_ones() -> None:
    flight = fly(COPTER, COPTER, seed=3, name="flown", waypoints=LEGS)
    problem = against(flight, COPTER, "rotor_efficiency_loss", "thrust_scale")
    rotors = [f"rotor_efficiency_loss:{i}" for i in range(1, 5)]
    odds = problem.priors.log_odds
    for few in (rotors[:1], rotors[:2]):
        every = sum(problem.priors.odds[c] for c in few)
        assert odds(few) == pytest.approx(every)
        assert odds([*few, "thrust_scale"]) == pytest.approx(odds(["thrust_scale"]) + every)
    for many in (rotors[:3], rotors):
        assert odds(many) == -np.inf
        assert problem.laplace(problem.rest).best(many, 1.0).evidence == -np.inf
